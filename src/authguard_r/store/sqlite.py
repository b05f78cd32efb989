# SPDX-License-Identifier: Apache-2.0
"""The durable store: SQLite in WAL mode, synchronous FULL, one writer, group commit.

NORMAL would lose acknowledged commits in a power cut (L17). Whoever gets the lock first commits
for everybody who waits: one fsync for the whole batch, no thread of our own, and a lone caller
pays for nothing but its own transaction. Spec page: docs/spec/store.md
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Generic, TypeVar

import apsw

from authguard_r.audit.verify import Row
from authguard_r.core.chain import GENESIS
from authguard_r.core.errors import EnvironmentFault, StoreError
from authguard_r.core.ports import Turn
from authguard_r.core.reasons import Reason

T = TypeVar("T")

#: Marks the file as ours ("AGR1") and says which layout it has.
APPLICATION_ID = 0x41475231
FORMAT = 1
#: First SQLite without the WAL-reset corruption bug.
_OLDEST_SQLITE = (3, 51, 3)
_MAX_BATCH = 64
#: Held values that are remembered beside the file.
_MOST_KNOWN = 64

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
CREATE TRIGGER audit_no_update BEFORE UPDATE ON audit
BEGIN SELECT RAISE(ABORT, 'the audit log is append-only'); END;
CREATE TRIGGER audit_no_delete BEFORE DELETE ON audit
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

    __slots__ = ("done", "error", "job", "result")

    def __init__(self, job: Callable[[Turn], T]) -> None:
        self.job = job
        self.done = False
        self.result: T | None = None
        self.error: BaseException | None = None

    def finish(self) -> T:
        """Return the result or raise what went wrong."""
        if self.error is not None:
            raise self.error
        return self.result  # type: ignore[return-value]


class _SqliteTurn:
    """One consistent view inside the open transaction (`core.ports.Turn`).

    What a job puts and appends is kept apart until it ends well, as in the store in memory: a job
    that fails has written nothing, and needs no savepoint to undo it.
    """

    def __init__(self, connection: apsw.Connection, size: int, link: bytes) -> None:
        self._connection = connection
        self._many = connection.cursor().executemany
        self.size = size
        self.link = link
        self._puts: dict[tuple[str, str], bytes] = {}
        self._rows: list[tuple[int, bytes, bytes, bytes]] = []
        self._known: dict[tuple[str, str], bytes | None] = {}

    def write(self) -> None:
        """Write what the job put and appended; on disk when the batch commits."""
        self._many("INSERT INTO audit VALUES (?, ?, ?, ?)", self._rows)
        self._many(
            "INSERT INTO held VALUES (?, ?, ?) "
            "ON CONFLICT (kind, key) DO UPDATE SET value = excluded.value",
            [(*place, value) for place, value in self._puts.items()],
        )
        for place, value in self._puts.items():
            self._know(place, value)
        self._puts, self._rows = {}, []

    def drop(self, head: tuple[int, bytes]) -> None:
        """Forget what the job put and appended; none of it was written."""
        self.size, self.link = head
        self._puts, self._rows = {}, []

    def forget(self) -> None:
        """Read everything again: what was written may have been undone."""
        self._known.clear()

    def get(self, kind: str, key: str) -> bytes | None:
        """Return the value held under the key."""
        place = (kind, key)
        if place in self._puts:
            return self._puts[place]
        if place not in self._known:
            query = "SELECT value FROM held WHERE kind = ? AND key = ?"
            row = _first(self._connection, query, place)
            self._know(place, None if row is None else _blob(row[0]))
        return self._known[place]

    def put(self, kind: str, key: str, value: bytes) -> None:
        """Hold the value when the turn commits."""
        self._puts[kind, key] = value

    def _know(self, place: tuple[str, str], value: bytes | None) -> None:
        """Keep what is held: the lock is exclusive, so nobody else can change it."""
        if len(self._known) >= _MOST_KNOWN:
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


class SqliteStore:
    """Registry and audit log of one robot in one file (`core.ports.Store`)."""

    def __init__(self, connection: apsw.Connection) -> None:
        self._connection = connection
        self._execute = connection.cursor().execute
        self._lock = threading.Lock()
        self._pending: deque[_Ticket[object]] = deque()
        self._turn = _SqliteTurn(connection, *_read_head(connection))

    def run(self, job: Callable[[Turn], T]) -> T:
        """Run the job in the writer's turn; returns after its effects are on disk.

        Raises:
            StoreError: nothing of the job was committed.
        """
        ticket = _Ticket(job)
        self._pending.append(ticket)  # type: ignore[arg-type]
        with self._lock:
            while not ticket.done:  # a full batch may be before it
                self._commit_batch()
        return ticket.finish()

    def close(self) -> None:
        """Let go of the file."""
        with self._lock:
            self._connection.close()

    def _commit_batch(self) -> None:
        batch = [self._pending.popleft() for _ in range(min(len(self._pending), _MAX_BATCH))]
        before = self._turn.head()
        try:
            self._execute("BEGIN IMMEDIATE")
            for ticket in batch:
                self._run_one(ticket)
            self._execute("COMMIT")
        except apsw.Error as error:
            self._roll_back(before)
            for ticket in batch:
                ticket.error = store_error(error)
        except BaseException:
            self._roll_back(before)
            for ticket in batch:
                ticket.error = StoreError("the commit was interrupted", where="store")
            raise
        finally:
            for ticket in batch:
                ticket.done = True

    def _run_one(self, ticket: _Ticket[object]) -> None:
        """Run one job; its own mistake undoes it alone, the store's fault undoes the batch."""
        before = self._turn.head()
        try:
            ticket.result = ticket.job(self._turn)
        except apsw.Error:
            raise
        except BaseException as error:  # noqa: BLE001 - handed to the caller of `run`
            self._turn.drop(before)
            ticket.error = error
        else:
            self._turn.write()

    def _roll_back(self, before: tuple[int, bytes]) -> None:
        self._turn.drop(before)
        self._turn.forget()
        try:
            if self._connection.in_transaction:
                self._connection.execute("ROLLBACK")
            # an interrupt can come when the commit is done: what counts is what is there
            self._turn.drop(_read_head(self._connection))
        except apsw.Error:  # pragma: no cover - nothing was committed either way
            pass


