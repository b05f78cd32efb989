# SPDX-License-Identifier: Apache-2.0
"""The durable store: SQLite in WAL mode, synchronous FULL, one writer, group commit.

NORMAL would lose acknowledged commits in a power cut (L17). Whoever gets the lock first commits
for everybody who waits: one fsync for the whole batch, no thread of our own, and a lone caller
pays for nothing but its own transaction. A job that changes nothing costs no fsync.
Spec page: docs/spec/store.md
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Generic, TypeVar

import apsw

from authguard_r.audit.verify import Row
from authguard_r.core.chain import GENESIS
from authguard_r.core.errors import EnvironmentFault, StoreError
from authguard_r.core.ports import Turn
from authguard_r.core.reasons import Reason
from authguard_r.store.reserve import Reserve
from authguard_r.store.turn import SqliteTurn, blob, first_row

T = TypeVar("T")

#: Marks the file as ours ("AGR1") and says which layout it has.
APPLICATION_ID = 0x41475231
FORMAT = 1
#: First SQLite without the WAL-reset corruption bug.
_OLDEST_SQLITE = (3, 51, 3)
_MAX_BATCH = 64

_SCHEMA = """
CREATE TABLE held (
  kind TEXT NOT NULL, key TEXT NOT NULL, value BLOB NOT NULL, PRIMARY KEY (kind, key)
) STRICT, WITHOUT ROWID;
CREATE TABLE audit (
  seq INTEGER PRIMARY KEY, record BLOB NOT NULL, sealed BLOB NOT NULL, link BLOB NOT NULL
) STRICT;
CREATE TRIGGER audit_no_gap BEFORE INSERT ON audit
WHEN NEW.seq IS NOT (SELECT coalesce(max(seq) + 1, 0) FROM audit)
BEGIN SELECT RAISE(ABORT, 'the audit log is append-only'); END;
CREATE TRIGGER audit_no_delete BEFORE DELETE ON audit
BEGIN SELECT RAISE(ABORT, 'the audit log is append-only'); END;
"""
#: Sealed values may go, each as a whole; nothing else ever changes.
_ONLY_FORGETS = """
DROP TRIGGER IF EXISTS audit_no_update;
CREATE TRIGGER IF NOT EXISTS audit_only_forgets BEFORE UPDATE ON audit
WHEN NEW.seq IS NOT OLD.seq OR NEW.record IS NOT OLD.record OR NEW.link IS NOT OLD.link OR EXISTS (
  SELECT key, value FROM json_each(CAST(NEW.sealed AS TEXT))
  EXCEPT SELECT key, value FROM json_each(CAST(OLD.sealed AS TEXT))
)
BEGIN SELECT RAISE(ABORT, 'the audit log is append-only'); END;
"""

_REASONS: tuple[tuple[type[Exception], Reason, str], ...] = (
    (apsw.FullError, Reason.STORE_FULL, "the disk is full"),
    (apsw.ReadOnlyError, Reason.STORE_READ_ONLY, "the store is read-only"),
    (apsw.CorruptError, Reason.STORE_CORRUPT, "the store is corrupt"),
    (UnicodeDecodeError, Reason.STORE_CORRUPT, "the store is corrupt"),
    (apsw.NotADBError, Reason.STORE_CORRUPT, "the file is no store"),
    (apsw.SQLError, Reason.STORE_CORRUPT, "the store is corrupt"),
    (apsw.ConstraintError, Reason.STORE_CORRUPT, "the store is corrupt"),
    (
        apsw.BusyError,
        Reason.STORE_UNAVAILABLE,
        "another process holds the store (is a gate running?)",
    ),
    (
        apsw.LockedError,
        Reason.STORE_UNAVAILABLE,
        "another process holds the store (is a gate running?)",
    ),
)


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

    def __init__(self, connection: apsw.Connection, reserve: Reserve) -> None:
        self._connection = connection
        self._reserve = reserve
        self._execute = connection.cursor().execute
        self._closed = False
        self._lock = threading.Lock()
        self._pending: deque[_Ticket[object]] = deque()
        self._turn = SqliteTurn(connection, *_read_head(connection))

    def run(self, job: Callable[[Turn], T], *, essential: bool = False) -> T:
        """Run the job in the writer's turn; returns after its effects are on disk.

        Args:
            job: run twice when the disk was full and the reserve made room.
            essential: may use the reserve; without it, a job that writes is refused while the
                reserve is gone.

        Raises:
            StoreError: nothing of the job was committed.
        """
        ticket = _Ticket(job, essential=essential)
        self._pending.append(ticket)  # type: ignore[arg-type]
        with self._lock:
            while not ticket.done:  # a full batch may be before it
                self._commit_batch()
        return ticket.finish()

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

    def restore(self) -> bool:
        """Allocate the reserve again if it is gone; True while there is room beside it."""
        return self._reserve.restore()

    def close(self) -> None:
        """Let go of the file; the reserve stays for the next start."""
        with self._lock:
            self._closed = True
            self._connection.close()

    def _commit_batch(self) -> None:
        batch = [self._pending.popleft() for _ in range(min(len(self._pending), _MAX_BATCH))]
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
        """Leave nothing in the write-ahead log of what was let go of; else with the next commit."""
        self._turn.has_traces = not _erase(self._connection)

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
        if self._reserve.is_gone and self._turn.changes and not ticket.essential:
            raise StoreError(
                "the disk is full: what is left is kept for outcomes, stops and management",
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


def open_store(path: Path, *, reserve_bytes: int = 0, vfs: str | None = None) -> SqliteStore:
    """Return the store in the file, made anew when there is none.

    Args:
        path: the file; its folder must exist.
        reserve_bytes: disk space kept beside the file for essential jobs; 0 keeps none. When it
            cannot be had, only essential jobs write until it can.
        vfs: name of an SQLite file system, for tests that cut the power.

    Raises:
        EnvironmentFault: SQLite is too old to be trusted with a WAL.
        StoreError: locked, read-only, corrupt, newer, or not ours.
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
            _prepare(connection, path)
            # after the lock: the ballast is its holder's
            return SqliteStore(connection, Reserve(path, reserve_bytes))
        except BaseException:
            connection.close()
            raise
    except apsw.Error as error:
        raise store_error(error, where=str(path)) from error


