# SPDX-License-Identifier: Apache-2.0
"""Writes one segment: rows come page by page, the checkpoint last, then the file has its name.

Until then it is `NAME.part`: it is not read, and what a crash leaves of it is removed. Spec page:
docs/spec/store.md#rotation
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress

import apsw

from authguard_r.core.errors import StoreError
from authguard_r.store.cells import Cells, store_error
from authguard_r.store.folder import Folder
from authguard_r.store.layout import ONLY_FORGETS, TABLES
from authguard_r.store.segments import CHECKPOINT, PART, SEALED, SEGMENT_FORMAT, SEGMENT_ID, name_of

_CLOSED = """
CREATE TRIGGER audit_no_insert BEFORE INSERT ON audit
BEGIN SELECT RAISE(ABORT, 'the segment is sealed'); END;
CREATE TRIGGER audit_no_delete BEFORE DELETE ON audit
BEGIN SELECT RAISE(ABORT, 'the audit log is append-only'); END;
"""


class SegmentWriter:
    """A segment while it is written (`store.segments.Writing`).

    Every page is on disk when it was taken, so that the end waits for no more than a page. No
    journal: what is torn is thrown away.

    Args:
        folder: where it is to lie.
        first: number of its first record.
        vfs: name of an SQLite file system, for tests that cut the power.

    Raises:
        StoreError: it cannot be begun.
    """

    def __init__(self, folder: Folder, first: int, *, vfs: str | None = None) -> None:
        self._folder = folder
        self._name = name_of(first)
        self._part = self._name + PART
        self.at = first
        folder.create(self._part)
        with self._told():
            self._connection = apsw.Connection(folder.place(self._part), vfs=vfs)
        with self._told():
            self._connection.execute("PRAGMA locking_mode = EXCLUSIVE").fetchall()
            self._connection.execute("PRAGMA journal_mode = OFF").fetchall()
            self._connection.execute("PRAGMA synchronous = NORMAL; PRAGMA secure_delete = ON")
        with self._written():
            self._connection.execute(f"PRAGMA application_id = {SEGMENT_ID}")
            self._connection.execute(f"PRAGMA user_version = {SEGMENT_FORMAT}")
            self._connection.execute(TABLES)

    def take(self, rows: Sequence[Cells]) -> None:
        """Write the next rows; they are on disk when this returns.

        Raises:
            StoreError: they are not, and nothing goes on with this file.
        """
        with self._written():
            self._connection.executemany("INSERT INTO audit VALUES (?, ?, ?, ?)", rows)
        self.at += len(rows)

    def forget(self, left: dict[int, bytes]) -> None:
        """Let sealed values of rows that were taken go.

        Raises:
            StoreError: as above.
        """
        with self._written():
            self._connection.executemany(
                "UPDATE audit SET sealed = ? WHERE seq = ?",
                [(beside, seq) for seq, beside in left.items()],
            )

    def seal(self, note: bytes) -> None:
        """Write the checkpoint and give the file its name; both last when this returns.

        Raises:
            StoreError: as above.
        """
        with self._written():
            self._connection.execute(
                "INSERT INTO held VALUES (?, ?, ?)", (CHECKPOINT, SEALED, note)
            )
            self._connection.execute(ONLY_FORGETS + _CLOSED)
        self._connection.close()
        self._folder.publish(self._part, self._name)

    def abandon(self) -> None:
        """Let go of what was written; what cannot be removed now is at the next start."""
        self._connection.close()
        with suppress(StoreError):
            self._folder.remove(self._part)

    @contextmanager
    def _written(self) -> Iterator[None]:
        """Write in a transaction of its own; one that fails is left open: the file is useless."""
        with self._told():
            self._connection.execute("BEGIN IMMEDIATE")
            yield
            self._connection.execute("COMMIT")

    @contextmanager
    def _told(self) -> Iterator[None]:
        try:
            yield
        except apsw.Error as error:
            raise store_error(error, where=self._folder.place(self._part)) from error
