# SPDX-License-Identifier: Apache-2.0
"""`authguard audit replay`: is every decision of a log the one that its inputs call for?

The chain says that nothing was changed since it was written, not that it was right. Here each
decision is made again from the log alone, by the reference oracle, which shares no code with the
gate. The one place of this distribution that imports it (docs/adr/0021-replay.md).
Spec page: docs/spec/audit-record.md#replay
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer
from msgspec import Struct

import authguard_reference as oracle
from authguard_r.audit.missing import told as told_missing
from authguard_r.audit.record import NONE, LogRow, Record, read_record, read_sealed
from authguard_r.audit.verify import Verification, verify_rows
from authguard_r.auditor.replay.repairs import Repairs
from authguard_r.auditor.replay.sources import FAR_MS, Forged, Inputs, Lacking, Sources
from authguard_r.auditor.replay.text import plain
from authguard_r.cli.audit import StoreArgument
from authguard_r.cli.inputs import JsonFlag
from authguard_r.cli.listing import Listing, listing
from authguard_r.cli.log_reading import reading
from authguard_r.cli.signing_key import PassphraseFile
from authguard_r.cli.unsealing import LogUnsealer, ReaderOption, unsealer_of
from authguard_r.core.errors import AuthenticityError, MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.keys.trust import Trust, read_trust
from authguard_r.server.wiring import root_digest

#: What broken inputs can make of the oracle, which is written for sound ones.
_BROKEN = (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError)
#: What the safety gate decides by beside its envelope.
_BEYOND = frozenset({"rules", "checker"})
_UNVERIFIED = "  tokens were read and no signature was verified: name --trust"


class Difference(Struct, frozen=True, kw_only=True):
    """One record that no gate would have written.

    Args:
        seq: its number.
        kind: its kind.
        recorded: what a decision's record says, by name; only what differs.
        recomputed: what its inputs call for; None when they call for nothing.
        why: what does not hold, empty when only the two above differ.
    """

    seq: int
    kind: str
    recorded: dict[str, Any] = {}
    recomputed: dict[str, Any] | None = None
    why: str = ""


class Left(Struct, kw_only=True):
    """How many decisions could not be made again for one reason, and between which records."""

    count: int = 0
    first: int = 0
    last: int = 0


class LogReplay:
    """One pass over a log: what agrees, what differs, what cannot be said.

    Args:
        trust: whose signatures count; None: tokens are read and held to nothing.
        first: decisions before this record are not made again; what they stand on is read.
    """

    def __init__(self, trust: Trust | None, *, first: int = 0) -> None:
        self._trust = trust
        self._first = first
        self._sources = Sources(trust)
        self._repairs = Repairs()
        self.decisions = 0
        self.agree = 0
        self.differ = 0
        self.emergencies = 0
        self.unchecked = 0  # accepted, and the log does not say what the second gate was held to
        self.left: dict[str, Left] = {}

    def see(self, row: LogRow) -> Difference | None:
        """Take in one row that follows from those before it; return what is wrong with it.

        Raises:
            MalformedError: it is no record.
            AuthenticityError: the log began under another root than the one that is trusted.
        """
        record = read_record(row.record, where=f"record {row.seq}")
        sealed = read_sealed(row.sealed, where=f"record {row.seq}")
        values = {name: item.value for name, item in sealed.items()}
        wrong_repair = self._repairs.note(record)
        if record.kind == "genesis":
            self._require_root(record)
        if record.kind != "decision":
            self.emergencies += record.kind == "emergency" and record.link.decision == "accept"
            wrong = self._sources.note(record, values)
            return None if wrong is None else self._forged(record, wrong)
        if row.seq < self._first:
            self._sources.pass_by(record, values)
            return None
        self.decisions += 1
        found = self._sources.inputs(record, values)
        return self._decided(record, Forged(wrong_repair) if wrong_repair else found)

    def not_sealed(self, row: LogRow, error: AuthenticityError | MalformedError) -> Difference:
        """Return what is wrong with a row whose boxes no gate has sealed."""
        record = read_record(row.record, where=f"record {row.seq}")
        return self._forged(record, Forged(f"{error.reason}: {error.message} (at {error.where})"))

    @property
    def not_replayable(self) -> int:
        """Decisions that could not be made again."""
        return sum(item.count for item in self.left.values())

    def _require_root(self, record: Record) -> None:
        if self._trust is None or record.open.get("root") in {None, root_digest(self._trust)}:
            return
        raise AuthenticityError(
            "the log began under another root than this folder's",
            reason=Reason.CERTIFICATE_INVALID,
            where="--trust",
        )

    def _decided(self, record: Record, found: Inputs | Lacking | Forged) -> Difference | None:
        if isinstance(found, Lacking):
            self._leave(record, found.why)
            return None
        if isinstance(found, Forged):
            return self._forged(record, found)
        told = recorded(record)
        try:
            again = decided_again(found)
            is_accept = again["verdict"] == "accept"
            again["safe"] = _safe_again(found, told["safe"]) if is_accept else None
        except _BROKEN as error:
            return self._forged(record, Forged(f"no decision comes of it: {error!r}"))
        self.unchecked += is_accept and found.safety is None
        again["released"] = told["released"] and again["safe"] is True
        names = [name for name in told if told[name] != again[name]]
        if names and not found.ends_known and told["reasons"] == [Reason.CERTIFICATE_EXPIRED]:
            self._leave(record, "the revocation list of then is not in the log")
            return None
        if not names:
            self.agree += 1
            return None
        self.differ += 1
        return Difference(
            seq=record.link.seq,
            kind=record.kind,
            recorded={name: told[name] for name in names},
            recomputed={name: again[name] for name in names},
        )

    def _leave(self, record: Record, why: str) -> None:
        item = self.left.setdefault(why, Left(first=record.link.seq))
        item.count += 1
        item.last = record.link.seq

    def _forged(self, record: Record, wrong: Forged) -> Difference:
        self.differ += 1
        return Difference(seq=record.link.seq, kind=record.kind, why=wrong.why)


def decided_again(found: Inputs) -> dict[str, Any]:
    """Return the oracle's decision, in the words of a record."""
    state, standing, issuer = found.values["state"], found.values["standing"], found.issuer
    again = oracle.decide(
        found.mission,
        digest=found.digest,
        usable_until_ms=FAR_MS if issuer is None else issuer.usable_until_ms,
        action=found.values["action"],
        state=state[0] if state else None,
        facts=found.facts,
        now=found.values["now"],
        standing=standing[0] if standing else None,
        approvals=found.approvals,
        preapprovals=found.preapprovals,
        issuer=None if issuer is None else plain(issuer),
    )
    return {
        "verdict": again["verdict"],
        "reasons": again["reasons"],
        "grant": NONE if again["grant"] is None else again["grant"],
        "required": 1 if again["required"] is None else again["required"],
        "risk": 0 if again["risk"] is None else again["risk"],
        "preapproved": again["preapproved"],
    }