def open_store(path: Path, *, vfs: str | None = None) -> SqliteStore:
    """Return the store in the file, made anew when there is none.

    Args:
        path: the file; its folder must exist.
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
    try:
        connection = apsw.Connection(str(path), vfs=vfs)
        try:
            _prepare(connection, path)
            return SqliteStore(connection)
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
                yield Row(seq, _blob(record), _blob(sealed), _blob(link))
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
            return _SqliteTurn(connection, 0, GENESIS).get(kind, key)
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
    # taking the exclusive lock now, not at the first decision
    connection.execute("BEGIN IMMEDIATE")
    if _is_empty(connection):  # again: now nobody else can make it
        connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
        connection.execute(f"PRAGMA user_version = {FORMAT}")
        connection.execute(_SCHEMA)
    connection.execute("COMMIT")


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
    row = _first(connection, "SELECT seq, link FROM audit ORDER BY seq DESC LIMIT 1", ())
    return (0, GENESIS) if row is None else (row[0] + 1, _blob(row[1]))


def _first(connection: apsw.Connection, query: str, values: tuple[str, ...]) -> Any:
    """Return the first row, or None; text that is no text is a damaged cell."""
    try:
        return connection.execute(query, values).fetchone()
    except UnicodeDecodeError as error:
        raise apsw.CorruptError("expected bytes, got broken text") from error


def _blob(cell: object) -> bytes:
    """Return a cell's bytes; a strict table holds nothing else, a damaged one may."""
    if isinstance(cell, bytes):
        return cell
    raise apsw.CorruptError(f"expected bytes, got {type(cell).__name__}")