def read_rows(path: Path) -> Iterator[Row]:
    """Yield the log's rows in order, from a file that nobody needs to trust.

    Raises:
        StoreError: no store, corrupt, newer, or held by a running gate.
    """
    if not path.is_file():
        raise StoreError("there is no such store", where=str(path))
    try:
        connection = apsw.Connection(str(path), flags=apsw.SQLITE_OPEN_READONLY)
        try:
            _require_format(connection, path)
            rows = connection.execute("SELECT seq, record, sealed, link FROM audit ORDER BY seq")
            for seq, record, sealed, link in rows:
                yield Row(seq, blob(record), blob(sealed), blob(link))
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
        connection = apsw.Connection(str(path), flags=apsw.SQLITE_OPEN_READONLY)
        try:
            _require_format(connection, path)
            return SqliteTurn(connection, 0, GENESIS).get(kind, key)
        finally:
            connection.close()
    except apsw.Error as error:
        raise store_error(error, where=str(path)) from error


def store_error(error: apsw.Error | UnicodeDecodeError, *, where: str = "store") -> StoreError:
    """Return our word for SQLite's; text that is no text is a damaged cell."""
    for kind, reason, message in _REASONS:
        if isinstance(error, kind):
            return StoreError(f"{message}: {error}", reason=reason, where=where)
    return StoreError(str(error) or type(error).__name__, where=where)


def _prepare(connection: apsw.Connection, path: Path) -> None:
    connection.set_busy_timeout(0)
    if connection.readonly("main"):
        raise apsw.ReadOnlyError("it was opened without the right to write")
    # before the first page is read, so that the index of the WAL is never in shared memory
    connection.execute("PRAGMA locking_mode = EXCLUSIVE").fetchall()
    # looked at before anything is written: what is not ours is left alone
    if not _is_empty(connection):
        _require_format(connection, path)
    connection.execute("PRAGMA journal_mode = WAL").fetchall()
    connection.execute("PRAGMA synchronous = FULL")
    _erase(connection)  # after a crash, of what may have been let go of before it
    # taking the exclusive lock now, not at the first decision
    connection.execute("BEGIN IMMEDIATE")
    if _is_empty(connection):  # again: now nobody else can make it
        connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
        connection.execute(f"PRAGMA user_version = {FORMAT}")
        connection.execute(_SCHEMA)
    connection.execute(_ONLY_FORGETS)  # a store of before has a stricter rule
    connection.execute("COMMIT")


def _erase(connection: apsw.Connection) -> bool:
    """Empty the write-ahead log; False when that cannot be done now. Commits stand either way."""
    with suppress(apsw.Error):
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
        return True
    return False


def _is_empty(connection: apsw.Connection) -> bool:
    """True for a file that nobody has used for anything."""
    marks = ("application_id", "user_version", "schema_version")
    return all(connection.execute(f"PRAGMA {mark}").get == 0 for mark in marks)


def _require_format(connection: apsw.Connection, path: Path) -> None:
    connection.set_busy_timeout(0)
    application = connection.execute("PRAGMA application_id").get
    version = connection.execute("PRAGMA user_version").get
    if application != APPLICATION_ID:
        raise StoreError("the file is no store", where=str(path), reason=Reason.STORE_CORRUPT)
    if version > FORMAT:
        raise StoreError(
            f"expected format {FORMAT}, got {version}: it was written by a newer program",
            where=str(path),
            reason=Reason.STORE_NEWER,
        )


def _read_head(connection: apsw.Connection) -> tuple[int, bytes]:
    row = first_row(connection, "SELECT seq, link FROM audit ORDER BY seq DESC LIMIT 1", ())
    return (0, GENESIS) if row is None else (row[0] + 1, blob(row[1]))
