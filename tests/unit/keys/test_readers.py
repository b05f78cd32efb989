# SPDX-License-Identifier: Apache-2.0
"""What is wrapped for a reader, only its key opens, under the same name; by HPKE and nothing else.

Source: docs/spec/sealed-fields.md#readers
"""

from __future__ import annotations

import stat
from pathlib import Path

import pytest
from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey, X25519PublicKey
from cryptography.hazmat.primitives.ciphers.aead import AESGCM
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDF, HKDFExpand
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

from authguard_r.core.encoding import Tag, b64, digest
from authguard_r.core.errors import AuthenticityError, MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.keys.envelope import seal
from authguard_r.keys.files import write_whole
from authguard_r.keys.readers import (
    ReaderKey,
    ReaderPublic,
    new_reader,
    read_public,
    read_reader,
)
from fixtures.cases import case

SECRET, INFO = bytes(range(32)), b"whose key of what it is"
SAID = "correct horse battery staple"
#: Lengths of `enc`: of X25519, and of ML-KEM-768 and X25519.
ENC = {False: 32, True: 1_088 + 32}
#: Points of X25519 with which every secret is zero.
LOW_ORDER = (
    bytes(32),
    b"\x01" + bytes(31),
    bytes.fromhex("e0eb7a7c3b41b8ae1656e3faf19fc46ada098deb9c32b1fd866205165f49b800"),
    bytes.fromhex("5f9c95bca3508c24b1d0b1559c83ef5b04445cc4581c8e86d8224eddd09f1157"),
    b"\xec" + b"\xff" * 30 + b"\x7f",
)


@pytest.fixture(scope="module", params=[False, True], ids=["x25519", "hybrid"])
def key(request: pytest.FixtureRequest) -> ReaderKey:
    return new_reader(hybrid=request.param)


# a second reading of RFC 9180, base mode: DHKEM(X25519, HKDF-SHA256) and HKDF-SHA256


def extract(suite: bytes, salt: bytes, label: bytes, ikm: bytes) -> bytes:
    return HKDF.extract(SHA256(), salt or bytes(32), b"HPKE-v1" + suite + label + ikm)


def expand(suite: bytes, key: bytes, label: bytes, info: bytes, length: int) -> bytes:
    told = length.to_bytes(2, "big") + b"HPKE-v1" + suite + label + info
    return HKDFExpand(SHA256(), length, told).derive(key)


def hpke_opened(
    own: X25519PrivateKey, wrapped: bytes, info: bytes, *, aad: bytes = b"", aead: int, size: int
) -> bytes:
    """Return what was encrypted first to a key, as RFC 9180 says in section 5."""
    enc, text = wrapped[:32], wrapped[32:]
    kem = b"KEM" + (0x20).to_bytes(2, "big")
    shared = own.exchange(X25519PublicKey.from_public_bytes(enc))
    context = enc + own.public_key().public_bytes_raw()
    secret = expand(kem, extract(kem, b"", b"eae_prk", shared), b"shared_secret", context, 32)
    suite = b"HPKE" + b"".join(number.to_bytes(2, "big") for number in (0x20, 1, aead))
    hashes = (extract(suite, b"", b"psk_id_hash", b""), extract(suite, b"", b"info_hash", info))
    schedule = b"\0" + b"".join(hashes)
    prk = extract(suite, secret, b"secret", b"")
    key = expand(suite, prk, b"key", schedule, size)
    return AESGCM(key).decrypt(expand(suite, prk, b"base_nonce", schedule, 12), text, aad)


def test_the_second_reading_opens_what_the_rfc_itself_encrypted() -> None:
    own = "4612c550263fc8ad58375df3f557aac531d26850903e55a9f23f21d8534e8ac8"
    enc = "37fda3567bdbd628e88668c3c8d7e97d1d1253b6d4ea6d44c150f741f1bf4431"
    text = (
        "f938558b5d72f1a23810b4be2ab4f84331acc02fc97babc53a52ae8218a355a96d8770ac83d07bea87e13c512a"
    )
    found = hpke_opened(  # RFC 9180, A.1.1: the same suite but for AES-128
        X25519PrivateKey.from_private_bytes(bytes.fromhex(own)),
        bytes.fromhex(enc + text),
        b"Ode on a Grecian Urn",
        aad=b"Count-0",
        aead=1,
        size=16,
    )
    assert found == b"Beauty is truth, truth beauty"


def test_what_is_wrapped_is_hpke_as_somebody_else_reads_it() -> None:
    own = X25519PrivateKey.generate()
    wrapped = ReaderKey(own).public.wrap(SECRET, INFO)
    assert hpke_opened(own, wrapped, INFO, aead=2, size=32) == SECRET
    with pytest.raises(InvalidTag):
        hpke_opened(own, wrapped, INFO + b".", aead=2, size=32)


