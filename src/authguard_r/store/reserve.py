# SPDX-License-Identifier: Apache-2.0
"""Reserved disk space, freed when an outcome or a stop has no room.

A full disk, by a flood of proposals or by anything else on the machine, must not keep the gate from
writing down what the robot did. Spec page: docs/spec/store.md#reserve
"""

from __future__ import annotations

import os
import threading
from contextlib import suppress
from pathlib import Path

#: Bytes in a block as `stat` counts them, on every file system.
_BLOCK = 512


class Reserve:
    """Space that is allocated for nothing, in `<store>.reserve`, mode 0600.

    Args:
        store: the store's file.
        size_bytes: 0 keeps no ballast; then it is never gone and there is always room.
    """

    def __init__(self, store: Path, size_bytes: int) -> None:
        self._path = store.with_name(f"{store.name}.reserve")
        self._size = size_bytes
        self._lock = threading.Lock()
        self._is_held = size_bytes == 0 or self._is_there()
        self.restore()

    @property
    def is_gone(self) -> bool:
        """True when the reserve was freed, or could never be allocated."""
        return not self._is_held

    def let_go(self) -> bool:
        """Give the space back to the file system; False when there was none to give."""
        if self._size == 0 or self.is_gone:
            return False
        with self._lock, suppress(OSError):
            self._is_held = False
            self._path.unlink(missing_ok=True)
        return True

    def restore(self) -> bool:
        """Allocate the ballast if it is gone and fits; True while as much is free beside it."""
        if self._size == 0:
            return True
        with self._lock, suppress(OSError):
            # looked at first: trying alone would take the last block from an essential job
            if not self._is_held and self._free_bytes() >= self._size:
                self._allocate()
                self._is_held = True
            return self._is_held and self._free_bytes() >= self._size
        return False

    def _is_there(self) -> bool:
        """True when an earlier run left the whole ballast, not a hole of its size."""
        with suppress(OSError):
            found = self._path.lstat()
            return found.st_size == self._size and found.st_blocks * _BLOCK >= self._size
        return False

    def _free_bytes(self) -> int:
        found = os.statvfs(self._path.parent)
        return found.f_bavail * found.f_frsize

    def _allocate(self) -> None:
        self._path.unlink(missing_ok=True)
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
        handle = os.open(self._path, flags, 0o600)
        try:
            os.posix_fallocate(handle, 0, self._size)
        except OSError:
            self._path.unlink(missing_ok=True)  # what it got is not enough
            raise
        finally:
            os.close(handle)
