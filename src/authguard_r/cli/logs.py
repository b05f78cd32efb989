# SPDX-License-Identifier: Apache-2.0
"""A log to read: an export's, a store's, or page by page from the gate that holds the store."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msgspec import Struct

from authguard_r.anchoring.checkpoints import CHECKPOINT, NEWEST, WITNESSED
from authguard_r.audit.record import LogRow
from authguard_r.auditor.export_format import exported_note, exported_rows, is_export
from authguard_r.cli.gateway import GateAddress, beside_store, connect_as, told_of
from authguard_r.core.encoding import encode, unb64
from authguard_r.core.errors import EnvironmentFault, MalformedError
from authguard_r.store.sqlite import read_held, read_rows
from authguard_r.wire.messages import ClientRole

if TYPE_CHECKING:  # loaded when a gate is asked
    from authguard_r.client import GateClient

#: Records that are asked for at a time.
_PAGE = 1_000


class ReadableLog(Struct, frozen=True):
    """A log that can be read once.

    Args:
        rows: its rows in order; untrusted.
        gate: the gate that returns them, None: they are the file's.
        status: that gate's, as it said it.
        notes: checkpoints that lie with the rows, the newest first; not checked.
    """

    rows: Iterator[LogRow]
    gate: GateAddress | None = None
    status: dict[str, Any] = {}
    notes: tuple[bytes, ...] = ()


@contextmanager
def open_log(store: Path) -> Iterator[ReadableLog]:
    """Yield the log of a store, from the gate that holds it when one answers, or an export's.

    Raises:
        MalformedError: an export whose last line is not an export's last line.
        StoreError: the file cannot be read; a gate that holds it and does not answer is named.
        AuthGuardError: the gate does not let this user read.
    """
    if is_export(store):
        note = exported_note(store)
        yield ReadableLog(exported_rows(store), notes=() if note is None else (note,))
        return
    beside = beside_store(store)
    client = None if beside is None else _reader(Path(beside.socket))
    if client is None:
        with told_of(beside, store, tried=True):
            held = [read_held(store, CHECKPOINT, key) for key in (NEWEST, WITNESSED)]
            yield ReadableLog(read_rows(store), notes=tuple(filter(None, dict.fromkeys(held))))
        return
    with client:
        status = client.status()
        notes = [str(note).encode() for note in (status.get("anchor") or {}).get("notes", ())]
        yield ReadableLog(_told(client, status), beside, status, tuple(notes))


def _reader(path: Path) -> GateClient | None:
    """Return a client that may read, or None when no process listens there."""
    try:
        return connect_as(path, (ClientRole.AUDITOR, ClientRole.OPERATOR))
    except EnvironmentFault as error:
        if error.where == str(path):
            return None
        raise


def _told(client: GateClient, status: dict[str, Any]) -> Iterator[LogRow]:
    """Yield the records that are there now; what comes meanwhile is left for the next time."""
    first, size = 0, (status.get("log") or {}).get("size", 0)
    while first < size:
        page = client.records(first, min(_PAGE, size - first)).get("records")
        if not isinstance(page, list) or not page:
            raise MalformedError(f"expected {size} records, got {first}", where="records")
        for item in page:
            yield _row(item, first)
            first += 1


def _row(item: Any, number: int) -> LogRow:
    """Return a record in the bytes that it is stored in: a log holds canonical ones alone."""
    where = f"record {number}"
    try:
        record, sealed = encode(item["record"]), encode(item["sealed"])
        return LogRow(int(item["seq"]), record, sealed, unb64(item["link"], where=where))
    except (LookupError, TypeError, ValueError) as error:
        raise MalformedError("expected {seq, record, sealed, link}", where=where) from error
