# SPDX-License-Identifier: Apache-2.0
"""`authguard status`, `resume`, `explain`: a person at a gate that runs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from authguard_r.anchoring.evidence import Discrepancy
from authguard_r.cli.gateway import GateOption, ProofOption, ReadingRole, RoleOption, connected
from authguard_r.cli.inputs import JsonFlag, TrustOption
from authguard_r.cli.log_explain import DraftOption, explained, write_change
from authguard_r.cli.log_reading import strange
from authguard_r.cli.mission import TokenArgument
from authguard_r.cli.orders import TemplateOption, signed_order
from authguard_r.cli.signing_key import CertOption, OrderKeyOption, PassphraseFile
from authguard_r.core.quantities import to_timestamp
from authguard_r.enforcement.signed_orders import Verb
from authguard_r.store.sqlite import read_rows
from authguard_r.wire.output import emit

#: How much of a digest a line shows; `--json` has all of it.
_SHORT = 12
#: Whose silence counts.
_HEARD = ("planner", "estimator", "controller")
#: What nothing goes on for, and what to do about each.
_WAY_OUT = ("STORE PUT BACK", "find out why, then: authguard recover")
_OLDER = "put the newest store in place; if there is none, find out why, then: authguard recover"
WAYS_OUT: Mapping[str, tuple[str, str]] = {
    Discrepancy.BEHIND: ("STORE PUT BACK", _OLDER),
    Discrepancy.FORKED: ("STORE PUT BACK", _OLDER),
    Discrepancy.REPLACED: (
        "STORE REPLACED",
        "look at --store; if it is the right one: authguard recover",
    ),
    Discrepancy.CHECKPOINT_DIFFERS: (
        "LOG CHANGED",
        "find out who wrote into it; put a sound store in place, or: authguard recover",
    ),
    Discrepancy.COUNTER_MISSING: (
        "COUNTER GONE",
        "look at --counter, put the file back; if it is lost: authguard recover",
    ),
    Discrepancy.COUNTER_BEHIND: (
        "COUNTER PUT BACK",
        "put the newest one in place; if it is lost: authguard recover",
    ),
    Discrepancy.COUNTER_FOREIGN: (
        "COUNTER DAMAGED",
        "look at --counter; recovering writes over that file: authguard recover",
    ),
    Discrepancy.COUNTER_UNREADABLE: (
        "COUNTER NOT READ",
        "look at --counter and its mount, then start the gate again; nothing is to be signed",
    ),
    Discrepancy.COUNTER_NOT_NAMED: (
        "COUNTER NOT NAMED",
        "start the gate again with its --counter; nothing is to be signed",
    ),
}


def status_command(
    gate: GateOption = None,
    role: RoleOption = ReadingRole.OPERATOR,
    trust: ProofOption = None,
    as_json: JsonFlag = False,
) -> int:
    """Show a gate's robot, mission, open leases, clients, and who was last heard."""
    with connected(gate, role, trust) as client:
        status = client.status()
    emit(status, status_lines(status), as_json=as_json)
    return 0


def status_lines(status: dict[str, Any]) -> list[str]:
    """Return a gate's status for people; what it does not say is not shown."""
    shadow = "; SHADOW: nothing is released" if status.get("mode") == "shadow" else ""
    head = f"{status.get('robot')}: {status.get('mode')}, up {_age(status.get('uptime_ms'))}"
    lines = [head + shadow, *_mission_lines(status.get("mission"))]
    lines += [
        f"issued: {m.get('mid')} version {m.get('version')}, by {m.get('issuer')}, "
        f"from {m.get('not_before')} until {m.get('expiry')}"
        for m in status.get("issued") or []
        if isinstance(m, dict)
    ]
    lines += [f"DAMAGED: {text}" for text in status.get("damaged") or []]
    lines += _stand_lines(status.get("stop_stands")) + _emergency_lines(status.get("emergency"))
    for lease in status.get("leases") or []:
        ticket = str(lease.get("ticket"))[:_SHORT]
        so_far, left = _age(lease.get("for_ms")), _age(lease.get("left_ms"))
        moving = f"{lease.get('action')}, for {so_far}, at most {left} more"
        lines.append(f"  moving: {moving} (lease {ticket}...)")
    heard = status.get("heard") or {}
    said = (f"{role} {_ago(heard.get(f'{role}_ms'))}" for role in _HEARD)
    lines.append(f"heard: {', '.join(said)}")
    lines += [
        f"client: {c.get('role')} {c.get('client')} (user {c.get('uid')}), "
        f"idle {_age(c.get('idle_ms'))}"
        for c in status.get("clients") or []
    ]
    lines += [
        f"{'alert, over by now' if alert.get('over') is True else 'ALERT'}: {_alert(alert)}"
        for alert in status.get("alerts") or []
        if isinstance(alert, dict)
    ]
    refused, log = status.get("refusals"), status.get("log") or {}
    lines += [f"refused: {_flat(refused)}"] if refused else []
    lines += _disk_lines(status.get("disk"))
    lines += _stop_process_lines(status.get("lane"))
    lines += _anchor_lines(status.get("anchor"))
    lines.append(f"stops: {status.get('stops')}; log: {log.get('size')} records")
    return lines


def resume_command(
    token: TokenArgument,
    trust: TrustOption,
    gate: GateOption = None,
    key: OrderKeyOption = None,
    cert: CertOption = None,
    passphrase_file: PassphraseFile = None,
    template: TemplateOption = None,
    as_json: JsonFlag = False,
) -> int:
    """Let a stopped or suspended mission go on: a signed order to the gate that runs."""
    signed = signed_order(
        token, trust, template, key, cert, verb=Verb.RESUME, passphrase_file=passphrase_file
    )
    with connected(gate, ReadingRole.OPERATOR, trust) as client:
        standing = client.command(signed)
    payload = {"standing": standing, "status": standing.get("status")}
    line = f"{standing.get('mid')} version {standing.get('version')}: {standing.get('status')}"
    emit(payload, [line], as_json=as_json)
    return 0