def test_a_wrapped_key_opens_with_its_own_key_and_name_alone(key: ReaderKey) -> None:
    wrapped = key.public.wrap(SECRET, INFO)
    assert len(wrapped) == ENC[len(key.public.raw) > 32] + len(SECRET) + 16
    assert key.unwrap(wrapped, INFO, where="here") == SECRET
    assert key.public.wrap(SECRET, INFO) != wrapped
    for other, info in ((new_reader(), INFO), (new_reader(hybrid=True), INFO), (key, INFO + b".")):
        with pytest.raises(AuthenticityError, match="does not open") as refused:
            other.unwrap(wrapped, info, where="here")
        assert (refused.value.reason, refused.value.where) == (Reason.KEY_INVALID, "here")


def test_a_damaged_wrap_opens_nothing(key: ReaderKey) -> None:
    wrapped = key.public.wrap(SECRET, INFO)
    places = (0, 31, len(wrapped) - 49, len(wrapped) - 48, len(wrapped) - 1)
    damaged = [wrapped[:at] + bytes([wrapped[at] ^ 1]) + wrapped[at + 1 :] for at in places]
    damaged += [b"", wrapped[:1], wrapped[:32], wrapped[:-1], wrapped + b"\0", wrapped[1:]]
    for text in damaged:
        with pytest.raises(AuthenticityError):
            key.unwrap(text, INFO, where="here")


@pytest.mark.parametrize("point", LOW_ORDER, ids=[point.hex()[:8] for point in LOW_ORDER])
def test_a_public_key_that_keeps_no_secret_is_refused(point: bytes) -> None:
    mlkem = new_reader(hybrid=True).public.raw[:-32]
    for raw in (point, mlkem + point):
        with pytest.raises(MalformedError) as refused:
            read_public(b64(raw), where="gate.readers[0].key")
        assert refused.value.reason is Reason.KEY_INVALID
        assert refused.value.where == "gate.readers[0].key"


def test_a_point_of_low_order_encapsulates_nothing() -> None:
    wrapped = new_reader().public.wrap(SECRET, INFO)
    for point in LOW_ORDER:  # as what somebody says was encapsulated
        with pytest.raises(AuthenticityError):
            new_reader().unwrap(point + wrapped[32:], INFO, where="here")


def test_what_is_no_public_key_is_refused() -> None:
    for size in [0, 1, 31, 33, 1_184, 1_215, 1_217, 2_400]:
        with case(size):
            with pytest.raises(MalformedError, match="expected a public key") as refused:
                ReaderPublic(b"\x09" * size, where="key")
            assert refused.value.reason is Reason.KEY_INVALID


def test_a_public_key_that_is_no_base64url_is_refused() -> None:
    for text in ("=", "a b", "\xe4", b64(bytes(32)) + "="):
        with pytest.raises(MalformedError):
            read_public(text, where="key")


def test_a_public_key_is_spelled_in_one_way_and_named_by_its_digest(key: ReaderKey) -> None:
    found = read_public(key.public.text(), where="key")
    assert (found.raw, found.name) == (key.public.raw, digest(Tag.RAW, key.public.raw))
    assert key.unwrap(found.wrap(SECRET, INFO), INFO, where="here") == SECRET


# files


@pytest.mark.parametrize("said", [None, SAID])
def test_a_file_has_the_key_plain_or_sealed(
    key: ReaderKey, said: str | None, tmp_path: Path
) -> None:
    path = tmp_path / "reader.key.pem"
    write_whole(path, key.pem() if said is None else seal(key.pem(), said), mode=0o600)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    found = read_reader(path, lambda _: SAID)
    assert found.public.raw == key.public.raw
    assert found.unwrap(key.public.wrap(SECRET, INFO), INFO, where="here") == SECRET


def test_a_sealed_file_opens_with_its_passphrase_alone(tmp_path: Path) -> None:
    path = tmp_path / "reader.key.pem"
    path.write_bytes(seal(new_reader().pem(), SAID))
    with pytest.raises(AuthenticityError, match="passphrase is wrong"):
        read_reader(path, lambda _: SAID.upper())
    with pytest.raises(AuthenticityError, match="there is no terminal"):
        read_reader(path)


def test_a_file_with_another_key_or_half_of_one_is_no_readers(tmp_path: Path) -> None:
    form = (Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    signs = Ed25519PrivateKey.generate().private_bytes(*form)
    plain, hybrid = new_reader().pem(), new_reader(hybrid=True).pem()
    end = b"-----END PRIVATE KEY-----\n"
    first, second = (part + end for part in hybrid.split(end)[:2])
    broken = plain.replace(b"M", b"N", 1)
    path = tmp_path / "reader.key.pem"
    for data in (signs, plain + plain, second + first, first, plain + signs, broken, b"", b"\xff"):
        path.write_bytes(data)
        with pytest.raises(AuthenticityError, match=r"expected the key of a reader|expected an"):
            read_reader(path)
