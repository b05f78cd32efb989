# SPDX-License-Identifier: Apache-2.0
"""Files that must not be one and the same: what one part writes would destroy another's.

A counter's note replaces the file that had its name: a store, a journal or a key. How-to:
docs/howto/rollback.md
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path

from msgspec import Struct

from authguard_r.anchoring.counter import FileCounter
from authguard_r.operations.checkup.advice import Advice, AdviceCode, unsafe

#: What is written beside a store, under its name.
_BESIDE = ("-wal", "-shm", "-journal", ".gate", ".reserve")
#: Where the emergency journal is by default.
_JOURNAL = ".emergency"


class Files(Struct, frozen=True, kw_only=True):
    """The files of one gate; None for a file that is not named.

    Args:
        store: its store.
        counter: its outside counter.
        journal: its emergency journal.
        read: what it only reads, keys among it; these may be one file.
    """

    store: Path | None = None
    counter: Path | None = None
    journal: Path | None = None
    read: tuple[Path, ...] = ()


class _File(Struct, frozen=True):
    """One file, and the option that it comes from."""

    path: Path
    option: str


def apart_advice(files: Files) -> Iterator[Advice]:
    """Yield every file that is written and that is another part's too, also under another name."""
    written = tuple(_written(files))
    read = (_File(path, f"`{path}`") for path in files.read)
    pairs = [*combinations(written, 2), *((one, other) for other in read for one in written)]
    for one, other in pairs:
        if one.option != other.option and _is_same(one.path, other.path):
            yield unsafe(
                "files",
                AdviceCode.SAME_FILE,
                f"`{other.path}` is written for {one.option}, and it is {other.option} too",
                place=str(one.path),
                mend="name a file of its own for each",
            )


def _written(files: Files) -> Iterator[_File]:
    """Yield what the gate writes, with what it writes beside."""
    if files.store is not None:
        endings = ("", *_BESIDE, *([_JOURNAL] if files.journal is None else []))
        yield from (_File(_beside(files.store, ending), "--store") for ending in endings)
    if files.counter is not None:
        yield from (_File(path, "--counter") for path in FileCounter(files.counter).files)
    if files.journal is not None:
        yield _File(files.journal, "--emergency-journal")


def _beside(store: Path, ending: str) -> Path:
    """Return the path of what lies beside a store under its name."""
    return store.with_name(f"{store.name}{ending}")


def _is_same(one: Path, other: Path) -> bool:
    """True for one file behind two names; one that is not there yet has its place alone."""
    if os.path.realpath(one) == os.path.realpath(other):
        return True
    try:
        return one.samefile(other)
    except OSError:
        return False
