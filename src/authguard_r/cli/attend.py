# SPDX-License-Identifier: Apache-2.0
"""`authguard status`, `stop`, `resume`, `explain`: a person at a gate that runs."""

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from authguard_r.audit.record import read_record, read_sealed
from authguard_r.audit.verify import Row
from authguard_r.cli.gateway import (
    STOP_SOCKET,
    GateOption,
    ProofOption,
    Reading,
    RoleOption,
    connect_as,
    connected,
    socket_in,
)
from authguard_r.cli.inputs import JsonFlag
from authguard_r.cli.mission import TokenArgument
from authguard_r.cli.orders import CertOption, KeyOption, TemplateOption, signed_order
from authguard_r.cli.out import emit
from authguard_r.cli.run import stop_command as stop_store
from authguard_r.cli.signing_key import PassphraseFile
from authguard_r.commands import Verb
from authguard_r.core.encoding import decode, unb64
from authguard_r.core.errors import AuthGuardError, EnvironmentFault, RefusedError
from authguard_r.core.mission import Mission
from authguard_r.core.reasons import Reason
from authguard_r.core.token import read_token
from authguard_r.gate.explain import explanation, is_refused_proposal, no_record
from authguard_r.store.sqlite import read_held, read_rows
from authguard_r.wire.messages import ClientRole

#: How much of a digest a line shows; `--json` has all of it.
_SHORT = 12
#: Whose silence counts.
_HEARD = ("planner", "estimator", "controller")


def status_command(
    gate: GateOption = None,
    role: RoleOption = Reading.OPERATOR,
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
    lines += _lane_lines(status.get("lane"))
    lines += _anchor_lines(status.get("anchor"))
    lines.append(f"stops: {status.get('stops')}; log: {log.get('size')} records")
    return lines


class Stopping(StrEnum):
    """What may stop at a lane, in the order in which a stop without `--role` tries them."""

    OPERATOR = "operator"
    AUDITOR = "auditor"
    PLANNER = "planner"
    ESTIMATOR = "estimator"


def stop_command(
    gate: GateOption = None,
    role: Annotated[
        Stopping | None,
        typer.Option("--role", help="What to be at the lane (default: the first that you may be)."),
    ] = None,
    why: Annotated[str, typer.Option("--why", help="For the log; decides nothing.")] = "",
    store: Annotated[
        Path | None, typer.Option("--store", help="Stop a store's mission; no gate is reached.")
    ] = None,
    trust: Annotated[Path | None, typer.Option("--trust", help="The trust folder.")] = None,
    site: Annotated[Path | None, typer.Option("--site", help="The site model.")] = None,
    robot: Annotated[str | None, typer.Option("--robot", help="Which gate, for --store.")] = None,
    as_json: JsonFlag = False,
) -> int:
    """Brake and hold, through the stop lane; with --store, only record it there.

    An operator's stop suspends the active mission until a signed `resume`; without --role it is
    the first of operator, auditor, planner and estimator that this user may be. Exit 5 says that
    nobody confirmed that the robot stands.
    """
    if store is not None:
        if gate is not None or trust is None or site is None:
            raise typer.BadParameter("takes --trust and --site, not --gate", param_hint="--store")
        return stop_store(trust, site, store, robot, as_json)
    roles = [ClientRole(name) for name in (Stopping if role is None else (role,))]
    with connect_as(socket_in(gate, STOP_SOCKET), roles) as client:
        said = {**client.stop(why), "role": str(client.welcome.role)}
    emit(said, _stop_lines(said), as_json=as_json)
    return 0 if said.get("stopped") is True else 5


def resume_command(
    token: TokenArgument,
    trust: Annotated[Path, typer.Option("--trust", help="The trust folder (`keys init`).")],
    gate: GateOption = None,
    key: KeyOption = None,
    cert: CertOption = None,
    passphrase_file: PassphraseFile = None,
    template: TemplateOption = None,
    as_json: JsonFlag = False,
) -> int:
    """Let a stopped or suspended mission go on: a signed order to the gate that runs."""
    signed = signed_order(
        token, trust, template, key, cert, verb=Verb.RESUME, passphrase_file=passphrase_file
    )
    with connected(gate, Reading.OPERATOR, trust) as client:
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
    role: RoleOption = Reading.OPERATOR,
    trust: ProofOption = None,
    store: Annotated[
        Path | None, typer.Option("--store", help="Read a store that no gate holds.")
    ] = None,
    draft: Annotated[
        Path | None,
        typer.Option("--draft", help="Write the smallest change here: a draft to go through."),
    ] = None,
    as_json: JsonFlag = False,
) -> int:
    """Say in words why a record says what it says, what to do, and what would have allowed it."""
    if store is not None:
        if gate is not None:
            raise typer.BadParameter("not together with --gate", param_hint="--store")
        told = explain_stored(store, seq)
    else:
        with connected(gate, role, trust) as client:
            told = client.explain(seq)
    lines = [str(line) for line in told.get("text") or []]
    if draft is not None:
        lines.append(_write_change(draft, told))
    emit(told, lines, as_json=as_json)
    return 0


