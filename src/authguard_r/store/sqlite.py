# SPDX-License-Identifier: Apache-2.0
"""The durable store: SQLite in WAL mode, synchronous FULL, one writer, group commit.

NORMAL would lose acknowledged commits in a power cut (L17). The first caller that gets the lock
commits for all that wait: one fsync for the whole batch, no thread of our own, and a lone caller
pays for nothing but its own transaction. A job that changes nothing costs no fsync. Spec page:
docs/spec/store.md
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Generic, TypeVar

import apsw

from authguard_r.audit.record import LogRow
from authguard_r.core.chain import GENESIS
from authguard_r.core.errors import EnvironmentFault, StoreError
from authguard_r.core.ports import Turn
from authguard_r.core.reasons import Reason
from authguard_r.store.cells import blob, cells, first_row, held_value, store_error
from authguard_r.store.folder import Folder
from authguard_r.store.layout import ALONE, APPLICATION_ID, FORMAT, erase, prepare, require_format
from authguard_r.store.reserve import Reserve
from authguard_r.store.segments import FORGET, Segment, Segments, read_forgets, read_index
from authguard_r.store.turn import SqliteTurn
from authguard_r.store.untrusted import ReadMeter, in_order, open_stranger
from authguard_r.wire.gate_limits import LIMITS

T = TypeVar("T")

#: First SQLite without the WAL-reset corruption bug.
_OLDEST_SQLITE = (3, 51, 3)


class _Ticket(Generic[T]):
    """A job that waits for its turn, and later its result."""

    __slots__ = ("done", "error", "essential", "job", "result")

    def __init__(self, job: Callable[[Turn], T], *, essential: bool = False) -> None:
        self.job = job
        self.essential = essential
        self.done = False
        self.result: T | None = None
        self.error: BaseException | None = None

    def finish(self) -> T:
        """Return the result or raise what went wrong."""
        if self.error is not None:
            raise self.error
        return self.result  # type: ignore[return-value]


class SqliteStore:
    """Registry and audit log of one robot in one file (`core.ports.Store`)."""

    def __init__(
        self,
        connection: apsw.Connection,
        reserve: Reserve,
        segments: Segments,
        *,
        path: Path | None = None,
    ) -> None:
        #: Where the file is held to be, and which one it is; None: nothing is asked of that.
        self._path, self._file = path, None if path is None else _file_of(path)
        self._wal: tuple[int, int] | None = None
        self._connection = connection
        self._reserve = reserve
        #: The log's oldest records; for the caller that moves them, under `upkeep`.
        self.segments = segments
        self._execute = connection.cursor().execute
        self._closed, self._lock = False, threading.Lock()
        self._pending: deque[_Ticket[object]] = deque()
        size, link = _read_head(connection)
        self._turn = SqliteTurn(connection, segments, size=size, link=link)
        if self._turn.waiting():  # a crash came between
            self._erase()

    def run(self, job: Callable[[Turn], T], *, essential: bool = False) -> T:
        """Run the job in the writer's turn; returns after its effects are on disk.

        Args:
            job: run twice when the disk was full and the reserve made room.
            essential: may use the reserve; without it, a job that writes is refused while the
                reserve is gone.

        Raises:
            StoreError: nothing of the job was committed.
        """
        if not self.is_here():
            raise StoreError("its file was moved away", where="store")
        ticket = _Ticket(job, essential=essential)
        self._pending.append(ticket)  # type: ignore[arg-type]
        with self._lock:
            while not ticket.done:  # a full batch may be before it
                self._commit_batch()
        return ticket.finish()

    def is_here(self) -> bool:
        """True while its file and its write-ahead log are where they were opened."""
        if self._path is None:
            return True
        wal = _file_of(self._path.with_name(f"{self._path.name}-wal"))
        self._wal = self._wal or wal  # it is there from the first commit on
        return _file_of(self._path) == self._file and wal == self._wal

    def read(self, job: Callable[[Turn], T]) -> T:
        """Return what a job reads; what it puts or appends is dropped.

        Raises:
            StoreError: the store cannot be read.
        """
        with self._lock:
            before = self._turn.head()
            try:
                self._require_open()
                return job(self._turn)
            except apsw.Error as error:
                raise store_error(error) from error
            finally:
                if self._turn.changes:
                    self._turn.drop(before)

    def upkeep(self, work: Callable[[apsw.Connection], T]) -> T:
        """Run work of the store's own, in a transaction of its own, between the turns.

        Args:
            work: does not end the transaction.

        Raises:
            StoreError: nothing was committed; the disk may have room for what must be written
                alone.
        """
        with self._lock:
            before = self._turn.head()
            try:
                self._require_open()
                self._require_reserve()
                self._execute("BEGIN IMMEDIATE")
                result = work(self._connection)
                self._execute("COMMIT")
            except BaseException as error:
                self._roll_back(before)
                if isinstance(error, apsw.Error):
                    raise store_error(error) from error
                raise
            self._turn.reread()
            return result

    def restore(self) -> bool:
        """Allocate the reserve again if it is gone; True while there is room beside it."""
        return self._reserve.restore()

    def close(self) -> None:
        """Let go of the file; the reserve stays for the next start."""
        with self._lock:
            self._closed = True
            self.segments.close()
            self._connection.close()

    def _commit_batch(self) -> None:
        batch = [self._pending.popleft() for _ in range(min(len(self._pending), LIMITS.batch))]
        try:
            self._commit_or_make_room(batch)
        except apsw.Error as error:
            for ticket in batch:
                ticket.error = store_error(error)
        except BaseException:
            for ticket in batch:
                ticket.error = StoreError("the commit was interrupted", where="store")
            raise
        finally:
            for ticket in batch:
                ticket.done = True

    def _commit_or_make_room(self, batch: list[_Ticket[object]]) -> None:
        try:
            self._commit(batch)
        except apsw.FullError:
            if not (any(ticket.essential for ticket in batch) and self._reserve.let_go()):
                raise
            self._commit(batch)  # only what is essential may write now

    def _commit(self, batch: list[_Ticket[object]]) -> None:
        self._require_open()
        before = self._turn.head()
        try:
            for ticket in batch:
                self._run_one(ticket)
            if self._connection.in_transaction:
                self._execute("COMMIT")
        except BaseException:
            self._roll_back(before)
            raise
        if self._turn.has_traces:
            self._erase()

    def _erase(self) -> None:
        """Leave nothing in any file of what was let go of; else with the next commit."""
        done = False
        with suppress(StoreError, apsw.Error):
            left = self._turn.waiting()
            if left:
                self.segments.forget(left)
                self._execute("DELETE FROM held WHERE kind = ?", (FORGET,))
                self._turn.reread()
            done = True
        self._turn.has_traces = not (erase(self._connection) and done)

    def _run_one(self, ticket: _Ticket[object]) -> None:
        """Run one job; its own mistake undoes it alone, the store's fault undoes the batch."""
        before = self._turn.head()
        ticket.error = None  # of a first try
        try:
            ticket.result = ticket.job(self._turn)
            self._require_room(ticket)
        except apsw.Error:
            raise
        except BaseException as error:  # noqa: BLE001 - handed to the caller of `run`
            self._turn.drop(before)
            ticket.error = error
        else:
            self._turn.write()

    def _require_open(self) -> None:
        if self._closed:
            raise apsw.ConnectionClosedError("the store is closed")

    def _require_room(self, ticket: _Ticket[object]) -> None:
        """Keep what the reserve left for essential jobs."""
        if self._turn.changes and not ticket.essential:
            self._require_reserve()

    def _require_reserve(self) -> None:
        if self._reserve.is_gone:
            raise StoreError(
                "the disk is full: the rest is reserved for outcomes, stops and management",
                where="store",
                reason=Reason.STORE_FULL,
            )

    def _roll_back(self, before: tuple[int, bytes]) -> None:
        self._turn.drop(before)
        self._turn.reread()
        try:
            if self._connection.in_transaction:
                self._connection.execute("ROLLBACK")
            # an interrupt can come when the commit is done: what counts is what is there
            self._turn.drop(_read_head(self._connection))
        except apsw.Error:  # pragma: no cover - nothing was committed either way
            pass


