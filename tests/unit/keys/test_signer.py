# SPDX-License-Identifier: Apache-2.0
"""Private keys in files: the leaf's own key with its chain, or a refusal that names why."""

from __future__ import annotations

import base64
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric import ec, rsa
from cryptography.hazmat.primitives.asymmetric.types import PrivateKeyTypes
from cryptography.hazmat.primitives.serialization import (
    BestAvailableEncryption,
    Encoding,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
)

from authguard_r.core.errors import AuthenticityError, EnvironmentFault
from authguard_r.core.reasons import Reason
from authguard_r.keys.algorithms import Algorithm, PublicKey
from authguard_r.keys.signer import FileSigner, read_signer
from unit.keys import chains
from unit.keys.chains import Held, house

LEAF = chains.leaf(house().people)


def pem(key: PrivateKeyTypes) -> bytes:
    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())


def cert(*held: Held) -> bytes:
    return b"".join(one.certificate.public_bytes(Encoding.PEM) for one in held)


def files(folder: Path, key: bytes | None, chain: bytes | None) -> tuple[Path, Path]:
    paths = (folder / "key.pem", folder / "cert.pem")
    for path, data in zip(paths, (key, chain), strict=True):
        if data is not None:
            path.write_bytes(data)
    return paths


def refused(folder: Path, key: bytes, chain: bytes, *, where: str) -> AuthenticityError:
    with pytest.raises(AuthenticityError) as caught:
        read_signer(*files(folder, key, chain))
    assert caught.value.reason is Reason.KEY_INVALID
    assert caught.value.where == str(folder / where)
    assert b"PRIVATE" not in caught.value.message.encode()
    return caught.value


def test_a_signer_signs_as_its_leaf(tmp_path: Path) -> None:
    signer = read_signer(*files(tmp_path, pem(LEAF.key), cert(LEAF, house().people)))
    assert signer.chain == (LEAF.der, house().people.der)
    found = house().trust().verify(b"go", signer.endorse(b"go"), chains.NOW)
    assert found.id == "operator-1"


class Hardware:
    """A key that can be used and does not come out."""

    def sign(self, data: bytes, /) -> bytes:
        return LEAF.key.sign(data)

    def public_key(self) -> PublicKey:
        return LEAF.key.public_key()


def test_a_secret_is_every_keys_and_one_purposes() -> None:
    chain = house().chain(LEAF)
    second = chains.leaf_of(Algorithm.ML_DSA_87, "supervisor-1").key
    alone, both = FileSigner(LEAF.key, chain), FileSigner(LEAF.key, chain, (second, chain))
    made = [signer.secret(purpose) for signer in (alone, both) for purpose in (b"a", b"b")]
    made += [FileSigner(second, chain).secret(b"a")]
    assert len(set(made)) == 5
    assert {len(secret) for secret in made} == {32}
    assert alone.secret(b"a") == FileSigner(LEAF.key, chain).secret(b"a")
    for held in (FileSigner(Hardware(), chain), FileSigner(LEAF.key, chain, (Hardware(), chain))):
        with pytest.raises(AuthenticityError, match="in a file"):
            held.secret(b"a")


@pytest.mark.parametrize(
    "key",
    [
        LEAF.key.private_bytes(
            Encoding.PEM, PrivateFormat.PKCS8, BestAvailableEncryption(b"secret")
        ),
        LEAF.key.private_bytes(Encoding.DER, PrivateFormat.PKCS8, NoEncryption()),
        LEAF.key.private_bytes(Encoding.Raw, PrivateFormat.Raw, NoEncryption()),
        LEAF.key.private_bytes(Encoding.PEM, PrivateFormat.OpenSSH, NoEncryption()),
        LEAF.key.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo),
        cert(LEAF),
        b"",
        b"garbage",
        b"\xff\x00",
        pem(LEAF.key)[:-40],
        b"-----BEGIN PRIVATE KEY-----\n"
        + base64.b64encode(b"\x30\x03\x02\x01\x00")
        + b"\n-----END PRIVATE KEY-----\n",
    ],
    ids=[
        "encrypted",
        "DER",
        "raw bytes",
        "OpenSSH",
        "a public key",
        "a certificate",
        "nothing",
        "garbage",
        "no text",
        "cut short",
        "another structure",
    ],
)
def test_a_file_that_is_no_open_pem_key_is_refused(tmp_path: Path, key: bytes) -> None:
    refused(tmp_path, key, cert(LEAF, house().people), where="key.pem")


@pytest.mark.parametrize(
    "key",
    [rsa.generate_private_key(65537, 2048), ec.generate_private_key(ec.SECP256R1())],
    ids=["RSA", "P-256"],
)
def test_a_key_of_another_algorithm_is_refused(tmp_path: Path, key: PrivateKeyTypes) -> None:
    error = refused(tmp_path, pem(key), cert(LEAF, house().people), where="key.pem")
    assert "ed25519" in error.message


def test_the_key_of_another_leaf_is_refused(tmp_path: Path) -> None:
    other = chains.leaf(house().people, "operator-2")
    refused(tmp_path, pem(other.key), cert(LEAF, house().people), where="cert.pem")


@pytest.mark.parametrize(
    "chain",
    [
        cert(LEAF),
        cert(LEAF, house().people, house().root),
        cert(house().people, LEAF),
        b"",
        b"garbage",
        b"-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n",
    ],
    ids=["leaf only", "with root", "wrong order", "nothing", "garbage", "no certificate"],
)
def test_a_chain_that_is_not_leaf_then_authority_is_refused(tmp_path: Path, chain: bytes) -> None:
    refused(tmp_path, pem(LEAF.key), chain, where="cert.pem")


@pytest.mark.parametrize("missing", ["key.pem", "cert.pem"])
def test_a_file_that_is_not_there_is_a_fault_of_the_world(tmp_path: Path, missing: str) -> None:
    paths = files(tmp_path, pem(LEAF.key), cert(LEAF, house().people))
    (tmp_path / missing).unlink()
    with pytest.raises(EnvironmentFault) as caught:
        read_signer(*paths)
    assert caught.value.reason is Reason.FILE_UNAVAILABLE
    assert caught.value.where == str(tmp_path / missing)
