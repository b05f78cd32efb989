# SPDX-License-Identifier: Apache-2.0
"""`authguard audit segments`: the files that a store's oldest records lie in, each held to a key.

Spec page: docs/spec/store.md#segments
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import apsw
import typer

from authguard_r.audit.checkpoint import read_checkpoint
from authguard_r.audit.note import NoteKey, read_key, read_note
from authguard_r.audit.tree import Frontier, leaf_hash
from authguard_r.cli.inputs import JsonFlag
from authguard_r.cli.log_reading import strange
from authguard_r.core.chain import GENESIS
from authguard_r.core.encoding import b64
from authguard_r.core.errors import StoreError
from authguard_r.core.reasons import Reason
from authguard_r.keys.notes import require_all
from authguard_r.store.folder import Folder
from authguard_r.store.segments import MARK, SEGMENT, SegmentClaims, find, links, name_of
from authguard_r.store.sqlite import read_held
from authguard_r.wire.output import emit


def segments_command(
    store: Annotated[
        Path, typer.Argument(metavar="STORE", help="A store; a gate may have it open.")
    ],
    key: Annotated[
        list[str] | None,
        typer.Option(
            "--log-key", help="A verifier key of the log (`audit key`); repeatable: all must sign."
        ),
    ] = None,
    as_json: JsonFlag = False,
) -> int:
    """List the segments of a log: file, records, bytes, and whether the checkpoint is valid.

    With --log-key, the signature of each checkpoint is verified, and the links of all records up
    to it. `audit verify` verifies the values in the segments.
    """
    keys = tuple(read_key(text, where="--log-key") for text in key or ())
    with strange():
        mark, folder = _mark(store), Folder(store)
        told = list(_told(folder, keys))
        end = told[-1]["end"] if told else 0
        if end < mark:
            text = f"the segment with record {end} is missing: the store has moved {mark} records"
            raise StoreError(text, where=folder.place(name_of(end)), reason=Reason.STORE_CORRUPT)
    emit({"store": str(store), "segments": told}, _lines(told), as_json=as_json)
    return 0


def _mark(store: Path) -> int:
    """Return how many records the store has moved; 0 while a gate holds it and it cannot be read.

    Raises:
        StoreError: it cannot be read.
    """
    try:
        return int(read_held(store, SEGMENT, MARK) or b"0")
    except StoreError as error:
        if isinstance(error.__cause__, apsw.BusyError | apsw.LockedError):
            return 0
        raise


def _told(folder: Folder, keys: tuple[NoteKey, ...]) -> Iterator[dict[str, Any]]:
    """Yield a line for each segment, in order.

    Raises:
        StoreError: one is missing, damaged, or does not join the one before.
        AuthenticityError: a checkpoint is not signed with the keys.
    """
    end, head, tree = 0, b64(GENESIS), Frontier()
    for name in folder.names():
        if not name.endswith(".db"):
            continue
        found = find(folder, name)
        segment = found.segment
        if (segment.first, segment.before) != (end, head):
            text = f"expected the segment that begins with record {end}, `{name_of(end)}`"
            raise StoreError(text, where=folder.place(name), reason=Reason.STORE_CORRUPT)
        if keys:
            tree = tree.grown(map(leaf_hash, links(folder, name)))
            _require_signed(found, tree, keys, where=folder.place(name))
        end, head = segment.end, segment.head
        yield {
            "file": folder.place(name),
            "first": segment.first,
            "end": segment.end,
            "bytes": folder.size(name),
            "verified": bool(keys),
        }


def _require_signed(
    found: SegmentClaims, tree: Frontier, keys: tuple[NoteKey, ...], *, where: str
) -> None:
    note = read_note(found.note, where=where)
    origin = read_checkpoint(note.text, where=where).origin
    said = require_all(note, tuple(one for one in keys if one.name == origin) or keys, where=where)
    if (said.size, said.root) != (tree.size, tree.root()):
        text = "its records are not those of its checkpoint"
        raise StoreError(text, where=where, reason=Reason.STORE_CORRUPT)


def _lines(told: list[dict[str, Any]]) -> Iterator[str]:
    if not told:
        yield "no segments: every record is in the store itself"
    for one in told:
        held = "checkpoint verified" if one["verified"] else "checkpoint not verified: name --key"
        records = f"records {one['first']} to {one['end'] - 1}, {one['bytes']:,} bytes"
        yield f"{one['file']}: {records}, {held}"
