# SPDX-License-Identifier: Apache-2.0
"""`authguard audit verify`: is the log whole, and who says so?"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer

from authguard_r.audit.missing import told
from authguard_r.audit.note import read_key
from authguard_r.audit.parallel import MOST_JOBS, usable_jobs, verify_in_pieces
from authguard_r.audit.record import LogRow, Record, read_record, read_sealed
from authguard_r.audit.verify import Anchor, By, Verification
from authguard_r.cli.audit import StoreArgument
from authguard_r.cli.inputs import JsonFlag
from authguard_r.cli.log_anchors import AnchorOptions, KnownLog, known_of
from authguard_r.cli.log_reading import reading
from authguard_r.cli.logs import ReadableLog
from authguard_r.cli.signing_key import PassphraseFile
from authguard_r.cli.unsealing import EnvelopeCheck, ReaderOption, unsealer_of
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import RobotId
from authguard_r.core.quantities import to_timestamp
from authguard_r.keys.signer import gate_name
from authguard_r.wire.output import emit

#: Most processes that a user can ask for.
_MOST_ASKED = 64
#: What a log is held to, for people.
_HELD_TO: dict[By, str] = {
    "claimed": "a checkpoint in its file, signed by no key that was named,",
    "signed-terminal": "a signed terminal digest",
    "checkpoint": "a checkpoint",
    "witnessed": "a checkpoint, cosigned by enough witnesses,",
}


_CheckpointOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--checkpoint",
        help="A checkpoint from elsewhere: a signed note or terminal digest; repeatable.",
    ),
]
_KeyOption = Annotated[
    list[str] | None,
    typer.Option(
        "--log-key", help="A verifier key of the log (`audit key`); repeatable: all must sign."
    ),
]
_WitnessOption = Annotated[
    list[str] | None,
    typer.Option("--witness", help="Verifier key of a witness; repeatable."),
]
_QuorumOption = Annotated[
    int | None,
    typer.Option("--quorum", help="Number of witnesses that must sign (default: all).", min=1),
]
_TrustOption = Annotated[
    Path | None,
    typer.Option("--trust", help="A trust folder with the gate's certificate."),
]
_JobsOption = Annotated[
    int | None,
    typer.Option(
        "--jobs",
        help="Processes that verify a long log; 1: this one alone (default: one for each "
        f"processor that may be used, at most {MOST_JOBS}).",
        min=1,
        max=_MOST_ASKED,
    ),
]


def verify_command(
    store: StoreArgument,
    checkpoint: _CheckpointOption = None,
    key: _KeyOption = None,
    witness: _WitnessOption = None,
    quorum: _QuorumOption = None,
    trust: _TrustOption = None,
    jobs: _JobsOption = None,
    reader: ReaderOption = None,
    passphrase_file: PassphraseFile = None,
    as_json: JsonFlag = False,
) -> int:
    """Verify that a log is complete and unchanged; tampered or missing: 1, unreadable: 4.

    The command names the first record that is changed, missing, inserted or out of place. Only a
    checkpoint with a signature of a key that you name proves which log this is, up to that
    checkpoint. An attacker can restore an old file with its old checkpoint, so store one
    elsewhere. With a key or witnesses, the log must have such a checkpoint. A running gate sends
    its log itself. With --reader, this process also opens every sealed field of that key and
    checks it.
    """
    if quorum is not None and quorum > len(witness or ()):
        raise typer.BadParameter("expected at least as many witnesses", param_hint="--quorum")
    asked = AnchorOptions(
        kept=tuple(checkpoint or ()),
        keys=tuple(read_key(text, where="--log-key") for text in key or ()),
        witnesses=tuple(read_key(text, where="--witness") for text in witness or ()),
        quorum=quorum or len(witness or ()),
        trust=trust,
    )
    held = EnvelopeCheck(unsealer_of(reader, passphrase_file))
    with reading(store) as log:
        known = known_of(asked, log.notes)
        # beside a gate that drives a robot, it leaves the processors to the gate
        most = 1 if log.gate is not None or held.opens else jobs or usable_jobs()
        whose = _Whose()
        rows = whose.rows(held.rows(log.rows) if held.opens else log.rows)
        found = held.judged(verify_in_pieces(rows, jobs=most, anchors=known.anchors))
    lines = [*_lines(found, known, log, own=not asked.kept), *held.lines(found)]
    lines += whose.lines() if found.whole else ()
    payload = {**_payload(found, known, log), "log": whose.told}
    emit(payload | held.plain(), lines, as_json=as_json)
    return 0 if found.whole and not found.missing else 1


class _Whose:
    """Whose log it is, as its first record says; a checkpoint shows that this is so."""

    def __init__(self) -> None:
        self.told: dict[str, Any] = {}

    def rows(self, rows: Iterable[LogRow]) -> Iterator[LogRow]:
        """Yield the rows, and note what the first one says."""
        for row in rows:
            if row.seq == 0:
                with suppress(MalformedError):  # then the log is not whole, and says so
                    self._note(read_record(row.record, where="record 0"), row)
            yield row

    def lines(self) -> Iterator[str]:
        """Yield it for people."""
        if self.told:
            names = ("robot", "gate", "site", "root")
            yield "log of " + ", ".join(f"{name} {self.told[name]}" for name in names)

    def _note(self, record: Record, row: LogRow) -> None:
        opened, sealed = record.open, read_sealed(row.sealed, where="record 0")
        site = sealed["site"].value if "site" in sealed else None
        named = site.get("id") if isinstance(site, dict) else None
        robot = str(opened.get("robot"))
        self.told = {
            "robot": robot,
            "gate": gate_name(RobotId(robot)),
            "site": str(named or opened.get("site")),
            "root": str(opened.get("root")),
        }


def _payload(found: Verification, known: KnownLog, log: ReadableLog) -> dict[str, Any]:
    told_by = None if log.gate is None else log.gate.pid
    return {
        **msgspec.to_builtins(found),
        "held_to": [[anchor.by, anchor.size] for anchor in _by_size(known)],
        "told_by": told_by,
        "cosigned": [{"witness": seen.key.name, "time_s": seen.time_s} for seen in known.cosigned],
        "not_verified": list(known.ignored),
    }


def _by_size(known: KnownLog) -> list[Anchor]:
    return sorted(known.anchors, key=lambda anchor: anchor.size)


def _lines(found: Verification, known: KnownLog, log: ReadableLog, *, own: bool) -> Iterator[str]:
    if not found.whole:
        yield f"NOT WHOLE at {found.where}: {found.fault}"
        for anchor in _by_size(known):
            yield f"  compared with {_HELD_TO[anchor.by]} of {anchor.size} records"
        if not known.anchors:
            yield "  compared with nothing outside of it"
        return
    covers = f", {found.anchored_size} of {found.size} records" if found.anchored_size else ""
    yield f"whole: {found.size} records, head {found.head}"
    yield from told(found.missing)
    yield f"anchored: {found.anchored}{covers}"
    vouched = max((size for by, size in found.anchors if by == "witnessed"), default=0)
    for seen in known.cosigned:
        at = to_timestamp((seen.time_s or 0) * 1_000)
        covers = f": {vouched} records" if vouched else ""
        yield f"  cosigned by {seen.key.name} at {at}{covers}"
    for why in known.ignored:
        yield f"  a checkpoint next to it was not verified: {why}"
    if found.anchored_size and own:
        yield "  the checkpoint lies where the log lies: records after it may be missing"
    if not found.anchored_size:
        yield "  no outside checkpoint shows that no record is missing at the end"
    if log.gate is not None:
        yield f"  read from the running gate (process {log.gate.pid}), not read from disk"
