# SPDX-License-Identifier: Apache-2.0
"""Keys of those who may read sealed fields, and how a field's key is wrapped for one of them.

HPKE (RFC 9180), base mode: X25519, HKDF-SHA256, AES-256-GCM; or, where what is written today must
stay closed to a quantum computer of tomorrow, ML-KEM-768 with X25519 in the place of X25519. Which
of the two is the key's, never the log's. A reader's key signs nothing and grants nothing, so it
has no certificate: the signed gate configuration names it.

Spec page: docs/spec/sealed-fields.md#readers
"""

from __future__ import annotations

import re
from pathlib import Path

from cryptography.exceptions import InvalidTag, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.mlkem import MLKEM768PrivateKey, MLKEM768PublicKey
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey, X25519PublicKey
from cryptography.hazmat.primitives.hpke import (
    AEAD,
    KDF,
    KEM,
    MLKEM768X25519PrivateKey,
    MLKEM768X25519PublicKey,
    Suite,
)
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_pem_private_key,
)

from authguard_r.core.encoding import Tag, b64, digest, unb64
from authguard_r.core.errors import AuthenticityError, MalformedError
from authguard_r.core.identifiers import Digest
from authguard_r.core.reasons import Reason
from authguard_r.keys.signer import Passphrase, plain_pem

_PLAIN = Suite(KEM.X25519, KDF.HKDF_SHA256, AEAD.AES_256_GCM)
_HYBRID = Suite(KEM.MLKEM768_X25519, KDF.HKDF_SHA256, AEAD.AES_256_GCM)
#: Bytes of the public keys; a hybrid one is both, ML-KEM's first.
_X25519, _MLKEM = 32, 1_184
_BLOCK = re.compile(rb"-----BEGIN PRIVATE KEY-----.+?-----END PRIVATE KEY-----", re.DOTALL)


class ReaderPublic:
    """A reader's public key: what is wrapped for it, only its owner opens.

    Args:
        raw: 32 bytes of X25519, or 1,184 of ML-KEM-768 and then these.

    Raises:
        MalformedError: it is neither.
    """

    def __init__(self, raw: bytes, *, where: str = "key") -> None:
        self.raw = raw
        try:
            x25519 = X25519PublicKey.from_public_bytes(raw[-_X25519:])
            if len(raw) == _X25519:
                self._suite, self._key = _PLAIN, x25519
                return
            mlkem = MLKEM768PublicKey.from_public_bytes(raw[:-_X25519])
        except ValueError as error:
            text = f"expected a public key of X25519 or of ML-KEM-768 and X25519: {error}"
            raise MalformedError(text, where=where, reason=Reason.KEY_INVALID) from error
        self._suite, self._key = _HYBRID, MLKEM768X25519PublicKey(mlkem, x25519)

    _suite: Suite
    _key: X25519PublicKey | MLKEM768X25519PublicKey

    @property
    def name(self) -> Digest:
        """What distinguishes this key from others."""
        return digest(Tag.RAW, self.raw)

    def text(self) -> str:
        """Return the key as a configuration has it, base64url."""
        return b64(self.raw)

    def wrap(self, secret: bytes, info: bytes) -> bytes:
        """Return `enc || ct` of HPKE: opens with the private key and the same `info` alone."""
        return self._suite.encrypt(secret, self._key, info)


class ReaderKey:
    """A reader's private key.

    Args:
        x25519: of both kinds of key.
        mlkem: of a hybrid one.
    """

    def __init__(self, x25519: X25519PrivateKey, mlkem: MLKEM768PrivateKey | None = None) -> None:
        self._parts = (x25519,) if mlkem is None else (mlkem, x25519)
        self._suite = _PLAIN if mlkem is None else _HYBRID
        self._key = x25519 if mlkem is None else MLKEM768X25519PrivateKey(mlkem, x25519)
        raw = b"".join(part.public_key().public_bytes_raw() for part in self._parts)
        self.public = ReaderPublic(raw)

    def pem(self) -> bytes:
        """Return the key as a file holds it, unprotected."""
        form = (Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
        return b"".join(part.private_bytes(*form) for part in self._parts)

    def unwrap(self, wrapped: bytes, info: bytes, *, where: str) -> bytes:
        """Return what was wrapped for this key.

        Raises:
            AuthenticityError: it was wrapped for another key, under another name, or was changed.
        """
        try:
            return self._suite.decrypt(wrapped, self._key, info)
        except (InvalidTag, ValueError) as error:
            raise AuthenticityError(
                "this key does not open what the log says was wrapped for it",
                reason=Reason.KEY_INVALID,
                where=where,
            ) from error


def new_reader(*, hybrid: bool = False) -> ReaderKey:
    """Return a fresh key of a reader."""
    return ReaderKey(X25519PrivateKey.generate(), MLKEM768PrivateKey.generate() if hybrid else None)


def read_reader(path: Path, passphrase: Passphrase | None = None) -> ReaderKey:
    """Return the key in a reader's file, plain or sealed.

    Raises:
        EnvironmentFault: it cannot be read.
        MalformedError: it is sealed and damaged.
        AuthenticityError: the passphrase is wrong, or it holds no key of a reader.
    """
    blocks = _BLOCK.findall(plain_pem(path, passphrase))
    try:
        keys = [load_pem_private_key(block, None) for block in blocks]
    except (ValueError, TypeError, UnsupportedAlgorithm):
        keys = []
    match keys:
        case [X25519PrivateKey() as x25519]:
            return ReaderKey(x25519)
        case [MLKEM768PrivateKey() as mlkem, X25519PrivateKey() as x25519]:
            return ReaderKey(x25519, mlkem)
    raise AuthenticityError(
        "expected the key of a reader, as `authguard audit reader` makes it",
        reason=Reason.KEY_INVALID,
        where=str(path),
    )


def read_public(text: str, *, where: str) -> ReaderPublic:
    """Return the public key that a configuration spells, once something was wrapped for it.

    Raises:
        MalformedError: it is not valid, or one that keeps no secret.
    """
    found = ReaderPublic(unb64(text, where=where), where=where)
    try:
        found.wrap(b"", b"")
    except (InvalidTag, ValueError) as error:  # a point of low order
        text = "expected a public key that keeps a secret"
        raise MalformedError(text, where=where, reason=Reason.KEY_INVALID) from error
    return found
