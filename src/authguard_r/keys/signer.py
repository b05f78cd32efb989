# SPDX-License-Identifier: Apache-2.0
"""Private keys: in plain files, in sealed ones, or in hardware.

Implements the core's `Signer`. A plain PKCS8 file with mode 0600 is for services, which cannot ask
for a passphrase; a person's key is sealed (`keys.envelope`) or in hardware (`keys.pkcs11`). Spec
page: docs/spec/token.md#key-files
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from cryptography import x509
from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDF
from cryptography.hazmat.primitives.serialization import Encoding, load_pem_private_key

from authguard_r.core.errors import AuthenticityError, EnvironmentFault
from authguard_r.core.identifiers import RobotId
from authguard_r.core.principals import Endorsed
from authguard_r.core.reasons import Reason
from authguard_r.keys.algorithms import PRIVATE, PrivateKey, PublicKey, require_private
from authguard_r.keys.envelope import is_sealed, unseal
from authguard_r.keys.trust import read_file

_BLOCK = re.compile(rb"-----BEGIN [A-Z ]+-----.*?-----END [A-Z ]+-----", re.DOTALL)
#: What other tools write in an encrypted key: a label of its own, or a line of headers.
_FOREIGN = (b"BEGIN ENCRYPTED PRIVATE KEY", b"Proc-Type: 4,ENCRYPTED")
_PLAIN = "expected an unencrypted PKCS8 PEM key"
_SEALED = (
    "the key is sealed, and there is no terminal to ask for its passphrase: name a file with "
    "--passphrase-file; a gate's own key is plain: `authguard keys unprotect`"
)

#: Asks for the passphrase of a file, or the PIN of a token, that the text names.
Passphrase = Callable[[str], str]


class SigningKey(Protocol):
    """A private key that may be somewhere else: it can be used, and need not be had."""

    def sign(self, data: bytes, /) -> bytes:
        """Return the signature over the data."""
        ...

    def public_key(self) -> PublicKey:
        """Return the key that verifies it."""
        ...


#: A key with the certificates that say whose it is: leaf, then its role authority's, DER.
Held = tuple[SigningKey, tuple[bytes, ...]]


class FileSigner:
    """A principal's private keys with the certificates that say whose they are.

    Args:
        key: the first key.
        chain: its certificates.
        others: under further roots, the keys that have to sign beside it.
    """

    def __init__(self, key: SigningKey, chain: tuple[bytes, ...], *others: Held) -> None:
        self._held: tuple[Held, ...] = ((key, chain), *others)

    @property
    def chain(self) -> tuple[bytes, ...]:
        """Leaf certificate and its role authority's, DER; of the first key."""
        return self._held[0][1]

    def endorse(self, message: bytes) -> tuple[Endorsed, ...]:
        """Return chain and signature of every key (`core.ports.Signer`)."""
        return tuple((chain, key.sign(message)) for key, chain in self._held)

    def secret(self, purpose: bytes) -> bytes:
        """Return 32 bytes that cannot be made without every key; others for another purpose.

        Raises:
            AuthenticityError: a key lies in hardware and does not come out (`KEY_INVALID`).
        """
        keys = [key.private_bytes_raw() for key, _ in self._held if isinstance(key, PRIVATE)]
        if len(keys) < len(self._held):
            raise AuthenticityError("expected keys in a file", reason=Reason.KEY_INVALID)
        return HKDF(SHA256(), 32, salt=None, info=purpose).derive(b"".join(keys))


def read_signer(
    key_path: Path, chain_path: Path, passphrase: Passphrase | None = None
) -> FileSigner:
    """Return the signer of a file of keys and a PEM file with leaf and authority of each.

    Args:
        key_path: plain PEM, or sealed.
        chain_path: the certificates.
        passphrase: asked once, and only for a sealed file; None when no person can be asked.

    Raises:
        EnvironmentFault: a file cannot be read.
        MalformedError: a sealed file is damaged, or of another format.
        AuthenticityError: the passphrase is wrong, a key is of no known algorithm, or is not its
            leaf's.
    """
    return certified(open_key_file(key_path, passphrase), chain_path)


