# SPDX-License-Identifier: Apache-2.0
"""A store that forgets: for what-if decisions and for tests of everything but durability.

It passes the conformance suite of `core.ports.Store` save for what a crash must not lose.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Container
from typing import TypeVar

from msgspec import structs

from authguard_r.audit.record import LogRow, without
from authguard_r.core.chain import GENESIS
from authguard_r.core.errors import StoreError
from authguard_r.core.ports import Turn

T = TypeVar("T")


class _MemoryTurn:
    """Writes of one job, kept apart until it ends well."""

    def __init__(self, held: dict[tuple[str, str], bytes], rows: list[LogRow]) -> None:
        self._held = held
        self._rows = rows
        self._size = len(rows)
        self._link = rows[-1].link if rows else GENESIS
        self.puts: dict[tuple[str, str], bytes] = {}
        self.appends: list[LogRow] = []
        self.forgets: dict[int, bytes] = {}

    def get(self, kind: str, key: str) -> bytes | None:
        """Return the value held under the key."""
        return self.puts.get((kind, key), self._held.get((kind, key)))

    def put(self, kind: str, key: str, value: bytes) -> None:
        """Hold the value when the turn commits."""
        self.puts[(kind, key)] = value

    def head(self) -> tuple[int, bytes]:
        """Return the number of records and the last link."""
        return self._size, self._link

    def append(self, record: bytes, sealed: bytes, link: bytes) -> int:
        """Append one record."""
        row = LogRow(self._size, record, sealed, link)
        self.appends.append(row)
        self._size, self._link = row.seq + 1, link
        return row.seq

    def rows(self, first: int, count: int) -> tuple[tuple[int, bytes, bytes, bytes], ...]:
        """Return rows of the log, with those of this turn."""
        every = [*self._rows, *self.appends][max(first, 0) : max(first + count, 0)]
        left = self.forgets
        return tuple((r.seq, r.record, left.get(r.seq, r.sealed), r.link) for r in every)

    def forget(self, seq: int, names: Container[str]) -> None:
        """Let values beside a record go when the turn commits."""
        for row in self.rows(seq, 1):
            self.forgets[seq] = without(row[2], names, where=f"record {seq}")


class MemoryStore:
    """Registry and log in this process's memory (`core.ports.Store`)."""

    def __init__(self) -> None:
        self._held: dict[tuple[str, str], bytes] = {}
        self._rows: list[LogRow] = []
        self._lock = threading.Lock()
        self._closed = False

    def run(self, job: Callable[[Turn], T], *, essential: bool = False) -> T:  # noqa: ARG002
        """Run the job alone; its effects are there when it returned. No disk to be full.

        Raises:
            StoreError: the store was closed.
        """
        with self._lock:
            if self._closed:
                raise StoreError("the store is closed", where="store")
            turn = _MemoryTurn(self._held, self._rows)
            result = job(turn)
            self._held.update(turn.puts)
            self._rows += turn.appends
            for seq, sealed in turn.forgets.items():
                self._rows[seq] = structs.replace(self._rows[seq], sealed=sealed)
            return result

    def read(self, job: Callable[[Turn], T]) -> T:
        """Return what a job reads; what it puts or appends is dropped.

        Raises:
            StoreError: the store was closed.
        """
        with self._lock:
            if self._closed:
                raise StoreError("the store is closed", where="store")
            return job(_MemoryTurn(self._held, self._rows))

    def is_here(self) -> bool:
        """Return True: there is no file that could be moved."""
        return True

    def restore(self) -> bool:
        """Return True: there is no disk."""
        return True

    def close(self) -> None:
        """Refuse everything from now on."""
        with self._lock:
            self._closed = True

    def rows(self) -> tuple[LogRow, ...]:
        """Return the log."""
        with self._lock:
            return tuple(self._rows)