def open_store(
    path: Path, *, reserve_bytes: int = 0, vfs: str | None = None, folder: Folder | None = None
) -> SqliteStore:
    """Return the store in the file, made anew when it is missing.

    Args:
        path: the file; its folder must exist.
        reserve_bytes: disk space kept beside the file for essential jobs; 0 keeps none. When it
            cannot be had, only essential jobs write until it can.
        vfs: name of an SQLite file system, for tests that cut the power.
        folder: of its segments; None: beside it.

    Raises:
        EnvironmentFault: SQLite is too old to be trusted with a WAL.
        StoreError: locked, read-only, corrupt, newer, or not ours; or a segment of it is.
    """
    version = tuple(int(part) for part in apsw.sqlite_lib_version().split("."))
    if version < _OLDEST_SQLITE:  # pragma: no cover - apsw's wheel brings its own
        raise EnvironmentFault(
            f"SQLite {apsw.sqlite_lib_version()} can corrupt a WAL; 3.51.3 is needed",
            reason=Reason.STORE_UNAVAILABLE,
            where=str(path),
        )
    if vfs is None:
        with suppress(OSError):  # SQLite says why, and gives its other files the same mode
            path.touch(mode=0o600, exist_ok=False)
    try:
        connection = apsw.Connection(str(path), vfs=vfs)
        try:
            prepare(connection, path)
            # after the lock: the folder and the ballast are its holder's
            segments = _segments(connection, folder or Folder(path), vfs=vfs)
            here = path if vfs is None else None  # a file system of a test has files of its own
            return SqliteStore(connection, Reserve(path, reserve_bytes), segments, path=here)
        except BaseException:
            connection.close()
            raise
    except apsw.Error as error:
        raise store_error(error, where=str(path)) from error


