# SPDX-License-Identifier: Apache-2.0
"""A gate's status for people: what needs an answer, then the robot, the mission, and the rest."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from authguard_r.anchoring.evidence import Discrepancy
from authguard_r.core.quantities import to_timestamp

#: How much of a digest a line shows; `--json` has all of it.
_SHORT = 12
#: Whose silence counts.
_HEARD = ("planner", "estimator", "controller")
#: What nothing goes on for, and what to do about each.
_WAY_OUT = ("STORE ROLLED BACK", "find out why, then: authguard recover")
_OLDER = (
    "put the newest store in place; if no newer store exists, find out why, then: authguard recover"
)
WAYS_OUT: Mapping[str, tuple[str, str]] = {
    Discrepancy.BEHIND: ("STORE ROLLED BACK", _OLDER),
    Discrepancy.FORKED: ("STORE ROLLED BACK", _OLDER),
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
        "look at --counter, restore the file; if it is lost: authguard recover",
    ),
    Discrepancy.COUNTER_BEHIND: (
        "COUNTER ROLLED BACK",
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


def status_lines(status: dict[str, Any], requests: Iterable[str] = ()) -> list[str]:
    """Return a gate's status for people; what it does not say is not shown.

    Args:
        status: as the gate answers.
        requests: the open approval requests, a line each.
    """
    shadow = "; SHADOW: nothing is released" if status.get("mode") == "shadow" else ""
    head = f"{status.get('robot')}: {status.get('mode')}, up {_age(status.get('uptime_ms'))}"
    mission, issued = status.get("mission"), status.get("issued") or []
    lines = [head + shadow]
    lines += _stop_lines(status.get("stop_stands"), mission)
    lines += requests
    lines += _anchor_lines(status.get("anchor"))
    lines += [f"DAMAGED: {text}" for text in status.get("damaged") or []]
    lines += _emergency_lines(status.get("emergency"))
    lines += [_alert(one) for one in status.get("alerts") or [] if isinstance(one, dict)]
    lines += _refusal_lines(status.get("last_refusal"))
    lines += _robot_lines(status)
    lines += [_lease_line(one) for one in status.get("leases") or [] if isinstance(one, dict)]
    lines += _mission_lines(mission)
    lines += [
        f"issued: {m.get('mid')} version {m.get('version')}, by {m.get('issuer')}, "
        f"from {m.get('not_before')} until {m.get('expiry')}"
        for m in issued
        if isinstance(m, dict)
    ]
    heard = status.get("heard") or {}
    said = (f"{role} {_ago(heard.get(f'{role}_ms'))}" for role in _HEARD)
    lines.append(f"last message: {', '.join(said)}")
    lines += [
        f"client: {c.get('role')} {c.get('client')} (user {c.get('uid')}), "
        f"idle {_age(c.get('idle_ms'))}"
        for c in status.get("clients") or []
    ]
    refused, log = status.get("refusals"), status.get("log") or {}
    lines += [f"refused: {_flat(refused)}"] if refused else []
    lines += _disk_lines(status.get("disk"))
    lines += _stop_process_lines(status.get("lane"))
    lines += _witness_lines(status.get("anchor"))
    lines.append(f"stops: {status.get('stops')}; log: {log.get('size')} records")
    return lines


def has_requests(status: dict[str, Any]) -> bool:
    """True when the active mission has open approval requests."""
    mission = status.get("mission")
    return isinstance(mission, dict) and bool(mission.get("requests"))


def _refusal_lines(refusal: Any) -> list[str]:
    """Return the last refused proposal with its reason, and how to learn more."""
    if not isinstance(refusal, dict):
        return []
    action = refusal.get("action")
    named = action if isinstance(action, dict) else {}
    fields = [str(named[key]) for key in ("type", "object", "destination") if named.get(key)]
    what = " ".join(fields) or "a plan that cannot be read"
    told = refusal.get("findings") or []
    words = [
        f"{f.get('reason')} at {f.get('field')}: expected {f.get('expected')}, got {f.get('got')}"
        for f in told
        if isinstance(f, dict)
    ]
    words = words or [", ".join(map(str, refusal.get("reasons") or ["the safety gate refused it"]))]
    seq = refusal.get("record")
    more = f"authguard explain {'--refusal' if seq is None else seq}"
    head = f"last refusal, {_ago(refusal.get('ago_ms'))}: {what} ({more})"
    return [head, *(f"  {line}" for line in words)]


def _robot_lines(status: dict[str, Any]) -> list[str]:
    """Return where the robot is and what it holds."""
    place, held = status.get("place"), status.get("holding")
    if not isinstance(place, list):
        return []
    where = " or ".join(map(str, place)) or "an unknown place"
    holds = "" if held is None else f", holds {held}"
    return [f"robot: at {where}{holds} (measured {_ago(status.get('state_age_ms'))})"]


def _lease_line(lease: dict[str, Any]) -> str:
    """Return what moves now."""
    so_far, left = _age(lease.get("for_ms")), _age(lease.get("left_ms"))
    ticket = str(lease.get("ticket"))[:_SHORT]
    return f"moving: {lease.get('action')}, for {so_far}, at most {left} more (lease {ticket}...)"


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


def _stop_lines(stands: Any, mission: Any) -> list[str]:
    """Return that an operator's stop is in force, and what ends it, for people."""
    first = "" if isinstance(mission, dict) else "activate a mission, then: "
    what = f"STOPPED BY AN OPERATOR; {first}authguard resume TOKEN ends the stop"
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
    return [f"disk: {free >> 20} MiB free, {kept >> 20} MiB reserved"]


def _stop_process_lines(lane: Any) -> list[str]:
    """Return whether a stop would be heard by the stop process, for people."""
    if not isinstance(lane, dict):
        return []
    alive = lane.get("alive") is True
    return ["stop process: answers" if alive else "STOP PROCESS: DOES NOT ANSWER"]


def _anchor_lines(anchor: Any) -> list[str]:
    """Return what does not fit the store, and the way out, for people."""
    if not isinstance(anchor, dict):
        return []
    if anchor.get("state") != "put_back":
        return []
    head, way = WAYS_OUT.get(str(anchor.get("why")), _WAY_OUT)
    return [f"{head}: {anchor.get('message')}", f"  {way}"]


def _witness_lines(anchor: Any) -> list[str]:
    """Return how far the log is witnessed, and who cosigns."""
    told = anchor.get("witness") if isinstance(anchor, dict) else None
    if not isinstance(told, dict) or anchor.get("state") == "put_back":
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
    head = "alert, over by now" if alert.get("over") is True else "ALERT"
    return f"{head}: {alert.get('what')}{f' ({details})' if details else ''}"


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
