# SPDX-License-Identifier: Apache-2.0
"""A step's report, as planners and displays of ROS see it.

The gate decides how much of a refusal a planner sees (`disclosure`): what it leaves out is left out
here. Spec page: docs/spec/ros.md#plans-as-text
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

#: The events of a gate that a display hears of, by the number that `Decision.msg` gives them.
KINDS = {"decision": 0, "outcome": 1, "stop": 2, "emergency": 3}
#: Most reason codes of one decision that are shown.
_MOST_CODES = 64
#: Longest text of a message's field, in characters.
_MOST = 200
_ACTION = ("type", "tool", "object", "source", "destination")
_MS = 1_000


def codes_of(step: Mapping[str, Any]) -> list[str]:
    """Return why a step was not released: the first gate's codes, or the second one's hazards."""
    codes = [str(code) for code in step.get("reasons", ())]
    return (codes or [str(one.get("hazard")) for one in _hazards(step)])[:_MOST_CODES]


def place_of(step: Mapping[str, Any]) -> str:
    """Return the field that the first reason is about; empty where the gate does not tell."""
    findings = step.get("findings") or _hazards(step)
    refusal = step.get("refusal") or {}
    place = findings[0].get("field") if findings else refusal.get("where")
    return _text(place)


def ended_by(step: Mapping[str, Any]) -> list[str]:
    """Return why a released step did not succeed."""
    reasons = (step.get("execution") or {}).get("reasons", ())
    codes = [one.get("reason") if isinstance(one, dict) else one for one in reasons]
    return [str(code) for code in dict.fromkeys(codes)][:_MOST_CODES]


def decided(step: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a planner sees of a step's decision."""
    action = step.get("action") or {}
    return {
        "decision": step["outcome"],
        "released": step["released"],
        "reasons": codes_of(step),
        "place": place_of(step),
        "type": _text(action.get("type")),
        "seq": step.get("seq"),
    }


def display_of(event: Mapping[str, Any], robot: str) -> dict[str, Any]:
    """Return an event of the gate's as the fields of a `Decision`.

    Args:
        event: of `WATCH`; one of `KINDS`.
        robot: whose gate it is.
    """
    action, mission = event.get("action") or {}, event.get("mission") or {}
    at_ms = event.get("time_ms") or 0
    begun = event["event"] == "emergency" and "outcome" not in event  # a second one says the end
    return {
        "kind": KINDS[event["event"]],
        "stamp": {"sec": at_ms // _MS, "nanosec": at_ms % _MS * 1_000_000},
        "robot": robot,
        "client": _text(event.get("client") or event.get("by")),
        "role": _text(event.get("role")),
        "seq": _number(event.get("seq")),
        "outcome": _text(event.get("outcome")),
        "released": begun or event.get("released") is True or event.get("ticket") is not None,
        "reasons": codes_of(event),
        "place": place_of(event),
        "required_approvals": _number(event.get("required_approvals")),
        "mission": _text(mission.get("mid")),
        "mission_version": _number(mission.get("version")),
        "grant": _text(event.get("grant")),
        **{name: _text(action.get(name)) for name in _ACTION},
        "capability": _text(event.get("capability")),
        "execution": _text((event.get("execution") or {}).get("outcome")),
        "execution_reasons": ended_by(event),
        "stood_ms": _number(event.get("stood_ms")),
    }


def stopped_by(event: Mapping[str, Any]) -> str:
    """Return what stopped the robot, as far as an event says that something did; else empty."""
    if event["event"] == "stop":
        return f"stop by {_text(event.get('by'))} ({_text(event.get('role'))})"
    ended = (event.get("execution") or {}).get("outcome")
    if event["event"] in KINDS and ended in {"aborted", "unknown"}:
        return ": ".join([ended, ", ".join(ended_by(event)) or "the robot's own report"])
    return ""


def _hazards(step: Mapping[str, Any]) -> list[dict[str, Any]]:
    safety = step.get("safety")
    return list(safety.get("findings", ())) if isinstance(safety, dict) else []


def _text(value: object) -> str:
    """Return a value as text that every message can hold."""
    said = "" if value is None else str(value)
    return said.encode("utf-8", "backslashreplace").decode().replace("\0", "")[:_MOST]


def _number(value: object) -> int:
    return value if isinstance(value, int) else -1