def _file_of(path: Path) -> tuple[int, int] | None:
    """Return which file is there; None: none is."""
    with suppress(OSError):
        found = path.stat()
        return found.st_dev, found.st_ino
    return None


def read_rows(path: Path) -> Iterator[LogRow]:
    """Yield the log's rows in order, from a file that is not trusted.

    Raises:
        StoreError: no store, corrupt, newer, or held by a running gate; or a segment of it is
            missing, another one's or damaged.
    """
    if not path.is_file():
        raise StoreError("there is no such store", where=str(path))
    try:
        connection = open_stranger(path)
        try:
            require_format(connection, path)
            folder = Folder(path)
            segments = Segments(folder, _index(connection, folder), strange=True)
            yield from _moved_rows(connection, segments)
            # all of them where nothing was moved: what has no business here is seen, too
            known = "WHERE seq >= ?" if segments.end else ""
            rows = connection.execute(
                f"SELECT seq, record, sealed, link FROM audit {known} ORDER BY seq",  # noqa: S608
                (segments.end,) if known else (),
            )
            plain = ((seq, *map(blob, cells)) for seq, *cells in rows)
            for seq, record, sealed, link in in_order(plain, path):
                yield LogRow(seq, record, sealed, link)
        finally:
            connection.close()
    except (apsw.Error, UnicodeDecodeError) as error:
        raise store_error(error, where=str(path)) from error


def read_held(path: Path, kind: str, key: str) -> bytes | None:
    """Return one held value from a file that no gate runs on.

    Raises:
        StoreError: as in `read_rows`.
    """
    if not path.is_file():
        raise StoreError("there is no such store", where=str(path))
    try:
        connection = open_stranger(path)
        try:
            require_format(connection, path)
            return held_value(connection, kind, key)
        finally:
            connection.close()
    except apsw.Error as error:
        raise store_error(error, where=str(path)) from error


def _moved_rows(connection: apsw.Connection, segments: Segments) -> Iterator[LogRow]:
    """Yield the rows that lie in segments, a page at a time."""
    if not segments.end:
        return
    left = read_forgets(connection)
    try:
        _require_copies(connection, segments)
        for first in range(0, segments.end, LIMITS.strange_rows):
            end = min(first + LIMITS.strange_rows, segments.end)
            for seq, record, sealed, link in segments.rows(first, end):
                yield LogRow(seq, record, left.get(seq, sealed), link)
    finally:
        segments.close()


def _require_copies(connection: apsw.Connection, segments: Segments) -> None:
    """Refuse a row that was put where rows are that a move has not taken away yet.

    Raises:
        StoreError: it is not the segment's own.
    """
    rows = connection.execute(
        "SELECT seq, record, link FROM audit WHERE seq < ? ORDER BY seq", (segments.end,)
    )
    meter = ReadMeter(Path(connection.filename))
    for seq, record, link in rows:
        meter.took(blob(record), blob(link))
        moved = segments.rows(seq, seq + 1)
        if [(row[1], row[3]) for row in moved] != [(record, link)]:
            text, where = "it lies here, and is not the one in its segment", f"record {seq}"
            raise StoreError(text, where=where, reason=Reason.STORE_CORRUPT)


def _index(connection: apsw.Connection, folder: Folder) -> tuple[Segment, ...]:
    """Return which segments there are; a store that has none needs no word of `held` for it."""
    alone = connection.execute("PRAGMA user_version").get == ALONE
    return () if alone else read_index(connection, folder)


def _segments(connection: apsw.Connection, folder: Folder, *, vfs: str | None) -> Segments:
    """Return a store's segments, once each was looked at and what a crash left is gone.

    Raises:
        StoreError: one is missing, another's, damaged, or does not join.
    """

    def link_of(seq: int) -> bytes | None:
        return next((row[3] for row in cells(connection, seq, seq + 1)), None)

    segments = Segments(folder, _index(connection, folder), vfs=vfs)
    segments.require()
    segments.settle(link_of)
    return segments


def _read_head(connection: apsw.Connection) -> tuple[int, bytes]:
    row = first_row(connection, "SELECT seq, link FROM audit ORDER BY seq DESC LIMIT 1", ())
    return (0, GENESIS) if row is None else (row[0] + 1, blob(row[1]))


__all__ = ["APPLICATION_ID", "FORMAT", "SqliteStore", "open_store", "read_held", "read_rows"]