def explain_command(
    seq: Annotated[
        int | None,
        typer.Argument(help="The record's number (default: the last refused proposal).", min=0),
    ] = None,
    gate: GateOption = None,
    role: RoleOption = ReadingRole.OPERATOR,
    trust: ProofOption = None,
    store: Annotated[
        Path | None, typer.Option("--store", help="Read a store that no gate holds.")
    ] = None,
    draft: DraftOption = None,
    as_json: JsonFlag = False,
) -> int:
    """Say in words why a record says what it says, what to do, and what would have allowed it."""
    if store is not None:
        if gate is not None:
            raise typer.BadParameter("not together with --gate", param_hint="--store")
        with strange():
            told = explained(read_rows(store), seq)
    else:
        with connected(gate, role, trust) as client:
            told = client.explain(seq)
    lines = [str(line) for line in told.get("text") or []]
    if draft is not None:
        lines.append(write_change(draft, told))
    emit(told, lines, as_json=as_json)
    return 0


def _mission_lines(mission: Any) -> list[str]:
    if not isinstance(mission, dict):
        return ["no active mission"]
    head = f"mission {mission.get('mid')} version {mission.get('version')}: {mission.get('status')}"
    lines = [f"{head}, by {mission.get('issuer')}, until {mission.get('expiry')}"]
    void = mission.get("void")
    lines += [f"  AUTHORIZES NOTHING: {void}"] if void is not None else []
    lines += [
        f"  {g.get('id')} ({g.get('type')}): {g.get('starts')} of {g.get('of')} starts"
        for g in mission.get("grants") or []
        if isinstance(g, dict)
    ]
    return lines + [f"  open release {ticket}" for ticket in mission.get("open") or []]


def _stand_lines(stands: Any) -> list[str]:
    """Return that an operator's stop stands, and what ends it, for people."""
    what = "AN OPERATOR'S STOP STANDS: until authguard resume"
    return [what] if stands is True else []


def _emergency_lines(emergency: Any) -> list[str]:
    """Return which emergency policy counts, and which outcomes are unknown, for people."""
    if not isinstance(emergency, dict):
        return []
    named = f"{emergency.get('policy')} version {emergency.get('version')}"
    going = emergency.get("under_way")
    lines = [f"emergency policy: {named}, until {emergency.get('expiry')}"]
    lines += [f"EMERGENCY UNDER WAY: {going}"] if going is not None else []
    unknown = _flat(emergency.get("unknown") or [])
    return lines + ([f"EMERGENCY ENDED UNKNOWN: {unknown}; go and look"] if unknown else [])


def _disk_lines(disk: Any) -> list[str]:
    """Return what the store's disk has left, for people."""
    if not isinstance(disk, dict):
        return []
    free, kept = disk.get("free_bytes"), disk.get("reserve_bytes")
    if not isinstance(free, int) or not isinstance(kept, int):
        return [f"disk: {_flat(disk)}"]
    return [f"disk: {free >> 20} MiB free, {kept >> 20} MiB kept back"]


def _stop_process_lines(lane: Any) -> list[str]:
    """Return whether a stop would be heard by the stop process, for people."""
    if not isinstance(lane, dict):
        return []
    alive = lane.get("alive") is True
    return ["stop lane: answers" if alive else "STOP LANE: DOES NOT ANSWER"]


def _anchor_lines(anchor: Any) -> list[str]:
    """Return what does not fit the store, and the way out, for people."""
    if not isinstance(anchor, dict):
        return []
    if anchor.get("state") != "put_back":
        return _witness_lines(anchor.get("witness"))
    head, way = WAYS_OUT.get(str(anchor.get("why")), _WAY_OUT)
    return [f"{head}: {anchor.get('message')}", f"  {way}"]


def _witness_lines(told: Any) -> list[str]:
    """Return how far the log is witnessed, and who cosigns."""
    if not isinstance(told, dict):
        return []
    names = (f"{one.get('name')} {one.get('state')}" for one in told.get("witnesses") or [])
    at_ms = told.get("witnessed_ms")
    last = f"last at {to_timestamp(at_ms)}" if isinstance(at_ms, int) and at_ms else "never yet"
    asked = f"{told.get('confirmed')} of {told.get('quorum')} since the start"
    return [
        f"witnesses: {asked} ({', '.join(names)})",
        f"  not witnessed: {told.get('unwitnessed')} records ({last})",
    ]


def _alert(alert: dict[str, Any]) -> str:
    details = _flat({n: value for n, value in alert.items() if n not in {"what", "over"}})
    return f"{alert.get('what')} ({details})" if details else str(alert.get("what"))


def _age(duration_ms: Any) -> str:
    """Return a duration for people."""
    if not isinstance(duration_ms, int):
        return "?"
    seconds = duration_ms / 1_000
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes, seconds = divmod(int(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {seconds} s"


def _ago(duration_ms: Any) -> str:
    return "never" if duration_ms is None else f"{_age(duration_ms)} ago"


def _flat(said: Any) -> str:
    """Return small data on one line."""
    if isinstance(said, dict):
        return ", ".join(f"{name} {_flat(value)}" for name, value in said.items())
    if isinstance(said, list):
        return ", ".join(_flat(item) for item in said)
    return str(said)
