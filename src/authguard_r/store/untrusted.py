# SPDX-License-Identifier: Apache-2.0
"""A store's file from an unknown source: opened so that nothing in it runs, read within bounds.

A file of SQLite is a program: a view, a trigger or a column that is computed decides what a query
returns, and a page that points at another twice makes a few bytes into many. So the schema has to
be ours to the letter, what could run is switched off, and work and memory are bounded by the file's
size. Spec page: docs/spec/store.md#reading
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import apsw

from authguard_r.core.errors import StoreError
from authguard_r.core.reasons import Reason
from authguard_r.store.layout import TABLES

#: The longest value of one cell, in bytes: a site, whole, is far below.
MAX_CELL = 16 << 20
#: Steps of SQLite's machine between two looks, and how many looks a byte of the file is worth.
_STEPS, _BYTES_A_LOOK, _LOOKS = 10_000, 2_000, 1_000
#: Objects that a store of any version may have beside its tables; none of them runs here.
_TRIGGERS = frozenset(
    f"audit_{what}"
    for what in ("no_delete", "no_gap", "no_insert", "no_update", "only_forgets", "only_moved")
)
#: Objects that a store has, at most.
_MOST_OBJECTS = 16
_LIMITS = {
    apsw.SQLITE_LIMIT_LENGTH: MAX_CELL,
    apsw.SQLITE_LIMIT_SQL_LENGTH: 100_000,
    apsw.SQLITE_LIMIT_COLUMN: 32,
    apsw.SQLITE_LIMIT_EXPR_DEPTH: 32,
    apsw.SQLITE_LIMIT_COMPOUND_SELECT: 2,
    apsw.SQLITE_LIMIT_ATTACHED: 0,
    apsw.SQLITE_LIMIT_TRIGGER_DEPTH: 1,
}
_OFF = (
    apsw.SQLITE_DBCONFIG_ENABLE_TRIGGER,
    apsw.SQLITE_DBCONFIG_ENABLE_VIEW,
    apsw.SQLITE_DBCONFIG_TRUSTED_SCHEMA,
)
_OURS = {" ".join(statement.split()) for statement in TABLES.split(";") if statement.strip()}


class _Patience:
    """Ends a query that takes more steps than a file of this size can need."""

    def __init__(self, size: int) -> None:
        self._left = _LOOKS + size // _BYTES_A_LOOK

    def __call__(self) -> bool:
        self._left -= 1
        return self._left < 0


def open_stranger(path: Path) -> apsw.Connection:
    """Return a read-only connection to a file that is not trusted.

    Raises:
        StoreError: what it holds is not laid out as a store or a segment is.
        apsw.Error: it cannot be opened.
    """
    connection = apsw.Connection(str(path), flags=apsw.SQLITE_OPEN_READONLY)
    try:
        hold(connection, path)
    except BaseException:
        connection.close()
        raise
    return connection


def hold(connection: apsw.Connection, path: Path) -> None:
    """Switch off what could run, bound what may be used, and require our schema.

    Raises:
        StoreError: it is not laid out as a store or a segment is.
        apsw.Error: it cannot be read.
    """
    for kind, most in _LIMITS.items():
        connection.limit(kind, most)
    for switch in _OFF:
        connection.config(switch, 0)
    connection.config(apsw.SQLITE_DBCONFIG_DEFENSIVE, 1)
    connection.set_progress_handler(_Patience(_held_bytes(path)), _STEPS)
    for pragma in ("query_only = ON", "cell_size_check = ON", "mmap_size = 0"):
        connection.execute(f"PRAGMA {pragma}").fetchall()
    _require_schema(connection, path)


def _held_bytes(path: Path) -> int:
    """Return how many bytes a file and its write-ahead log hold; holes hold none."""
    files = (path, path.with_name(f"{path.name}-wal"))
    return sum(file.stat().st_blocks * 512 for file in files if file.exists())


def _require_schema(connection: apsw.Connection, path: Path) -> None:
    """Require our two tables to the letter, and beside them nothing but triggers of ours."""
    query = "SELECT type, name, tbl_name, sql FROM sqlite_schema LIMIT 17"
    tables, others = set(), []
    try:
        for number, (kind, name, of, sql) in enumerate(connection.execute(query)):
            text = " ".join(str(sql).split())
            ours = name in _TRIGGERS and of == "audit" and text.startswith("CREATE TRIGGER ")
            if kind == "table" and number < _MOST_OBJECTS:
                tables.add(text)
            elif number >= _MOST_OBJECTS or kind != "trigger" or not ours:
                others.append(f"{kind} `{name}`")
    except UnicodeDecodeError as error:
        raise apsw.CorruptError("expected a schema, got broken text") from error
    if tables != _OURS or others:
        told = ", ".join(others) or "other tables than `held` and `audit`"
        raise StoreError(
            f"the file is no store: it has {told[:200]}",
            where=str(path),
            reason=Reason.STORE_CORRUPT,
        )


class ReadMeter:
    """Ends the reading of a file that gives more bytes than it has.

    Args:
        path: the file.
        times: how often its bytes are read.
    """

    def __init__(self, path: Path, *, times: int = 1) -> None:
        self._path = path
        self._left = times * _held_bytes(path) + MAX_CELL

    def took(self, *cells: bytes) -> None:
        """Count what was read.

        Raises:
            StoreError: it is more than the file has.
        """
        self._left -= sum(map(len, cells))
        if self._left < 0:
            raise StoreError(
                "the store is corrupt: it returns more than it contains",
                where=str(self._path),
                reason=Reason.STORE_CORRUPT,
            )


def in_order(
    rows: Iterator[tuple[int, bytes, bytes, bytes]], path: Path
) -> Iterator[tuple[int, bytes, bytes, bytes]]:
    """Yield rows whose numbers grow, within what the file can hold.

    Raises:
        StoreError: they do not, or there are more than the file has.
    """
    meter, last = ReadMeter(path), None
    for seq, record, sealed, link in rows:
        if not isinstance(seq, int) or (last is not None and seq <= last):
            raise StoreError(
                f"the store is corrupt: record {seq} comes after record {last}",
                where=str(path),
                reason=Reason.STORE_CORRUPT,
            )
        last = seq
        meter.took(record, sealed, link)
        yield seq, record, sealed, link
