# SPDX-License-Identifier: Apache-2.0
"""Private keys in files.

Implements the core's `Signer`. Plain PKCS8 files with mode 0600: for services and demos; a
person's key belongs in hardware or in an encrypted envelope (LIMITATIONS.md).
"""

from __future__ import annotations

from pathlib import Path

from cryptography import x509
from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, load_pem_private_key

from authguard_r.core.errors import AuthenticityError
from authguard_r.core.reasons import Reason
from authguard_r.keys.trust import read_file


class FileSigner:
    """A private key with the certificates that say whose it is."""

    def __init__(self, key: Ed25519PrivateKey, chain: tuple[bytes, ...]) -> None:
        self._key = key
        self._chain = chain

    @property
    def chain(self) -> tuple[bytes, ...]:
        """Leaf certificate and its role authority's, DER."""
        return self._chain

    def sign(self, message: bytes) -> bytes:
        """Return the Ed25519 signature over the message."""
        return self._key.sign(message)


def read_signer(key_path: Path, chain_path: Path) -> FileSigner:
    """Return the signer of a PKCS8 PEM key and a PEM file with leaf and authority.

    Raises:
        EnvironmentFault: a file cannot be read.
        AuthenticityError: the key is no Ed25519 key, or is not the leaf's.
    """
    try:
        key = load_pem_private_key(read_file(key_path), None)
    except (ValueError, TypeError, UnsupportedAlgorithm) as error:
        raise _bad("expected an unencrypted PKCS8 PEM key", key_path) from error
    if not isinstance(key, Ed25519PrivateKey):
        raise _bad("expected an Ed25519 key", key_path)
    try:
        chain = x509.load_pem_x509_certificates(read_file(chain_path))
        fits = len(chain) == 2 and chain[0].public_key() == key.public_key()
    except (ValueError, x509.InvalidVersion, UnsupportedAlgorithm) as error:
        raise _bad("expected PEM certificates", chain_path) from error
    if not fits:
        raise _bad("expected the key's own certificate, then its authority's", chain_path)
    return FileSigner(key, tuple(cert.public_bytes(Encoding.DER) for cert in chain))


def _bad(message: str, path: Path) -> AuthenticityError:
    return AuthenticityError(message, reason=Reason.KEY_INVALID, where=str(path))