def _safe_again(found: Inputs, told: bool | None) -> bool | None:
    """Return what the safety gate has to say of an accepted action.

    The oracle has the envelope alone: where rules of what came before or a checker decide as well,
    they may refuse what it passes, and nothing passes that it refuses. Without the configuration
    in the log it is as the record says.
    """
    if found.safety is None:
        return told
    state = found.values["state"]
    dangers = oracle.hazards(
        found.safety,
        found.values["action"],
        state[0] if state else None,
        found.facts,
        found.values["now"],
    )
    if dangers or not _BEYOND & found.safety.keys():
        return not dangers
    return told


def recorded(record: Record) -> dict[str, Any]:
    """Return what a decision's record says."""
    opened, safety = record.open, record.open.get("safety")
    return {
        "verdict": record.link.decision,
        "reasons": opened.get("reasons"),
        "grant": opened.get("grant"),
        "required": opened.get("required"),
        "risk": opened.get("risk"),
        "preapproved": opened.get("preapproved"),
        "safe": safety.get("safe") if isinstance(safety, dict) else None,
        "released": opened.get("ticket") != NONE,
    }


def replayed(
    rows: Iterable[LogRow], replay: LogReplay, out: Listing, opening: LogUnsealer | None = None
) -> Verification:
    """Verify a log and replay it in one pass; each difference is reported as it is found.

    What is verified is what is stored; what is decided again is what a reader's key opens of it.

    Args:
        rows: the log as it is stored; untrusted.
        replay: what counts.
        out: where differences go.
        opening: what opens its rows; None for a reader without a key.
    """
    open_row = (opening or LogUnsealer()).opened

    def followed() -> Iterator[LogRow]:
        for row in rows:
            yield row  # the verifier asks for the next one only when this one was valid
            out.tick(row.seq)
            try:
                told = open_row(row)
            except (AuthenticityError, MalformedError) as error:
                wrong: Difference | None = replay.not_sealed(row, error)
            else:
                wrong = replay.see(told)
            if wrong is not None:
                out.add(_told(wrong), *_wrong_lines(wrong))

    return verify_rows(followed(), terminal=None)


