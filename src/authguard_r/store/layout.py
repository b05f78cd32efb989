# SPDX-License-Identifier: Apache-2.0
"""The layout of a store's file, and how one is taken hold of.

The triggers guard against mistakes: a writer of the file can remove them. Spec page:
docs/spec/store.md#file
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import apsw

from authguard_r.core.errors import StoreError
from authguard_r.core.reasons import Reason

#: Marks the file as ours ("AGR1") and says which layout it has: 2 is one with segments beside it.
APPLICATION_ID = 0x41475231
FORMAT, ALONE = 2, 1
TABLES = """
CREATE TABLE held (
  kind TEXT NOT NULL, key TEXT NOT NULL, value BLOB NOT NULL, PRIMARY KEY (kind, key)
) STRICT, WITHOUT ROWID;
CREATE TABLE audit (
  seq INTEGER PRIMARY KEY, record BLOB NOT NULL, sealed BLOB NOT NULL, link BLOB NOT NULL
) STRICT;
"""
#: Sealed values may go, each as a whole; nothing else ever changes.
ONLY_FORGETS = """
CREATE TRIGGER IF NOT EXISTS audit_only_forgets BEFORE UPDATE ON audit
WHEN NEW.seq IS NOT OLD.seq OR NEW.record IS NOT OLD.record OR NEW.link IS NOT OLD.link OR EXISTS (
  SELECT key, value FROM json_each(CAST(NEW.sealed AS TEXT))
  EXCEPT SELECT key, value FROM json_each(CAST(OLD.sealed AS TEXT))
)
BEGIN SELECT RAISE(ABORT, 'the audit log is append-only'); END;
"""
_NO_GAP = """
CREATE TRIGGER audit_no_gap BEFORE INSERT ON audit
WHEN NEW.seq IS NOT (SELECT coalesce(max(seq) + 1, 0) FROM audit)
BEGIN SELECT RAISE(ABORT, 'the audit log is append-only'); END;
"""
#: Records go when a segment has them, and not before; a store of before had stricter rules.
_ONLY_MOVED = """
DROP TRIGGER IF EXISTS audit_no_update;
DROP TRIGGER IF EXISTS audit_no_delete;
CREATE TRIGGER IF NOT EXISTS audit_only_moved BEFORE DELETE ON audit
WHEN OLD.seq >= coalesce(
  (SELECT CAST(CAST(value AS TEXT) AS INTEGER) FROM held WHERE kind = 'segment' AND key = 'mark'),
  0
)
BEGIN SELECT RAISE(ABORT, 'the audit log is append-only'); END;
"""


def prepare(connection: apsw.Connection, path: Path) -> None:
    """Take hold of a store, made here when the file is empty.

    Raises:
        StoreError: it is no store, or a newer one.
        apsw.Error: it is held by another process, read-only or damaged.
    """
    connection.set_busy_timeout(0)
    if connection.readonly("main"):
        raise apsw.ReadOnlyError("it was opened without the right to write")
    # before the first page is read, so that the index of the WAL is never in shared memory
    connection.execute("PRAGMA locking_mode = EXCLUSIVE").fetchall()
    # looked at before anything is written: what is not ours is left alone
    if not is_empty(connection):
        require_format(connection, path)
    connection.execute("PRAGMA journal_mode = WAL").fetchall()
    connection.execute("PRAGMA synchronous = FULL")
    # a page that is split keeps no copy of what is let go of later
    connection.execute("PRAGMA secure_delete = FAST")
    erase(connection)  # after a crash, of what may have been let go of before it
    # taking the exclusive lock now, not at the first decision
    connection.execute("BEGIN IMMEDIATE")
    if is_empty(connection):  # again: now no other process can make it
        connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
        connection.execute(f"PRAGMA user_version = {ALONE}")
        connection.execute(TABLES + _NO_GAP)
    connection.execute(_ONLY_MOVED + ONLY_FORGETS)
    connection.execute("COMMIT")


def erase(connection: apsw.Connection) -> bool:
    """Empty the write-ahead log; False when that cannot be done now. Commits stand either way."""
    with suppress(apsw.Error):
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
        return True
    return False


def is_empty(connection: apsw.Connection) -> bool:
    """True for a file that was never used."""
    marks = ("application_id", "user_version", "schema_version")
    return all(connection.execute(f"PRAGMA {mark}").get == 0 for mark in marks)


def require_format(connection: apsw.Connection, path: Path) -> None:
    """Refuse a file that is no store, or that a newer program wrote.

    Raises:
        StoreError: either.
    """
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
