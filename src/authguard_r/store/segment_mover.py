# SPDX-License-Identifier: Apache-2.0
"""Moves the oldest records of a store into a segment, a little between the turns.

Copied, sealed and named, then marked in one commit, then deleted where they were. After a crash in
between, each record is in the store or in a marked segment, and is read once. Spec page:
docs/spec/store.md#rotation
"""

from __future__ import annotations

from collections.abc import Callable

import apsw

from authguard_r.core.chain import GENESIS
from authguard_r.core.encoding import b64, encode
from authguard_r.core.errors import StoreError
from authguard_r.core.identifiers import Digest
from authguard_r.core.ports import Turn
from authguard_r.core.reasons import Reason
from authguard_r.store.cells import Cells
from authguard_r.store.segment_writer import SegmentWriter
from authguard_r.store.segments import MARK, SEGMENT, Segment, name_of, read_forgets
from authguard_r.store.sqlite import FORMAT, SqliteStore

_HOLD = (
    "INSERT INTO held VALUES (?, ?, ?) ON CONFLICT (kind, key) DO UPDATE SET value = excluded.value"
)


class Mover:
    """Moves records of one store; for one thread.

    Args:
        store: the store.
    """

    def __init__(self, store: SqliteStore) -> None:
        self._store = store
        self._segments = store.segments
        self._writer: SegmentWriter | None = None
        self._end = 0
        self._stuck: StoreError | None = None
        #: True while records that a segment has lie in the store, too.
        self.clears = self._segments.end > 0

    @property
    def mark(self) -> int:
        """The first record that is in no segment."""
        return self._segments.end

    @property
    def copies(self) -> bool:
        """True while a segment is being written."""
        return self._writer is not None

    def begin(self, end: int) -> None:
        """Begin a segment of the records up to before `end`.

        Raises:
            StoreError: the disk has no room for it, or something else lies in its place.
        """
        if self._stuck is not None:
            raise self._stuck
        folder = self._segments.folder
        if folder.has(name_of(self.mark)):
            place = folder.place(name_of(self.mark))
            text = "a file that is not this log's lies where its next segment belongs"
            raise StoreError(text, where=place, reason=Reason.STORE_UNAVAILABLE)
        if folder.free_bytes() < self._store.upkeep(_used_bytes) or not self._store.restore():
            text = "the disk has no room for a segment"
            raise StoreError(text, where=folder.place(""), reason=Reason.STORE_FULL)
        self._writer = SegmentWriter(folder, self.mark, vfs=self._segments.vfs)
        self._segments.writing = self._writer
        self._end = end

    def copy(self, count: int, check: Callable[[Turn, tuple[Cells, ...]], None]) -> bool:
        """Copy the next records; True when all are there.

        Args:
            count: how many at most.
            check: holds them against what else is known of the log.

        Raises:
            StoreError: they cannot be read or written, the disk is short, or they do not fit.
        """
        writer = self._begun()
        if not self._store.restore():
            text = "the disk has no room for a segment above the reserve"
            raise StoreError(text, where="store", reason=Reason.STORE_FULL)

        def job(turn: Turn) -> None:
            rows = turn.rows(writer.at, min(count, self._end - writer.at))
            check(turn, rows)
            writer.take(rows)

        self._store.read(job)
        return writer.at >= self._end

    def seal(self, note: bytes, *, head: bytes) -> Segment:
        """Give the segment its checkpoint and its name, and mark that it is there.

        Args:
            note: the checkpoint of its last record.
            head: that record's link.

        Raises:
            StoreError: the records are in the store as before.
        """
        writer = self._begun()

        def work(connection: apsw.Connection) -> Segment:
            if read_forgets(connection):
                text = "sealed values are still to go from a segment"
                raise StoreError(text, where="store", reason=Reason.STORE_UNAVAILABLE)
            segment = self._segments.unmarked = self._segment(head)
            writer.seal(note)
            self._segments.writing = None
            connection.execute(_HOLD, (SEGMENT, segment.name, encode(segment)))
            connection.execute(_HOLD, (SEGMENT, MARK, str(segment.end).encode()))
            connection.execute(f"PRAGMA user_version = {FORMAT}")
            return segment

        try:
            segment = self._store.upkeep(work)
        except StoreError as error:
            if self._segments.unmarked is not None and error.reason is not Reason.STORE_FULL:
                self._stuck = error  # what is on disk, only the next start can say
            raise
        self._segments.unmarked, self._writer = None, None
        self._segments.add(segment)
        self.clears = True
        return segment

    def clear(self, count: int) -> None:
        """Delete the next records that a segment has, with zeros over them.

        Raises:
            StoreError: they are still there, and read once all the same.
        """

        def work(connection: apsw.Connection) -> bool:
            # a value that is let go of later would stay in what was freed here
            connection.execute("PRAGMA secure_delete = ON")
            first = connection.execute("SELECT min(seq) FROM audit").get
            end = min(first + count, self.mark)
            connection.execute("DELETE FROM audit WHERE seq < ?", (end,))
            connection.execute("PRAGMA secure_delete = FAST")
            return bool(end < self.mark)

        self.clears = self._store.upkeep(work)

    def abandon(self) -> None:
        """Throw away what was copied, so that its place on the disk is free."""
        if self._writer is not None:
            self._writer.abandon()
        self._writer = self._segments.writing = None
        if self._stuck is None and self._segments.unmarked is not None:
            self._segments.folder.remove(self._segments.unmarked.name)
            self._segments.unmarked = None

    def _begun(self) -> SegmentWriter:
        if self._writer is None:
            raise RuntimeError("no segment was begun")
        return self._writer

    def _segment(self, head: bytes) -> Segment:
        index = self._segments.index
        before = index[-1].head if index else Digest(b64(GENESIS))
        return Segment(first=self.mark, end=self._end, before=before, head=Digest(b64(head)))


def _used_bytes(connection: apsw.Connection) -> int:
    """Return how much of the store's file is in use: a segment is no longer."""
    pages = connection.execute("PRAGMA page_count").get
    free = connection.execute("PRAGMA freelist_count").get
    return int((pages - free) * connection.execute("PRAGMA page_size").get)