def open_key_file(path: Path, passphrase: Passphrase | None = None) -> tuple[PrivateKey, ...]:
    """Return the keys in a file, plain or sealed.

    Raises:
        EnvironmentFault: it cannot be read.
        MalformedError: it is sealed and damaged, or of another format.
        AuthenticityError: the passphrase is wrong, or a key is of no known algorithm.
    """
    return read_keys(plain_pem(path, passphrase), path)


def certified(keys: tuple[SigningKey, ...], chain_path: Path) -> FileSigner:
    """Return the signer of keys and a PEM file with leaf and authority of each, in their order.

    Raises:
        EnvironmentFault: the file cannot be read.
        AuthenticityError: it holds something else, or certificates of other keys.
    """
    try:
        found = x509.load_pem_x509_certificates(read_file(chain_path))
        chains = list(zip(found[::2], found[1::2], strict=True))
        fits = [chain[0].public_key() for chain in chains] == [key.public_key() for key in keys]
    except (ValueError, x509.InvalidVersion, UnsupportedAlgorithm) as error:
        raise _bad("expected PEM certificates", chain_path) from error
    if not fits:
        raise _bad("expected each key's own certificate, then its authority's", chain_path)
    ders = [tuple(cert.public_bytes(Encoding.DER) for cert in chain) for chain in chains]
    return FileSigner(keys[0], ders[0], *zip(keys[1:], ders[1:], strict=True))


def read_keys(data: bytes, path: Path) -> tuple[PrivateKey, ...]:
    """Return the keys in plain PEM text, at least one.

    Args:
        data: the text.
        path: where it was, for messages.

    Raises:
        AuthenticityError: there is no key, one is encrypted, or is of no known algorithm.
    """
    if any(mark in data for mark in _FOREIGN):
        # 2,048 rounds of PBKDF2 (L18): what looks protected and is not is worse than plain
        raise _bad(
            "expected a key that `authguard keys protect` sealed, or a plain one; another tool "
            "encrypted this one, too weakly: decrypt it there, then `authguard keys protect` it",
            path,
        )
    blocks = _BLOCK.findall(data)
    if not blocks:
        raise _bad(_PLAIN, path)
    return tuple(_key(block, path) for block in blocks)


def plain_pem(path: Path, passphrase: Passphrase | None = None) -> bytes:
    """Return the PEM text of a key file, plain or sealed; the keys in it are not checked.

    Raises:
        EnvironmentFault: it cannot be read.
        MalformedError: it is sealed and damaged, or of another format.
        AuthenticityError: the passphrase is wrong, or no person can be asked.
    """
    data = read_file(path)
    if not is_sealed(data):
        return data
    if passphrase is None:
        raise _bad(_SEALED, path)
    return unseal(data, passphrase(str(path)), where=str(path))


def _key(block: bytes, path: Path) -> PrivateKey:
    try:
        key = load_pem_private_key(block, None)
    except (ValueError, TypeError, UnsupportedAlgorithm) as error:
        raise _bad(_PLAIN, path) from error
    return require_private(key, where=str(path))


def _bad(message: str, path: Path) -> AuthenticityError:
    return AuthenticityError(message, reason=Reason.KEY_INVALID, where=str(path))


def folder_signer(folder: Path, name: str) -> FileSigner:
    """Return the signer that a one-folder set-up holds for a principal.

    Raises:
        EnvironmentFault: the folder has no such key.
    """
    key = folder / "keys" / f"{name}.key.pem"
    if not key.is_file():
        text = f"`{folder}` holds no key of `{name}`"
        raise EnvironmentFault(text, reason=Reason.FILE_UNAVAILABLE, where=str(key))
    return read_signer(key, folder / "keys" / f"{name}.cert.pem")


def gate_name(rid: RobotId) -> str:
    """Return the name under which a one-folder set-up keeps a robot's gate."""
    return f"gate-{rid}"
