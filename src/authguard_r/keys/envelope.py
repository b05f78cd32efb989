# SPDX-License-Identifier: Apache-2.0
"""A person's key file, sealed with a passphrase: Argon2id and AES-256-GCM.

Encrypted PEM derives its key in 2,048 rounds of PBKDF2, so that a thief of the file can guess
quickly (L18); here each guess costs 64 MiB and a tenth of a second. What a file asks for is held to
bounds before anything is derived. Spec page: docs/spec/token.md#key-files
"""

from __future__ import annotations

import os
import unicodedata
from base64 import b64decode, b64encode
from binascii import Error as Base64Error
from typing import Annotated, Final, Literal

import msgspec
from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import AESGCM
from cryptography.hazmat.primitives.kdf.argon2 import Argon2id
from msgspec import Meta, Struct

from authguard_r.core.encoding import b64, decode, encode, unb64
from authguard_r.core.errors import AuthenticityError, EnvironmentFault, MalformedError
from authguard_r.core.reasons import Reason

#: Longest key file, in bytes: far above any two keys, far below a memory problem.
MAX_FILE = 1 << 16
#: Shortest passphrase that seals, in characters; a file that is there opens with what it has.
MIN_PASSPHRASE = 12
#: Longest passphrase, in characters.
MAX_PASSPHRASE = 1_024
#: Said in front of the header when it is authenticated: no other use of a key has the same bytes.
_DOMAIN = b"authguard-r/key-file/1\0"
_BEGIN = b"-----BEGIN AUTHGUARD-R ENCRYPTED KEY-----"
_END = b"-----END AUTHGUARD-R ENCRYPTED KEY-----"
_FORMAT: Final = 1
_SALT, _NONCE, _KEY = 16, 12, 32
_COLUMNS = 64
_MEND = "restore the file from a copy, or ask for a new key"