def _write_change(path: Path, told: dict[str, Any]) -> str:
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
        raise EnvironmentFault(message, reason=Reason.STORE_UNAVAILABLE, where="--draft") from error
    return f"{path}: read it, then: authguard mission compile {path} --site SITE --supersedes TOKEN"


def explain_stored(store: Path, seq: int | None) -> dict[str, Any]:
    """Return the explanation of a record in a file.

    Args:
        store: nobody needs to trust it; nothing is verified here (`audit verify` does).
        seq: the record; None takes the last refused proposal.

    Raises:
        RefusedError: there is no such record.
        StoreError: the store cannot be read.
        MalformedError: the record is damaged.
    """
    found = next((row for row in _rows(store) if _is_meant(row, seq)), None)
    if found is None:
        raise no_record(seq)
    where = f"record {found.seq}"
    record = read_record(found.record, where=where)
    sealed = read_sealed(found.sealed, where=where)
    return explanation(
        found.seq, record, sealed, mission=_mission(store, record.open.get("mission"))
    )


def _rows(store: Path) -> list[Row]:
    return list(read_rows(store))[::-1]


def _is_meant(row: Row, seq: int | None) -> bool:
    """True for the record that was asked for; without a number, for a refused proposal."""
    if seq is not None:
        return row.seq == seq
    return is_refused_proposal(read_record(row.record, where=f"record {row.seq}"))


def _mission(store: Path, digest: Any) -> Mission | None:
    """Return the mission that a record names, when the store has it; only words are made of it."""
    data = read_held(store, "token", digest) if isinstance(digest, str) else None
    if data is None:
        return None
    try:
        payload = unb64(read_token(data).payload, where="token.payload")
        return decode(payload, Mission, where="mission")
    except AuthGuardError:
        return None  # damaged: the record is explained without a change


def _mission_lines(mission: Any) -> list[str]:
    if not isinstance(mission, dict):
        return ["no active mission"]
    head = f"mission {mission.get('mid')} version {mission.get('version')}: {mission.get('status')}"
    lines = [f"{head}, by {mission.get('issuer')}, until {mission.get('expiry')}"]
    lines += [
        f"  {g.get('id')} ({g.get('type')}): {g.get('starts')} of {g.get('of')} starts"
        for g in mission.get("grants") or []
        if isinstance(g, dict)
    ]
    return lines + [f"  open release {ticket}" for ticket in mission.get("open") or []]


def _disk_lines(disk: Any) -> list[str]:
    """Return what the store's disk has left, for people."""
    if not isinstance(disk, dict):
        return []
    free, kept = disk.get("free_bytes"), disk.get("reserve_bytes")
    if not isinstance(free, int) or not isinstance(kept, int):
        return [f"disk: {_flat(disk)}"]
    return [f"disk: {free >> 20} MiB free, {kept >> 20} MiB kept back"]


def _lane_lines(lane: Any) -> list[str]:
    """Return whether a stop would be heard by the lane, for people."""
    if not isinstance(lane, dict):
        return []
    alive = lane.get("alive") is True
    return ["stop lane: answers" if alive else "STOP LANE: DOES NOT ANSWER"]


def _anchor_lines(anchor: Any) -> list[str]:
    """Return that the store is not the one that was counted, for people."""
    if not isinstance(anchor, dict) or anchor.get("state") != "put_back":
        return []
    return [f"STORE PUT BACK: {anchor.get('message')}", "  find out why, then: authguard recover"]


def _stop_lines(said: dict[str, Any]) -> list[str]:
    if said.get("stopped") is True:
        line = f"stopped: the robot stands after {said.get('after_ms')} ms"
    elif said.get("controller") is True:
        line = "NOT CONFIRMED: the controller was told to stop and did not say that it stands"
    else:
        line = "NOT CONFIRMED: no controller is connected to the stop lane"
    return [f"{line}; {_follows(str(said.get('role')))}"]


def _follows(role: str) -> str:
    """Return what a stop in a role means for the mission."""
    if role != Stopping.OPERATOR:
        article = "an" if role[:1] in "aeiou" else "a"
        return f"recorded as {article} {role}'s stop"
    return (
        "a mission that was active is suspended until `authguard resume`; "
        "one that was closing is over"
    )


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
