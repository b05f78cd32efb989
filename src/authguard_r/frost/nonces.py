# SPDX-License-Identifier: Apache-2.0
"""Nonces that are used once, also after a crash: two uses of one would give the share away.

Each pair lies in a file of its own. Using it first makes a second file beside it, which can be made
once only and is on the disk before the nonces are read. So after a crash they are not used again.
Spec page: docs/spec/frost.md#nonces
"""

from __future__ import annotations

import os
from pathlib import Path

from authguard_r.core.errors import RefusedError, StoreError
from authguard_r.core.reasons import Reason
from authguard_r.frost.messages import NonceCommitment, Nonces, digest, read, written


class NonceStore:
    """The unused nonces of one member on one machine.

    Never restore it from a backup: what was used since would look unused, unless the marks of use
    are kept too.

    Args:
        folder: of the member alone; made with mode 0700 when it is not there.

    Raises:
        StoreError: others can write there, or it cannot be made.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        try:
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            mode = folder.stat().st_mode
        except OSError as error:
            raise _broken(folder, error) from error
        if mode & 0o077:
            raise StoreError(f"expected `{folder}` to be its owner's alone", where=str(folder))

    def put(self, nonces: Nonces) -> NonceCommitment:
        """Return the commitment to hand out, once its nonces are on the disk.

        Raises:
            StoreError: they cannot be kept; nothing was handed out.
        """
        path = self._path(nonces.commitment, "nonces")
        write_new(path, written(nonces))
        return nonces.commitment

    def take(self, commitment: NonceCommitment) -> Nonces:
        """Return the nonces behind a commitment, for the one use that they have.

        Raises:
            RefusedError: they were used, or were never made here.
            StoreError: that they are used cannot be kept; they were not read.
        """
        path, used = self._path(commitment, "nonces"), self._path(commitment, "used")
        if not path.exists() and not used.exists():
            raise RefusedError(
                "expected a commitment that was made here",
                reason=Reason.KEY_INVALID,
                where=path.name,
            )
        if used.exists():
            raise _used(path)
        try:
            write_new(used, b"used\n")
        except StoreError as error:
            if used.exists():  # another process was first
                raise _used(path) from error
            raise
        try:
            data = path.read_bytes()
            path.unlink()
            _flush(self._folder)
        except OSError as error:
            raise _broken(path, error) from error
        return read(data, Nonces, where="nonces")

    def _path(self, commitment: NonceCommitment, kind: str) -> Path:
        return self._folder / f"{digest(commitment)}.{kind}"


def write_new(path: Path, data: bytes) -> None:
    """Write a file that was not there, readable by its owner alone; it is on the disk afterwards.

    Raises:
        StoreError: it was there, or cannot be written.
    """
    try:
        opened = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o600)
        with os.fdopen(opened, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        _flush(path.parent)
    except OSError as error:
        raise _broken(path, error) from error


def _flush(folder: Path) -> None:
    opened = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(opened)
    finally:
        os.close(opened)


def _used(path: Path) -> RefusedError:
    return RefusedError(
        "expected a commitment that was never signed with",
        reason=Reason.KEY_REUSED,
        where=path.name,
    )


def _broken(path: Path, error: OSError) -> StoreError:
    return StoreError(f"cannot use `{path}`: {error.strerror}", where=str(path))
