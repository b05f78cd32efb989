# SPDX-License-Identifier: Apache-2.0
"""`authguard audit explain`: one record of a log in words, from the log alone.

The words are the gate's own (`server.explanation`). The mission that a change starts from is in the
log too: in the record of its activation. Spec page: docs/reference/cli.md
"""

from __future__ import annotations

import json
from collections.abc import Callable, Container, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

import typer

from authguard_r.audit.closed import Closed, closed_of
from authguard_r.audit.record import LogRow, Record, read_record, read_sealed
from authguard_r.auditor.claims import claimed_mission
from authguard_r.cli.audit import StoreArgument
from authguard_r.cli.inputs import JsonFlag
from authguard_r.cli.log_reading import reading
from authguard_r.cli.signing_key import PassphraseFile
from authguard_r.cli.unsealing import ReaderOption, unsealer_of
from authguard_r.core.encoding import Tag, digest_of
from authguard_r.core.errors import AuthGuardError, EnvironmentFault, RefusedError
from authguard_r.core.mission import Mission
from authguard_r.core.reasons import Reason
from authguard_r.server.explanation import explanation, is_refused_proposal, no_record
from authguard_r.wire.output import emit

#: Releases that an outcome may be the end of; more than any robot has open.
_OPEN = 1_024

DraftOption = Annotated[
    Path | None,
    typer.Option("--draft", help="File for the smallest change, a draft."),
]


def explain_command(
    store: StoreArgument,
    seq: Annotated[int, typer.Argument(help="The record's number.", min=0)],
    draft: DraftOption = None,
    reader: ReaderOption = None,
    passphrase_file: PassphraseFile = None,
    as_json: JsonFlag = False,
) -> int:
    """Explain one record: what, who, why, and which signed change would have allowed it."""
    how = f"authguard audit explain {store} {seq} --draft FILE"
    opening = unsealer_of(reader, passphrase_file)
    with reading(store, opening) as log:
        told = explained(log.rows, seq, how=how, closed=opening.closed)
    lines = [str(line) for line in told["text"]]
    if draft is not None:
        lines.append(write_change(draft, told))
    emit(told, lines, as_json=as_json)
    return 0


def explained(
    rows: Iterable[LogRow],
    seq: int | None,
    *,
    how: str | None = None,
    closed: Callable[[Record, Container[str]], Closed] = closed_of,
) -> dict[str, Any]:
    """Return the explanation of a record, read in one pass over the rows before it.

    Args:
        rows: the log, in order; nothing is verified here (`audit verify` does).
        seq: the record; None takes the last refused proposal.
        how: the command that writes the smallest change; None: a running gate's.
        closed: says what of a record stays closed, once the rows up to it were read.

    Raises:
        RefusedError: there is no such record.
        MalformedError: the record is damaged.
    """
    missions: dict[str, Mission] = {}
    begun: dict[bytes, int] = {}
    found: tuple[LogRow, Mission | None] | None = None
    for row in rows:
        if b'"activate"' in row.record:
            _note(missions, row)
        if b'"kind":"decision"' in row.record:
            begun[_ticket(row)] = row.seq
            while len(begun) > _OPEN:
                begun.pop(next(iter(begun)))
        if row.seq == seq if seq is not None else _is_refused(row):
            found = row, _mission_of(missions, row)
            if seq is not None:
                break
    if found is None:
        raise no_record(seq)
    row, mission = found
    where = f"record {row.seq}"
    record, sealed = read_record(row.record, where=where), read_sealed(row.sealed, where=where)
    told = explanation(
        row.seq, record, sealed, mission=mission, how=how, closed=closed(record, sealed)
    )
    if record.kind == "outcome" and _ticket(row) in begun:
        told["text"].append(f"  it is how record {begun[_ticket(row)]} ended")
    return told


def write_change(path: Path, told: dict[str, Any]) -> str:
    """Write the smallest signed change as a draft; return what comes next.

    Raises:
        RefusedError: no signature would have allowed it.
        EnvironmentFault: something is there already.
    """
    change = told.get("smallest_change")
    if change is None:
        message = "no next version of the mission would have allowed it: `to do` says what else"
        raise RefusedError(message, reason=Reason.TRANSITION_REFUSED, where="--draft")
    text = f"# PROPOSED: what would have allowed record {told['seq']}. Nothing of it is in force.\n"
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text + json.dumps(change, indent=2) + "\n")
    except FileExistsError as error:
        message = f"`{path}` is there already, and a proposal takes nothing's place"
        raise EnvironmentFault(message, reason=Reason.FILE_UNAVAILABLE, where="--draft") from error
    return f"{path}: read it, then: authguard mission compile {path} --site SITE --supersedes TOKEN"


def _read(row: LogRow) -> Record:
    return read_record(row.record, where=f"record {row.seq}")


def _note(missions: dict[str, Mission], row: LogRow) -> None:
    """Note the mission that a record made active; a damaged one is explained without a change."""
    with suppress(AuthGuardError):
        record = _read(row)
        if record.link.decision != "activate":
            return
        sealed = read_sealed(row.sealed, where=f"record {row.seq}")
        mission = claimed_mission({name: item.value for name, item in sealed.items()})
        missions.clear()  # one is active at a time
        missions[digest_of(Tag.MISSION, mission)] = mission


def _ticket(row: LogRow) -> bytes:
    """Return the release that a record names, as it is spelled there."""
    return row.record.partition(b'"ticket":"')[2].partition(b'"')[0]


def _is_refused(row: LogRow) -> bool:
    return is_refused_proposal(_read(row))


def _mission_of(missions: dict[str, Mission], row: LogRow) -> Mission | None:
    with suppress(AuthGuardError):
        return missions.get(str(_read(row).open.get("mission")))
    return None
