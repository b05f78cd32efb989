# SPDX-License-Identifier: Apache-2.0
"""Files written whole or not at all, and never over a private key.

Spec page: docs/spec/token.md#key-files
"""

from __future__ import annotations

import os
import secrets
import stat
from contextlib import suppress
from pathlib import Path

from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

from authguard_r.core.errors import EnvironmentFault
from authguard_r.core.reasons import Reason
from authguard_r.keys.algorithms import PrivateKey
from authguard_r.keys.envelope import is_sealed

#: Files that only their owner may read: keys, and files that say what a robot is to do.
PRIVATE = 0o600
#: How much of a file is read to see whether it is a private key.
_HEAD_BYTES = 65_536
_MARK = b"PRIVATE KEY-----"
_KEY_END = ".key.pem"


def write_whole(path: Path, data: bytes, *, mode: int | None = None, over: bool = False) -> None:
    """Write a file so that a reader finds all of it, or what was there before.

    Args:
        path: the file; a link is replaced, not what it leads to.
        data: all of it.
        mode: its mode, independent of the umask; None: as the umask says, and never writable by
            others.
        over: a private key may lie there: the caller replaces it by itself in another form.

    Raises:
        EnvironmentFault: nothing took its place, or a private key lies there.
    """
    if not over and holds_key(path):
        raise _in_the_way(f"`{path}` holds a private key: name another file", path)
    _place(path, data, mode)


def write_keys(path: Path, *keys: PrivateKey) -> None:
    """Write new keys, readable by their owner alone from the first byte on, or nothing.

    Raises:
        EnvironmentFault: something lies there, or they could not be written.
    """
    if os.path.lexists(path):
        raise _in_the_way(f"`{path}` is there already", path)
    form = (Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    _place(path, b"".join(key.private_bytes(*form) for key in keys), 0o600)


def holds_key(path: Path) -> bool:
    """Return whether a private key lies there, plain or sealed.

    What may not be read is one when its name says so.
    """
    try:
        head = _head(path)
    except OSError:
        return path.name.endswith(_KEY_END) and os.path.lexists(path)
    return _MARK in head or is_sealed(head)


def holds_plain_key(path: Path) -> bool:
    """Return whether a private key lies there that any reader of the file can use."""
    try:
        return _MARK in _head(path)
    except OSError:
        return False  # that it cannot be read is said elsewhere


def read_private(path: Path, *, where: str) -> bytes:
    """Return the bytes of a file that its owner alone can read: this user, or root.

    Args:
        path: a passphrase, a token or a private key.
        where: the option that named it, for messages.

    Raises:
        EnvironmentFault: it cannot be read, or others may read or own it.
    """
    try:
        with path.open("rb") as file:  # what is checked is what is read, under any name
            held = os.fstat(file.fileno())
            mode = stat.S_IMODE(held.st_mode)
            if mode & 0o077 or held.st_uid not in {0, os.geteuid()}:
                raise EnvironmentFault(
                    f"others can read or own it (mode {mode:o}): chmod 600 `{path}`",
                    reason=Reason.FILE_UNAVAILABLE,
                    where=where,
                )
            return file.read()
    except OSError as error:
        raise EnvironmentFault(
            f"cannot read `{path}`: {error.strerror}",
            reason=Reason.FILE_UNAVAILABLE,
            where=str(path),
        ) from error


def _head(path: Path) -> bytes:
    if not path.is_file():  # a pipe would be waited for
        return b""
    with path.open("rb") as file:
        return file.read(_HEAD_BYTES)


def _place(path: Path, data: bytes, mode: int | None) -> None:
    # beside it, for a rename goes across no file system; a name that no other file has
    new = path.parent / f".{path.name}.{secrets.token_hex(8)}"
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
    try:
        with os.fdopen(os.open(new, flags, 0o644 if mode is None else mode), "wb") as file:
            file.write(data)
            file.flush()
            if mode is not None:
                os.fchmod(file.fileno(), mode)
            os.fsync(file.fileno())
        new.replace(path)
    except OSError as error:
        raise _in_the_way(f"cannot write `{path}`: {error.strerror}", path) from error
    finally:
        with suppress(OSError):  # it has its place by now, or it is incomplete
            new.unlink()


def _in_the_way(message: str, path: Path) -> EnvironmentFault:
    return EnvironmentFault(message, reason=Reason.FILE_UNAVAILABLE, where=str(path))