def replay_command(
    store: StoreArgument,
    trust: Annotated[
        Path | None,
        typer.Option("--trust", help="The trust folder: every token is verified."),
    ] = None,
    first: Annotated[
        int, typer.Option("--first", help="Number of the first record to decide again.", min=0)
    ] = 0,
    reader: ReaderOption = None,
    passphrase_file: PassphraseFile = None,
    as_json: JsonFlag = False,
) -> int:
    """Make every decision of a log again, from the log alone; exit 1 when one differs.

    The command also verifies the log. A log that is not complete is exit 1, and so is a log
    without values that no order in it destroyed.
    """
    anchor = None if trust is None else read_trust(trust)
    replay, opening = LogReplay(anchor, first=first), unsealer_of(reader, passphrase_file)
    with listing("differences", as_json=as_json) as out, reading(store) as log:
        found = replayed(log.rows, replay, out, opening)
        told_by = None if log.gate is None else log.gate.pid
        why = [
            {"why": why, "count": item.count, "first": item.first, "last": item.last}
            for why, item in replay.left.items()
        ]
        rest = {
            "decisions": replay.decisions,
            "agree": replay.agree,
            "differ": replay.differ,
            "not_replayable": replay.not_replayable,
            "why": why,
            "emergencies": replay.emergencies,
            "unchecked": replay.unchecked,
            "verified": anchor is not None,
            "from": first,
            "whole": found.whole,
            "size": found.size,
            "head": found.head,
            "fault": found.fault,
            "where": found.where,
            "missing": msgspec.to_builtins(found.missing),
            "told_by": told_by,
        }
        lines = [*_lines(replay, found), *([] if anchor is not None else [_UNVERIFIED])]
        out.end(rest, lines)
    return 0 if found.whole and not (replay.differ or found.missing) else 1


def _lines(replay: LogReplay, found: Verification) -> Iterator[str]:
    if found.whole:
        yield f"whole: {found.size} records, head {found.head}"
    else:
        yield f"NOT WHOLE at {found.where}: {found.fault}; replayed up to there"
    yield from told_missing(found.missing)
    counts = f"{replay.agree} agree, {replay.differ} differ, {replay.not_replayable} not replayable"
    yield f"replayed: {replay.decisions} decisions, {counts}"
    for why, item in replay.left.items():
        yield f"  not replayable {item.count} (record {item.first} to {item.last}): {why}"
    if replay.unchecked:
        yield f"  {replay.unchecked} accepted: the second gate's configuration is not in the log"
    if replay.emergencies:
        yield f"  {replay.emergencies} emergency releases: decided by no mission, not made again"


def _told(wrong: Difference) -> dict[str, Any]:
    """Return a difference as data."""
    return {
        "seq": wrong.seq,
        "kind": wrong.kind,
        "recorded": wrong.recorded,
        "recomputed": wrong.recomputed,
        "why": wrong.why,
    }


def _wrong_lines(wrong: Difference) -> Iterator[str]:
    if wrong.why:
        yield f"DIFFERS record {wrong.seq} ({wrong.kind}): {wrong.why}"
        return
    yield f"DIFFERS record {wrong.seq}"
    for name, value in wrong.recorded.items():
        again = None if wrong.recomputed is None else wrong.recomputed[name]
        yield f"  {name}: recorded {_word(value)}, recomputed {_word(again)}"


def _word(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(map(str, value)) or "none"
    return str(value)
