# SPDX-License-Identifier: Apache-2.0
"""The files of an archive or a folder, one after the other; none of them is written anywhere.

A source is somebody else's: a link, a name that leads out of it, a file that is too large or one
too many, and an archive that ends early are refused by name.
How-to: docs/howto/missionpair-recorded.md
"""

from __future__ import annotations

import gzip
import os
import stat
import tarfile
import zlib
from collections.abc import Iterator
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

#: Bytes of one file, of all files, and how many files there may be.
MEMBER_BYTES, SOURCE_BYTES, SOURCE_FILES = 8 << 20, 4 << 30, 200_000


class SourceError(Exception):
    """A source that cannot be read, or that holds what it must not.

    Args:
        message: what is wrong, and what is expected.
        where: the source, and the file in it.
    """

    def __init__(self, message: str, *, where: str) -> None:
        super().__init__(f"{where}: {message}")
        self.message, self.where = message, where

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how another process makes it again."""
        return partial(SourceError, where=self.where), (self.message,)


class SourceFile(NamedTuple):
    """One file of a source.

    Args:
        parts: of its name, from the source's root.
        where: the source and its name, for messages.
        data: its bytes.
    """

    parts: tuple[str, ...]
    where: str
    data: bytes


def files_of(source: Path, *, folder: str) -> Iterator[SourceFile]:
    """Yield each file below a folder of a source, in the source's order.

    Args:
        source: a `.tar.gz` or a folder; who made it is not trusted.
        folder: a name; it stands in the source's root or in its only folder.

    Raises:
        SourceError: the source is broken, or holds what it must not.
    """
    _require_unicode(source.name, str(source))
    named = _in_folder(source) if source.is_dir() else _in_archive(source)
    for parts, where, data in named:
        inner = parts[1:] if parts[:1] != (folder,) else parts
        if inner[:1] == (folder,):
            yield SourceFile(inner[1:], where, data)


class _SizeBounds:
    """Counts what was read, and refuses what is too much.

    Args:
        source: for messages.
    """

    def __init__(self, source: Path) -> None:
        self._source, self._files, self._bytes = source, 0, 0

    def take(self, where: str, size: int) -> None:
        """Count one file, before it is read.

        Raises:
            SourceError: it is too large, or there are too many.
        """
        self._files, self._bytes = self._files + 1, self._bytes + size
        if size > MEMBER_BYTES:
            raise SourceError(f"has {size} bytes; {MEMBER_BYTES} are allowed", where=where)
        if self._files > SOURCE_FILES or self._bytes > SOURCE_BYTES:
            text = f"holds more than {SOURCE_FILES} files or {SOURCE_BYTES} bytes"
            raise SourceError(text, where=str(self._source))


class _BoundedArchive(gzip.GzipFile):
    """An archive's bytes; a header that asks for more than a file has at once is refused."""

    def read(self, size: int | None = -1) -> bytes:
        """Return the next bytes.

        Raises:
            tarfile.ReadError: more are asked for than a file and its padding may have.
        """
        if size is None or not 0 <= size <= MEMBER_BYTES + tarfile.BLOCKSIZE:
            raise tarfile.ReadError(f"a header asks for {size} bytes at once")
        return super().read(size)


def _in_archive(source: Path) -> Iterator[tuple[tuple[str, ...], str, bytes]]:
    last, bounds = str(source), _SizeBounds(source)
    try:
        with (
            _BoundedArchive(source) as unpacked,
            tarfile.open(fileobj=unpacked, mode="r:") as archive,
        ):
            for member in archive:
                last = f"{source}:{member.name}"
                parts = _parts(member.name, last)
                bounds.take(last, member.size)
                if member.isdir():
                    continue
                if not member.isreg() or member.issparse():
                    raise SourceError("is a link or a device; a plain file is expected", where=last)
                file = archive.extractfile(member)
                data = b"" if file is None else file.read()
                if len(data) != member.size:
                    raise SourceError("ends before its length", where=last)
                yield parts, last, data
    except OSError as error:
        raise SourceError(f"cannot be read: {error.strerror or error}", where=last) from error
    except (tarfile.TarError, EOFError, zlib.error, ValueError, RecursionError) as error:
        text = f"the archive is no whole `.tar.gz`: it ends or breaks here ({error})"
        raise SourceError(text, where=last) from error


def _parts(name: str, where: str) -> tuple[str, ...]:
    path = PurePosixPath(name)
    _require_unicode(name, where)
    if path.is_absolute() or ".." in path.parts or "\\" in name:
        raise SourceError("its name leads out of the archive", where=where)
    return path.parts


def _require_unicode(name: str, where: str) -> None:
    try:
        name.encode()
    except UnicodeEncodeError:
        shown = where.encode(errors="backslashreplace").decode()
        raise SourceError("its name is no UTF-8", where=shown) from None


def _in_folder(source: Path) -> Iterator[tuple[tuple[str, ...], str, bytes]]:
    bounds = _SizeBounds(source)
    for folder, folders, names in os.walk(source, onerror=_cannot_be_read):
        folders.sort()
        for name in (*folders, *sorted(names)):
            path = Path(folder) / name
            _require_unicode(name, str(path))
            found = path.lstat()
            is_file = stat.S_ISREG(found.st_mode)
            bounds.take(str(path), found.st_size if is_file else 0)
            if stat.S_ISDIR(found.st_mode):
                continue
            if not is_file:
                text = "is a link or a device; a plain file is expected"
                raise SourceError(text, where=str(path))
            yield path.relative_to(source).parts, str(path), _read(path)


def _cannot_be_read(error: OSError) -> None:
    raise SourceError(f"cannot be read: {error.strerror}", where=str(error.filename))


def _read(path: Path) -> bytes:
    try:
        with os.fdopen(os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK), "rb") as file:
            data = file.read(MEMBER_BYTES + 1)
    except OSError as error:
        raise SourceError(f"cannot be read: {error.strerror}", where=str(path)) from error
    if len(data) > MEMBER_BYTES:
        raise SourceError(f"has more than {MEMBER_BYTES} bytes", where=str(path))
    return data
