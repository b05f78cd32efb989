# SPDX-License-Identifier: Apache-2.0
"""`authguard audit show`: a log as a timeline: who asked for what, what was said, how it ended."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from typing import Annotated, Any

import msgspec
import typer
from msgspec import Struct

from authguard_r.audit.closed import Closed
from authguard_r.audit.record import NONE, LogRow, Record, read_record, read_sealed
from authguard_r.audit.sealed_envelopes import SEALING, act_of
from authguard_r.cli.audit import StoreArgument
from authguard_r.cli.inputs import JsonFlag, wall_now
from authguard_r.cli.listing import Listing, listing
from authguard_r.cli.log_reading import reading
from authguard_r.cli.signing_key import PassphraseFile
from authguard_r.cli.unsealing import LogUnsealer, ReaderOption, unsealer_of
from authguard_r.core.errors import MalformedError
from authguard_r.core.quantities import to_timestamp
from authguard_r.core.reasons import Reason
from authguard_r.core.safety import Hazard
from authguard_r.server.explanation import hazards_of, repaired_by, verdict_of, who_of

#: How much of a digest a line shows; `--json` has all of it.
_SHORT = 12
#: Lines that wait for how a release ended, so that its own line can say it.
_WAITING = 256
#: Releases whose end is still to come; more than any robot has.
_OPEN = 1_024
_REASONS = frozenset(map(str, (*Reason, *Hazard)))
_NOTHING = Closed()


class RecordFilter(Struct, frozen=True, kw_only=True):
    """Which records are shown; None: whichever.

    Args:
        kind: of this kind.
        refused: with a reason against something.
        would: with one that an enforcing gate would have refused for: of a run in shadow mode.
        mission: of this mission.
        client: by whom, as the log names them, or without the number of their user.
        reason: with this code.
        since_ms: not before.
        until_ms: not after.
        first: from this number on.
        last: up to this number.
    """

    kind: str | None = None
    refused: bool = False
    would: bool = False
    mission: str | None = None
    client: str | None = None
    reason: str | None = None
    since_ms: int = 0
    until_ms: int | None = None
    first: int = 0
    last: int | None = None

    def has(self, record: Record, values: dict[str, Any]) -> bool:
        """True for a record that is shown."""
        reasons = (*(record.open.get("reasons") or ()), *hazards_of(record))
        return (
            (self.kind is None or record.kind == self.kind)
            and (not (self.refused or self.would) or bool(reasons))
            and (not self.would or record.open.get("mode") == "shadow")
            and (self.mission is None or record.link.mid == self.mission)
            and (self.reason is None or self.reason in reasons)
            and self.since_ms <= record.link.time_ms
            and (self.until_ms is None or record.link.time_ms <= self.until_ms)
            and self.first <= record.link.seq
            and (self.client is None or _is_named(self.client, who_of(record, values)))
        )


class _PendingLine(Struct, kw_only=True):
    """A line that waits: it is printed once nothing before it waits for an end."""

    item: dict[str, Any]
    text: str
    closed: str
    ticket: str | None = None
    ended: str = ""


class Timeline:
    """Lines in the order of the log, each release with its end where that comes soon enough.

    Args:
        show: takes a record, as data and as a line.
    """

    def __init__(self, show: Callable[[dict[str, Any], str], None]) -> None:
        self._show = show
        self._waiting: deque[_PendingLine] = deque()
        self._begun: dict[str, tuple[int, str]] = {}

    def see(
        self,
        row: LogRow,
        record: Record,
        values: dict[str, Any],
        *,
        wanted: bool,
        closed: Closed = _NOTHING,
    ) -> None:
        """Take in the next record; one that is not wanted may still say how another ended.

        Args:
            row: as it was opened.
            record: its record.
            values: what lies beside it.
            wanted: it is shown.
            closed: what of it stays closed.
        """
        ticket = _ticket(record)
        began = self._begun.pop(ticket, None) if record.kind == "outcome" and ticket else None
        if record.kind == "outcome":
            self._end(ticket, record)
        elif ticket is not None:
            self._begun[ticket] = (row.seq, _what(record, values))
            while len(self._begun) > _OPEN:
                self._begun.pop(next(iter(self._begun)))
        if wanted:
            told = {"seq": row.seq, "verdict": verdict_of(record), **msgspec.to_builtins(record)}
            told["values"] = msgspec.to_builtins(values)
            told |= {"closed": closed.plain()} if closed else {}
            text = _line(row.seq, record, values, began)
            waits = ticket if record.kind != "outcome" else None
            self._waiting.append(
                _PendingLine(item=told, text=text, closed=closed.words(), ticket=waits)
            )
        self._flush(_WAITING)

    def close(self) -> None:
        """Print what still waits: how it ended, this part of the log does not say."""
        self._flush(0)

    def _end(self, ticket: str | None, record: Record) -> None:
        for line in self._waiting:
            if line.ticket is not None and line.ticket == ticket:
                line.ticket, line.ended = None, f" -> {record.link.decision}"

    def _flush(self, most: int) -> None:
        while self._waiting and (self._waiting[0].ticket is None or len(self._waiting) > most):
            line = self._waiting.popleft()
            self._show(line.item, f"{line.text}{line.ended} {line.closed}".rstrip())


def show_command(
    store: StoreArgument,
    kind: Annotated[
        str | None, typer.Option("--kind", help="Only records of this kind, such as `decision`.")
    ] = None,
    refused: Annotated[
        bool, typer.Option("--refused", help="Only refused, aborted or not started actions.")
    ] = False,
    would: Annotated[
        bool,
        typer.Option("--would-refuse", help="Only what an enforcing gate would have refused."),
    ] = False,
    mission: Annotated[
        str | None, typer.Option("--mission", help="Only records of this mission.")
    ] = None,
    client: Annotated[
        str | None, typer.Option("--client", help="Only records of this client or person.")
    ] = None,
    reason: Annotated[
        str | None, typer.Option("--code", help="Only records with this reason code.")
    ] = None,
    since: Annotated[
        str | None,
        typer.Option("--since", help="Only records from this instant on: 2026-01-31T14:30:00Z."),
    ] = None,
    until: Annotated[
        str | None, typer.Option("--until", help="Only records up to this instant.")
    ] = None,
    first: Annotated[int, typer.Option("--first", help="Number of the first record.", min=0)] = 0,
    last: Annotated[
        int | None, typer.Option("--last", help="Number of the last record.", min=0)
    ] = None,
    reader: ReaderOption = None,
    passphrase_file: PassphraseFile = None,
    as_json: JsonFlag = False,
) -> int:
    """Print a log as a timeline: who, what, from where to where, why, and how it ended."""
    if reason is not None and reason not in _REASONS:
        raise typer.BadParameter(f"`{reason}` is no reason code", param_hint="--code")
    wanted = RecordFilter(
        kind=kind,
        refused=refused,
        would=would,
        mission=mission,
        client=client,
        reason=reason,
        since_ms=0 if since is None else wall_now(since).utc_ms,
        until_ms=None if until is None else wall_now(until).utc_ms + 999,  # all of that second
        first=first,
        last=last,
    )
    opening = unsealer_of(reader, passphrase_file)
    with listing("records", as_json=as_json) as out, reading(store, opening) as log:
        shown = _shown(log.rows, wanted, out, opening)
        out.end({}, [] if shown else ["no records"])
    return 0


def _shown(rows: Iterator[LogRow], wanted: RecordFilter, out: Listing, opening: LogUnsealer) -> int:
    """Print each record that is wanted; return how many."""
    count = 0

    def show(item: dict[str, Any], line: str) -> None:
        nonlocal count
        count += 1
        out.add(item, line)

    timeline = Timeline(show)
    for row in rows:
        if wanted.last is not None and row.seq > wanted.last:
            break
        record = read_record(row.record, where=f"record {row.seq}")
        sealed = read_sealed(row.sealed, where=f"record {row.seq}")
        values = {name: item.value for name, item in sealed.items()}
        try:
            closed = opening.closed(record, values)
            has = wanted.has(record, values)
            timeline.see(row, record, values, wanted=has, closed=closed)
        except (AttributeError, TypeError, ValueError) as error:
            text = f"expected the fields of such a record: {error}"
            raise MalformedError(text, where=f"record {row.seq}") from error
    timeline.close()
    return count


def _line(seq: int, record: Record, values: dict[str, Any], began: tuple[int, str] | None) -> str:
    """Return a record for people; `began` is what an outcome is the end of."""
    at = to_timestamp(record.link.time_ms)
    reasons = (*(record.open.get("reasons") or ()), *hazards_of(record))
    what = _what(record, values) if began is None else f"{began[1]} (record {began[0]})".strip()
    what = ", ".join(part for part in (what, *repaired_by(record)) if part)
    told = ": ".join(part for part in (what, ", ".join(map(str, reasons))) if part)
    head = f"{seq:5} {at} {record.kind:11}{verdict_of(record):17} {record.link.mid:16} "
    return f"{head}{who_of(record, values):20} {told}"


def _what(record: Record, values: dict[str, Any]) -> str:
    """Return what a record is about, in few words."""
    several = values.get("action")  # an emergency's
    action = several[0] if isinstance(several, list) and several else act_of(values)
    if isinstance(action, dict):
        return _moved(action)
    opened = record.open
    if record.kind == SEALING:
        told = (map(str, opened.get(name) or ()) for name in ("classes", "roles"))
        return " for ".join(map(", ".join, told))
    if record.kind == "management":
        return _order(opened, values)
    if record.kind == "genesis":
        return f"robot {opened.get('robot')}"
    if record.kind == "outcome":
        return f"release {str(opened.get('ticket'))[:_SHORT]}..."
    return str(opened.get("what") or opened.get("capability") or "")


def _moved(action: dict[str, Any]) -> str:
    """Return an action: what, which thing, from where to where, by which regions, how."""
    source, destination = action.get("source"), action.get("destination")
    if destination in {None, source}:
        where = "" if source is None else f"at {source}"
    else:
        where = f"{source} -> {destination}" if source is not None else f"-> {destination}"
    how = [f"by={','.join(map(str, action['route']))}"] if action.get("route") else []
    how += [f"{name}={value}" for name, value in (action.get("params") or {}).items()]
    parts = (action.get("type"), action.get("object"), where, *how)
    return " ".join(str(part) for part in parts if part)


def _order(said: dict[str, Any], values: dict[str, Any]) -> str:
    """Return what an order says: the version, what it takes the place of, the row that it picks."""
    parts = [str(said["grant"])] if "grant" in said else []
    parts += [f"{name} {said[name]}" for name in ("row", "version") if name in said]
    if "verdict" in said:
        parts.append(f"{said['verdict']} request {said.get('counter')}")
    parts += [f"without effect: {said['why_not']}"] if "why_not" in said else []
    parts += ["closes it"] if said.get("closes") else []
    old = said.get("supersedes", "-")
    parts += [f"supersedes {str(old)[:_SHORT]}..."] if old != "-" else []
    parts += ["no confirmation"] if values.get("confirmation") == "none" else []
    return ", ".join(parts)


def _ticket(record: Record) -> str | None:
    """Return the release that a record begins or ends."""
    ticket = record.open.get("ticket")
    return ticket if isinstance(ticket, str) and ticket != NONE else None


def _is_named(wanted: str, who: str) -> bool:
    return wanted in {who, who.partition(".")[2]}
