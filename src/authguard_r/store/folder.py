# SPDX-License-Identifier: Apache-2.0
"""The folder beside a store that its segments lie in; a file in it is whole, or has no name yet.

Spec page: docs/spec/store.md#segments
"""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from authguard_r.core.errors import StoreError
from authguard_r.core.reasons import Reason

_REASONS = {
    errno.ENOSPC: Reason.STORE_FULL,
    errno.EDQUOT: Reason.STORE_FULL,
    errno.EROFS: Reason.STORE_READ_ONLY,
    errno.EACCES: Reason.STORE_READ_ONLY,
    errno.EPERM: Reason.STORE_READ_ONLY,
}


class Folder:
    """`<store>.segments`, mode 0700, made with its first file; a file in it has mode 0600.

    Every method raises StoreError when the file system does not let it be done.

    Args:
        store: the store's file.
    """

    def __init__(self, store: Path) -> None:
        self._path = store.with_name(f"{store.name}.segments")

    def place(self, name: str) -> str:
        """Return where a file lies."""
        return str(self._path / name)

    def has(self, name: str) -> bool:
        """True when there is such a file; a link to one does not count."""
        path = self._path / name
        return path.is_file() and not path.is_symlink()

    def names(self) -> tuple[str, ...]:
        """Return the names of everything in it, sorted; nothing when it is not there."""
        with self._told():
            if not self._path.is_dir():
                return ()
            return tuple(sorted(path.name for path in self._path.iterdir()))

    def size(self, name: str) -> int:
        """Return a file's size in bytes."""
        with self._told():
            return (self._path / name).stat().st_size

    def create(self, name: str) -> None:
        """Make an empty file, and the folder where it is missing; an old one of the name goes."""
        with self._told():
            if not self._path.is_dir():
                self._path.mkdir(mode=0o700)
                _sync(self._path.parent)
            (self._path / name).unlink(missing_ok=True)
            (self._path / name).touch(mode=0o600, exist_ok=False)

    def publish(self, part: str, name: str) -> None:
        """Give a file that is on disk its name, for good when this returns."""
        with self._told():
            (self._path / part).replace(self._path / name)
            _sync(self._path)

    def remove(self, name: str) -> None:
        """Let a file go, if it is there."""
        with self._told():
            (self._path / name).unlink(missing_ok=True)

    def free_bytes(self) -> int:
        """Return what the disk has left."""
        with self._told():
            found = os.statvfs(self._path.parent)
            return found.f_bavail * found.f_frsize

    @contextmanager
    def _told(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            reason = _REASONS.get(error.errno or 0, Reason.STORE_UNAVAILABLE)
            text = f"the store's segments: {error.strerror or error}"
            raise StoreError(text, reason=reason, where=str(self._path)) from error


def _sync(folder: Path) -> None:
    """Make the names in a folder last."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
