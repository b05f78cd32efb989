# SPDX-License-Identifier: Apache-2.0
"""Files of a witness: replaced whole and durably, and readable and writable by its user alone.

Spec page: docs/spec/witness.md#state
"""

from __future__ import annotations

import fcntl
import os
import stat
from contextlib import suppress
from pathlib import Path

from authguard_r.core.errors import EnvironmentFault
from authguard_r.core.reasons import Reason

#: Longest file that is read, in bytes; what is longer was not written here.
MAX_BYTES = 1 << 18
_READ = os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
_NEW = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC | os.O_NOFOLLOW
_ADD = os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC | os.O_NOFOLLOW
_HELD = os.O_RDONLY | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW
_FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC


def replace_file(path: Path, data: bytes) -> None:
    """Put a file in a path's place; it survives a power cut once this returns.

    Written beside, synced, renamed, and the folder synced: after a crash there is the one or the
    other. What lies beside is never read.

    Raises:
        EnvironmentFault: the one or the other is there.
    """
    beside = path.with_name(f"{path.name}.new")
    try:
        with suppress(FileNotFoundError):
            beside.unlink()
        _write(os.open(beside, _NEW, 0o600), data)
        beside.replace(path)
        sync_folder(path.parent)
    except OSError as error:
        raise fault("cannot be written", path, error) from error


def append_line(path: Path, line: bytes) -> None:
    """Add a line to a file; it survives a power cut once this returns.

    Raises:
        EnvironmentFault: it may be there, a part of it or nothing.
    """
    try:
        _write(os.open(path, _ADD, 0o600), line + b"\n")
        sync_folder(path.parent)
    except OSError as error:
        raise fault("cannot be written", path, error) from error


def read_file(path: Path, *, most: int = MAX_BYTES) -> bytes | None:
    """Return a file's bytes, None where there is none.

    Args:
        path: the file; a link is not followed.
        most: how long it may be.

    Raises:
        EnvironmentFault: it cannot be read, is no file, or is longer than any of ours.
    """
    try:
        file = os.open(path, _READ)
        try:
            return _read(file, path, most)
        finally:
            os.close(file)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise fault("cannot be read", path, error) from error


def make_folder(path: Path) -> None:
    """Make a folder that is its owner's alone, and have its name on disk.

    Raises:
        EnvironmentFault: it could not be made.
    """
    try:
        path.mkdir(mode=0o700)
        sync_folder(path.parent)
    except OSError as error:
        raise fault("cannot be made", path, error) from error


def sync_folder(path: Path) -> None:
    """Make every name in a folder last."""
    file = os.open(path, _FOLDER)
    try:
        os.fsync(file)
    finally:
        os.close(file)


def hold(path: Path) -> int:
    """Return the open file that says that this process alone works here; closing it lets go.

    Raises:
        EnvironmentFault: another process does, or the file cannot be opened.
    """
    try:
        file = os.open(path, _HELD, 0o600)
    except OSError as error:
        raise fault("cannot be locked", path, error) from error
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(file)
        raise EnvironmentFault(
            "another process uses this folder: end the witness that serves it first",
            reason=Reason.SERVICE_UNAVAILABLE,
            where=str(path),
        ) from error
    return file


def require_own(path: Path, uid: int) -> None:
    """Require that a file or folder is this user's, and that no other user can read or write it.

    Raises:
        EnvironmentFault: it is not, or is not there.
    """
    try:
        found = path.lstat()
    except OSError as error:
        raise fault("cannot be looked at", path, error) from error
    mode = stat.S_IMODE(found.st_mode)
    if not (stat.S_ISREG(found.st_mode) or stat.S_ISDIR(found.st_mode)):
        raise unsafe("expected a file or a folder", path)
    if found.st_uid != uid:
        raise unsafe(f"owned by user {found.st_uid}, and this is user {uid}", path)
    if mode & 0o077:
        raise unsafe(f"open to others (mode {mode:o}); chmod go-rwx", path)


def require_safe_above(path: Path, uid: int) -> None:
    """Require that no other user can put another folder in this one's place.

    In a folder with the sticky bit, like `/tmp`, a user cannot touch what another user put there.

    Raises:
        EnvironmentFault: another user can.
    """
    for folder in path.resolve().parents:
        found = folder.stat()
        mode = stat.S_IMODE(found.st_mode)
        if found.st_uid not in {0, uid}:
            raise unsafe(f"owned by user {found.st_uid}", folder)
        if mode & 0o022 and not mode & stat.S_ISVTX:
            raise unsafe(f"writable by others (mode {mode:o})", folder)


def fault(what: str, path: Path, error: OSError) -> EnvironmentFault:
    """Return our word for the system's."""
    return EnvironmentFault(
        f"`{path.name}` {what}: {error.strerror or error}",
        reason=Reason.FILE_UNAVAILABLE,
        where=str(path),
    )


def unsafe(message: str, path: Path) -> EnvironmentFault:
    """Return that others have their hands on something."""
    return EnvironmentFault(message, reason=Reason.FILE_UNAVAILABLE, where=str(path))


def _write(file: int, data: bytes) -> None:
    """Write everything, have it on disk, and let go."""
    try:
        while data:
            data = data[os.write(file, data) :]
        os.fsync(file)
    finally:
        os.close(file)


def _read(file: int, path: Path, most: int) -> bytes:
    found = os.fstat(file)
    if not stat.S_ISREG(found.st_mode) or found.st_size > most:
        raise EnvironmentFault(
            "expected a file of this program", reason=Reason.STORE_CORRUPT, where=str(path)
        )
    parts: list[bytes] = []
    while part := os.read(file, MAX_BYTES):
        parts.append(part)
    return b"".join(parts)