class EnvelopeHeader(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How a file was sealed; the writer of the file chose it, within these bounds.

    Args:
        cipher: what the keys are sealed with.
        format: the format's version.
        kdf: what makes a key of the passphrase.
        lanes: how many lanes of it.
        memory_kib: its memory, from 64 to 512 MiB.
        nonce: 12 bytes, base64url; fresh for each file.
        passes: how often it goes over its memory.
        salt: 16 bytes, base64url; fresh for each file.
    """

    cipher: Literal["aes-256-gcm"]
    format: Literal[1]
    kdf: Literal["argon2id"]
    lanes: Annotated[int, Meta(ge=1, le=16)]
    memory_kib: Annotated[int, Meta(ge=1 << 16, le=1 << 19)]
    nonce: str
    passes: Annotated[int, Meta(ge=3, le=10)]
    salt: str


class Envelope(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A sealed key file.

    Args:
        ciphertext: the PEM text of the keys and the tag, base64url.
        header: how it was sealed; authentic once the file opens, and not before.
    """

    ciphertext: str
    header: EnvelopeHeader


class _Format(Struct, frozen=True):
    """The one field that every version has."""

    format: int


class _Versioned(Struct, frozen=True):
    header: _Format


def is_sealed(data: bytes) -> bool:
    """Return whether a file says that it is a sealed key; nothing of it was looked at yet."""
    return _BEGIN in data


def seal(pem: bytes, passphrase: str) -> bytes:
    """Return a key file that opens with the passphrase alone.

    Args:
        pem: the PEM text of private keys.
        passphrase: what a person keeps; at least 12 characters.

    Raises:
        MalformedError: the passphrase is too short or too long, or the text is too long.
        EnvironmentFault: there is not enough memory.
    """
    if len(passphrase) < MIN_PASSPHRASE:
        raise MalformedError(
            f"expected at least {MIN_PASSPHRASE} characters; take several words",
            where="passphrase",
        )
    header = EnvelopeHeader(
        cipher="aes-256-gcm",
        format=_FORMAT,
        kdf="argon2id",
        lanes=4,
        memory_kib=1 << 16,
        nonce=b64(os.urandom(_NONCE)),
        passes=3,
        salt=b64(os.urandom(_SALT)),
    )
    key = _derive(header, passphrase, where="passphrase")
    sealed = AESGCM(key).encrypt(unb64(header.nonce), pem, _authenticated(header))
    data = _armored(encode(Envelope(ciphertext=b64(sealed), header=header)))
    if len(data) > MAX_FILE:
        raise MalformedError(f"expected keys of at most {MAX_FILE} bytes when sealed", where="key")
    return data


def unseal(data: bytes, passphrase: str, *, where: str) -> bytes:
    """Return the PEM text in a sealed key file; authentic: as it was when it was sealed.

    Args:
        data: the file; its writer may be anyone.
        passphrase: what a person said.
        where: the file, for messages.

    Raises:
        MalformedError: no sealed key file, of another format, or asking for more than it may.
        AuthenticityError: the passphrase is wrong or the file was changed; nothing says which.
        EnvironmentFault: there is not enough memory.
    """
    envelope = read_envelope(data, where=where)
    header = envelope.header
    sealed = unb64(envelope.ciphertext)
    key = _derive(header, passphrase, where=where)
    try:
        return AESGCM(key).decrypt(unb64(header.nonce), sealed, _authenticated(header))
    except InvalidTag as error:
        raise AuthenticityError(
            f"the passphrase is wrong, or the file was changed; try again, or {_MEND}",
            reason=Reason.KEY_INVALID,
            where=where,
        ) from error


def read_envelope(data: bytes, *, where: str) -> Envelope:
    """Return what a sealed key file says, with nothing derived and nothing authentic yet.

    Raises:
        MalformedError: it is damaged, of another format, or asks for more than it may.
    """
    text = _unarmored(data, where=where)
    _require_format(text, where=where)
    try:
        return _sound(
            decode(text, Envelope, where=f"{where}: envelope"), where=f"{where}: envelope"
        )
    except MalformedError as error:
        message = f"{error.message}; {_MEND}"
        raise MalformedError(message, where=error.where, reason=error.reason) from error


def _sound(envelope: Envelope, *, where: str) -> Envelope:
    """Return the envelope when its bytes are spelled right and of the right length."""
    header = envelope.header
    for name, spelled, size in (("nonce", header.nonce, _NONCE), ("salt", header.salt, _SALT)):
        place = f"{where}.header.{name}"
        if len(unb64(spelled, where=place)) != size:
            raise MalformedError(f"expected {size} bytes", where=place)
    unb64(envelope.ciphertext, where=f"{where}.ciphertext")
    return envelope


def _require_format(text: bytes, *, where: str) -> None:
    """Tell a later version from damage: its fields may be others."""
    try:
        found = msgspec.json.decode(text, type=_Versioned).header.format
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise MalformedError(f"expected a sealed key; {_MEND}", where=where) from error
    if found != _FORMAT:
        raise MalformedError(
            f"expected format {_FORMAT}, got {found}; open it with the version that sealed it",
            where=f"{where}: envelope.header.format",
        )


def _derive(header: EnvelopeHeader, passphrase: str, *, where: str) -> bytes:
    """Return the key that a passphrase makes; however it was typed, the same text is the same."""
    if not 0 < len(passphrase) <= MAX_PASSPHRASE:
        raise MalformedError(
            f"expected a passphrase of 1 to {MAX_PASSPHRASE} characters", where="passphrase"
        )
    try:
        spelled = unicodedata.normalize("NFC", passphrase).encode("utf-8")
    except UnicodeEncodeError as error:
        raise MalformedError("expected text in UTF-8", where="passphrase") from error
    kdf = Argon2id(
        salt=unb64(header.salt),
        length=_KEY,
        iterations=header.passes,
        lanes=header.lanes,
        memory_cost=header.memory_kib,
    )
    try:
        return kdf.derive(spelled)
    except MemoryError as error:
        raise EnvironmentFault(
            f"no {header.memory_kib >> 10} MiB of memory for the passphrase; end another program",
            reason=Reason.BUSY,
            where=where,
        ) from error


def _authenticated(header: EnvelopeHeader) -> bytes:
    return _DOMAIN + encode(header)


def _armored(text: bytes) -> bytes:
    spelled = b64encode(text)
    lines = [spelled[at : at + _COLUMNS] for at in range(0, len(spelled), _COLUMNS)]
    return b"\n".join([_BEGIN, *lines, _END, b""])


def _unarmored(data: bytes, *, where: str) -> bytes:
    """Return what lies between the two lines; line ends may be another system's.

    Raises:
        MalformedError: too long, other lines around it, or a second spelling of the same bytes.
    """
    if len(data) > MAX_FILE:
        raise MalformedError(
            f"expected at most {MAX_FILE} bytes, got {len(data)}; {_MEND}", where=where
        )
    message = f"expected a sealed key and nothing else; {_MEND}"
    block = data.replace(b"\r\n", b"\n").strip()
    body = block.removeprefix(_BEGIN).removesuffix(_END)
    try:
        text = b64decode(body.replace(b"\n", b""), validate=True)
    except Base64Error as error:
        raise MalformedError(message, where=where) from error
    if _armored(text) != block + b"\n":
        raise MalformedError(message, where=where, reason=Reason.NOT_CANONICAL)
    return text
