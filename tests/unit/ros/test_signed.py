# SPDX-License-Identifier: Apache-2.0
"""Signed documents of DDS Security: what counts is the text that the authority signed, to the byte.

Source: lesson L18; docs/spec/ros-map.md#keystore
"""

from __future__ import annotations

import base64
import shutil
import subprocess
from datetime import timedelta
from pathlib import Path

import pytest
from asn1crypto import cms
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ed25519, rsa
from cryptography.hazmat.primitives.serialization import Encoding, pkcs7
from hypothesis import given
from hypothesis import strategies as st

from authguard_r.core.errors import AuthenticityError, AuthGuardError, MalformedError
from authguard_r.integrations.ros.keystore import authority, pem
from authguard_r.integrations.ros.signed import MAX_SIGNED, open_text, sign_text
from fixtures.cases import case
from fixtures.ros_keystores import NOW

BY, OTHER = authority("permissions", NOW), authority("other", NOW)
TEXT = b"<dds>\r\n  <permissions/>\r\n</dds>"
SIGNED = sign_text(TEXT, BY.certificate, BY.key)
#: Where its signature stands.
BEGIN = SIGNED.index(b"\r\n\r\n", SIGNED.index(b"attachment")) + 4
END = SIGNED.index(b"\r\n\r\n--", BEGIN)
OPTIONS = [pkcs7.PKCS7Options.Text, pkcs7.PKCS7Options.DetachedSignature]


def opened(data: bytes) -> bytes:
    return open_text(data, BY.certificate, where="permissions.p7s")


def test_what_was_signed_is_opened_by_us_and_by_openssl(tmp_path: Path) -> None:
    assert opened(SIGNED) == TEXT
    assert opened(SIGNED.replace(b"\r\n", b"\n")) == TEXT
    if shutil.which("openssl") is None:  # pragma: no cover - every machine of ours has it
        return
    (tmp_path / "ca.pem").write_bytes(pem(BY.certificate))
    (tmp_path / "signed").write_bytes(SIGNED)
    words = ["openssl", "smime", "-verify", "-text", "-in", "signed", "-CAfile", "ca.pem"]
    done = subprocess.run(words, capture_output=True, cwd=tmp_path, check=True)
    assert done.stdout.split() == TEXT.split()


@pytest.mark.parametrize("algorithm", [hashes.SHA256(), hashes.SHA384(), hashes.SHA512()])
def test_an_authority_with_an_rsa_key_is_one_too(algorithm: hashes.HashAlgorithm) -> None:
    """As other makers of keystores have them."""
    key = rsa.generate_private_key(65_537, 2_048)
    made = x509.CertificateBuilder().subject_name(BY.certificate.subject)
    made = made.issuer_name(BY.certificate.subject).public_key(key.public_key())
    made = made.serial_number(1).not_valid_before(NOW).not_valid_after(NOW + timedelta(days=1))
    certificate = made.sign(key, hashes.SHA256())
    builder = pkcs7.PKCS7SignatureBuilder().set_data(TEXT)
    signed = builder.add_signer(certificate, key, algorithm).sign(Encoding.SMIME, OPTIONS)  # type: ignore[arg-type]
    assert open_text(signed, certificate, where="x") == TEXT
    with pytest.raises(AuthenticityError):
        open_text(signed, BY.certificate, where="x")


def test_a_changed_text_and_another_authority_are_refused_with_their_place() -> None:
    for wrong, said in (
        (SIGNED.replace(b"<permissions/>", b"<permissions />"), "not the one that was signed"),
        (sign_text(TEXT, OTHER.certificate, OTHER.key), "has not signed it"),
    ):
        with pytest.raises(AuthenticityError, match=said) as failed:
            opened(wrong)
        assert failed.value.where == "permissions.p7s"


def test_an_authority_of_another_algorithm_has_signed_nothing() -> None:
    key = ed25519.Ed25519PrivateKey.generate()
    made = x509.CertificateBuilder().subject_name(BY.certificate.subject)
    made = made.issuer_name(BY.certificate.subject).public_key(key.public_key())
    made = made.serial_number(1).not_valid_before(NOW).not_valid_after(NOW + timedelta(days=1))
    with pytest.raises(AuthenticityError):
        open_text(SIGNED, made.sign(key, None), where="x")


def test_what_is_no_signed_message_is_said_so() -> None:
    for data in [
        b"",
        b"<dds/>",
        SIGNED[: len(SIGNED) // 2],
        SIGNED.replace(b"boundary", b"border"),
        SIGNED.replace(b"\r\n\r\nMI", b"\r\n\r\n!!"),
        SIGNED[:BEGIN] + b"AAAA" + SIGNED[END:],
        SIGNED[:BEGIN] + base64.b64encode(b"\x30\x80") + SIGNED[END:],
        SIGNED.rpartition(b"\r\n\r\n")[0],
        b"x" * (MAX_SIGNED + 1),
    ]:
        with case(data), pytest.raises((MalformedError, AuthenticityError)):
            opened(data)


def test_a_short_digest_is_none() -> None:
    content = cms.ContentInfo.load(base64.b64decode(SIGNED[BEGIN:END]))
    (signer,) = content["content"]["signer_infos"]
    signer["digest_algorithm"]["algorithm"] = "sha1"
    weak = base64.b64encode(content.dump(force=True))
    with pytest.raises(AuthenticityError, match="SHA-256 or longer"):
        opened(SIGNED[:BEGIN] + weak + SIGNED[END:])


@given(st.integers(0, len(SIGNED) - 1), st.integers(0, 255))
def test_no_byte_of_it_can_be_changed_into_another_text(at: int, byte: int) -> None:
    changed = SIGNED[:at] + bytes([byte]) + SIGNED[at + 1 :]
    try:
        found = opened(changed)
    except AuthGuardError:
        return
    assert found == TEXT
