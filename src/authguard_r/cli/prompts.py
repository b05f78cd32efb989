# SPDX-License-Identifier: Apache-2.0
"""`authguard audit prompts`: how often a person was asked for each mission."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
from msgspec.structs import replace

from authguard_r.audit.prompts import activated, count_prompts
from authguard_r.audit.record import LogRow, Record, read_record, read_sealed
from authguard_r.cli.audit import StoreArgument
from authguard_r.cli.inputs import JsonFlag
from authguard_r.cli.log_reading import strange
from authguard_r.cli.logs import ReadableLog, open_log
from authguard_r.cli.signing_key import PassphraseFile
from authguard_r.cli.unsealing import ReaderOption, unsealer_of
from authguard_r.core.encoding import decode
from authguard_r.core.errors import MalformedError
from authguard_r.core.standing import Standing
from authguard_r.store.sqlite import read_held
from authguard_r.wire.output import emit


def prompts_command(
    store: StoreArgument,
    reader: ReaderOption = None,
    passphrase_file: PassphraseFile = None,
    as_json: JsonFlag = False,
) -> int:
    """Count how often people were asked: signatures, requests and choices of each mission."""
    opening = unsealer_of(reader, passphrase_file)
    with strange(), open_log(store) as log:
        rows = list(opening.rows(log.rows))
    records = [read_record(row.record, where=f"record {row.seq}") for row in rows]
    standings = _held(store, records) if log.gate is None else _told(log, rows, records)
    closed = [] if log.gate is None else _closed(records, standings)
    found = count_prompts(records, standings)
    figure = float(round(found.per_mission, 3)) if found.missions else None
    payload = {**msgspec.to_builtins(found), "asked": found.asked, "per_mission": figure}
    payload |= {"closed": closed} if closed else {}
    asked = f"a person was asked {found.asked} time(s) for {found.missions} mission(s)"
    parts = f"{found.signatures} signature(s), {found.requests} approval request(s)"
    rate = "no missions yet" if figure is None else f"{figure:g} approval requests per mission"
    head = rate if figure is None else f"{rate}: {asked}"
    lines = [head, f"  {parts}, {found.choices} choice(s)"]
    if log.gate is not None:
        lines.append("  as the running gate reports it; an ended mission may have one more request")
    if closed:
        named = ", ".join(closed)
        lines.append(f"  sealed or destroyed, so requests are not counted: missions {named}")
    emit(payload, lines, as_json=as_json)
    return 0


def _held(store: Path, records: list[Record]) -> dict[Any, Standing | None]:
    """Return the registry's entries of the missions in a log."""
    standings: dict[Any, Standing | None] = {}
    for mid in activated(records):
        held = read_held(store, "standing", mid)
        standings[mid] = None if held is None else decode(held, Standing, where="store.standing")
    return standings


def _told(
    log: ReadableLog, rows: list[LogRow], records: list[Record]
) -> dict[Any, Standing | None]:
    """Return what a gate's log and status say of its missions: the last that a decision saw."""
    standings: dict[Any, Standing | None] = dict.fromkeys(activated(records))
    for row, record in zip(rows, records, strict=True):
        if record.kind == "decision" and record.link.mid in standings:
            seen = read_sealed(row.sealed, where=f"record {row.seq}").get("standing")
            for plain in [] if seen is None else seen.value:
                standings[record.link.mid] = _standing(plain, row.seq)
    mission = log.status.get("mission") or {}
    last = standings.get(mission.get("mid"))
    if last is not None:
        standings[last.mid] = replace(last, prompts=max(last.prompts, mission.get("prompts", 0)))
    return standings


def _closed(records: list[Record], standings: dict[Any, Standing | None]) -> list[str]:
    """Return the missions of which a log has what their decisions saw, and does not tell it."""
    decided = {record.link.mid for record in records if "standing" in record.committed}
    return [mid for mid, standing in standings.items() if mid in decided and standing is None]


def _standing(plain: Any, seq: int) -> Standing:
    try:
        return msgspec.convert(plain, Standing)
    except msgspec.ValidationError as error:
        raise MalformedError(str(error), where=f"record {seq}") from error
