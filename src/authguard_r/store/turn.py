# SPDX-License-Identifier: Apache-2.0
"""One turn at the SQLite file: what a job reads, and what it wants written.

Spec page: docs/spec/store.md
"""

from __future__ import annotations

from collections.abc import Container

import apsw

from authguard_r.audit.record import without
from authguard_r.store.cells import cells, held_value
from authguard_r.store.segments import FORGET, Segments, read_forgets
from authguard_r.wire.gate_limits import LIMITS


class SqliteTurn:
    """One consistent view inside the open transaction (`core.ports.Turn`).

    What a job puts and appends is kept apart until it ends well, as in the store in memory: a job
    that fails has written nothing, and needs no savepoint to undo it.
    """

    def __init__(
        self, connection: apsw.Connection, segments: Segments, *, size: int, link: bytes
    ) -> None:
        self._connection = connection
        self._segments = segments
        self._many = connection.cursor().executemany
        self.size = size
        self.link = link
        self._puts: dict[tuple[str, str], bytes] = {}
        self._rows: list[tuple[int, bytes, bytes, bytes]] = []
        self._forgets: dict[int, bytes] = {}
        #: True while the write-ahead log may have what was let go of.
        self.has_traces = False
        self._known: dict[tuple[str, str], bytes | None] = {}

    @property
    def changes(self) -> bool:
        """True when the job put, appended or deleted something."""
        return bool(self._puts or self._rows or self._forgets)

    def write(self) -> None:
        """Write what the job put and appended; on disk when the batch commits.

        The first that writes begins the transaction: no other process can have the file, so what
        was read before it was the same.
        """
        if not self.changes:
            return
        if not self._connection.in_transaction:
            self._connection.execute("BEGIN IMMEDIATE")
        self._many("INSERT INTO audit VALUES (?, ?, ?, ?)", self._rows)
        if self._forgets or b"" in self._puts.values():
            self._overwrite()
        if self._forgets:
            self._let_go()
        self._many(
            "INSERT INTO held VALUES (?, ?, ?) "
            "ON CONFLICT (kind, key) DO UPDATE SET value = excluded.value",
            [(*place, value) for place, value in self._puts.items()],
        )
        for place, value in self._puts.items():
            self._know(place, value)
        self._puts, self._rows, self._forgets = {}, [], {}

    def _overwrite(self) -> None:
        """Have zeros written over what goes, and nothing of it left in the write-ahead log."""
        self._connection.execute("PRAGMA secure_delete = ON")
        self.has_traces = True

    def _let_go(self) -> None:
        """Write what stays of sealed values.

        What lies in a segment is written there once this is committed; until then it is held.
        """
        for seq, left in self._forgets.items():
            if seq < self._segments.reach:
                self._puts[FORGET, str(seq)] = left
        self._many(
            "UPDATE audit SET sealed = ? WHERE seq = ?",
            [(sealed, seq) for seq, sealed in self._forgets.items()],
        )

    def waiting(self) -> dict[int, bytes]:
        """Return what stays beside records in segments that values are still to go from."""
        return read_forgets(self._connection) if self._segments.reach else {}

    def drop(self, head: tuple[int, bytes]) -> None:
        """Forget what the job put and appended; none of it was written."""
        self.size, self.link = head
        self._puts, self._rows, self._forgets = {}, [], {}

    def reread(self) -> None:
        """Read everything again: what was written may have been undone."""
        self._known.clear()

    def get(self, kind: str, key: str) -> bytes | None:
        """Return the value held under the key."""
        place = (kind, key)
        if place in self._puts:
            return self._puts[place]
        if place not in self._known:
            self._know(place, held_value(self._connection, kind, key))
        return self._known[place]

    def put(self, kind: str, key: str, value: bytes) -> None:
        """Hold the value when the turn commits."""
        self._puts[kind, key] = value

    def _know(self, place: tuple[str, str], value: bytes | None) -> None:
        """Keep held values in memory: the lock is exclusive, so no other process changes them."""
        if len(self._known) >= LIMITS.known_values:
            self._known.clear()
        self._known[place] = value

    def head(self) -> tuple[int, bytes]:
        """Return the number of records and the last link."""
        return self.size, self.link

    def append(self, record: bytes, sealed: bytes, link: bytes) -> int:
        """Append one record."""
        seq = self.size
        self._rows.append((seq, record, sealed, link))
        self.size, self.link = seq + 1, link
        return seq

    def rows(self, first: int, count: int) -> tuple[tuple[int, bytes, bytes, bytes], ...]:
        """Return rows of the log, with those of this turn."""
        # clamped here: a number that a client chose may not fit into a column
        end = min(max(first + count, 0), self.size)
        first = min(max(first, 0), end)
        mark, left = self._segments.end, self._forgets
        sealed = self._segments.rows(first, min(end, mark)) if first < mark else []
        if sealed:
            left = {**self.waiting(), **left}
        written = cells(self._connection, max(first, mark), end)
        every = (*sealed, *written, *(row for row in self._rows if first <= row[0] < end))
        return tuple((r[0], r[1], left[r[0]], r[3]) if r[0] in left else r for r in every)

    def forget(self, seq: int, names: Container[str]) -> None:
        """Let values beside a record go: in this file, with the commit, and nowhere else."""
        for row in self.rows(seq, 1):
            self._forgets[seq] = without(row[2], names, where=f"store.audit.{seq}")
