# SPDX-License-Identifier: Apache-2.0
"""What is read out of an SQLite file that may be damaged, and our words for SQLite's faults.

Spec page: docs/spec/store.md#writers
"""

from __future__ import annotations

from typing import Any

import apsw

from authguard_r.core.errors import StoreError
from authguard_r.core.reasons import Reason

#: A row of the log: seq, record, sealed, link.
Cells = tuple[int, bytes, bytes, bytes]

_REASONS: tuple[tuple[type[Exception], Reason, str], ...] = (
    (apsw.FullError, Reason.STORE_FULL, "the disk is full"),
    (apsw.ReadOnlyError, Reason.STORE_READ_ONLY, "the store is read-only"),
    (apsw.CorruptError, Reason.STORE_CORRUPT, "the store is corrupt"),
    (UnicodeDecodeError, Reason.STORE_CORRUPT, "the store is corrupt"),
    (apsw.TooBigError, Reason.STORE_CORRUPT, "a value is longer than any of ours"),
    (apsw.InterruptError, Reason.STORE_CORRUPT, "it takes longer than a file of its size can"),
    (apsw.NotADBError, Reason.STORE_CORRUPT, "the file is no store"),
    (apsw.SQLError, Reason.STORE_CORRUPT, "the store is corrupt"),
    (apsw.ConstraintError, Reason.STORE_CORRUPT, "the store is corrupt"),
    (
        apsw.BusyError,
        Reason.STORE_UNAVAILABLE,
        "another process has the store open (is a gate running?)",
    ),
    (
        apsw.LockedError,
        Reason.STORE_UNAVAILABLE,
        "another process has the store open (is a gate running?)",
    ),
)


def store_error(error: apsw.Error | UnicodeDecodeError, *, where: str = "store") -> StoreError:
    """Return our word for SQLite's; text that is no text is a damaged cell."""
    for kind, reason, message in _REASONS:
        if isinstance(error, kind):
            return StoreError(f"{message}: {error}", reason=reason, where=where)
    return StoreError(str(error) or type(error).__name__, where=where)


def first_row(connection: apsw.Connection, query: str, values: tuple[object, ...]) -> Any:
    """Return the first row, or None; text that is no text is a damaged cell."""
    try:
        return connection.execute(query, values).fetchone()
    except UnicodeDecodeError as error:
        raise apsw.CorruptError("expected bytes, got broken text") from error


def cells(connection: apsw.Connection, first: int, end: int) -> list[Cells]:
    """Return the log's rows from `first` to before `end`."""
    rows = "SELECT seq, record, sealed, link FROM audit"
    query = f"{rows} WHERE seq >= ? AND seq < ? ORDER BY seq LIMIT ?"
    try:  # one more than there can be, so that a file with a number twice is found out
        found: Any = connection.execute(query, (first, end, end - first + 1)).fetchall()
    except UnicodeDecodeError as error:
        raise apsw.CorruptError("expected bytes, got broken text") from error
    return [(seq, blob(record), blob(sealed), blob(link)) for seq, record, sealed, link in found]


def held_value(connection: apsw.Connection, kind: str, key: str) -> bytes | None:
    """Return a held value."""
    query = "SELECT value FROM held WHERE kind = ? AND key = ?"
    row = first_row(connection, query, (kind, key))
    return None if row is None else blob(row[0])


def blob(cell: object) -> bytes:
    """Return a cell's bytes; a strict table holds nothing else, a damaged one may."""
    if isinstance(cell, bytes):
        return cell
    raise apsw.CorruptError(f"expected bytes, got {type(cell).__name__}")
