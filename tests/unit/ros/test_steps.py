# SPDX-License-Identifier: Apache-2.0
"""What the gate says of a step, as planners and displays of ROS are told it.

Source: docs/spec/ros.md#plans-as-text, docs/spec/ros.md#decisions
"""

from __future__ import annotations

from typing import Any

import pytest

from authguard_r.integrations.ros.steps import (
    KINDS,
    codes_of,
    decided,
    display_of,
    ended_by,
    stopped_by,
)

REFUSED = {
    "outcome": "reject",
    "reasons": ["CAPABILITY_EXCEEDED", "EXPIRED"],
    "findings": [{"field": "type", "reason": "CAPABILITY_EXCEEDED"}],
    "released": False,
    "seq": None,
}


def test_a_refusal_is_told_with_its_codes_and_the_place_of_the_first() -> None:
    assert decided(REFUSED) == {
        "decision": "reject",
        "released": False,
        "reasons": ["CAPABILITY_EXCEEDED", "EXPIRED"],
        "place": "type",
        "type": "",
        "seq": None,
    }


def test_what_the_gate_does_not_disclose_is_not_told() -> None:
    told = decided({"outcome": "reject", "reasons": ["EXPIRED"], "released": False})
    assert (told["place"], told["type"]) == ("", "")


def test_a_plan_that_could_not_be_read_is_told_with_its_place() -> None:
    refusal = {"reason": "MALFORMED", "where": "input[3]", "message": "what its planner wrote"}
    told = decided({**REFUSED, "reasons": ["MALFORMED"], "findings": [], "refusal": refusal})
    assert (told["reasons"], told["place"]) == (["MALFORMED"], "input[3]")
    assert "what its planner wrote" not in str(told)


def test_what_the_second_gate_refused_is_told_by_its_hazards() -> None:
    findings = [{"hazard": "TOO_NEAR", "field": "params.speed_mm_s"}]
    step = {
        "outcome": "accept",
        "reasons": [],
        "findings": [],
        "released": False,
        "safety": {"safe": False, "findings": findings},
        "action": {"type": "navigate"},
    }
    told = decided(step)
    assert (told["reasons"], told["place"]) == (["TOO_NEAR"], "params.speed_mm_s")
    assert told["type"] == "navigate"
    assert codes_of({**step, "safety": "not evaluated"}) == []


@pytest.mark.parametrize("told", ["OUTSIDE_REGIONS", {"reason": "OUTSIDE_REGIONS", "field": "x"}])
def test_why_a_step_ended_is_told_once(told: Any) -> None:
    assert ended_by({"execution": {"outcome": "aborted", "reasons": [told, told]}}) == [
        "OUTSIDE_REGIONS"
    ]
    assert ended_by({"execution": None}) == []


def test_an_event_is_shown_without_a_word_of_anybodys_own() -> None:
    event = {
        **REFUSED,
        "event": "decision",
        "client": "u1001.\0arm\ud800" + "x" * 500,
        "time_ms": 1_500,
        "seq": 7,
        "mission": {"mid": "m", "version": 2, "digest": "d"},
        "action": {"type": "navigate", "destination": None, "params": {"speed_mm_s": 3}},
        "influenced_by": [{"value": "dock"}],
    }
    told = display_of(event, "courier-1")
    assert told["kind"] == KINDS["decision"]
    assert told["stamp"] == {"sec": 1, "nanosec": 500_000_000}
    assert told["client"].startswith("u1001.arm\\ud800x")
    assert len(told["client"]) == 200
    assert (told["seq"], told["required_approvals"], told["stood_ms"]) == (7, -1, -1)
    assert (told["mission"], told["mission_version"]) == ("m", 2)
    assert (told["type"], told["destination"], told["released"]) == ("navigate", "", False)
    assert "dock" not in str(told)


def test_an_emergency_is_released_when_it_has_begun_and_not_when_it_is_refused() -> None:
    begun = {"event": "emergency", "capability": "go-home", "by": "u1.op", "caller": "operator"}
    refused = {**begun, "outcome": "reject", "reasons": ["EXPIRED"], "ticket": None}
    assert display_of(begun, "r")["released"]
    assert display_of(begun, "r")["client"] == "u1.op"
    assert not display_of(refused, "r")["released"]
    assert display_of({**refused, "ticket": "t"}, "r")["released"]


def test_what_stopped_the_robot_is_named() -> None:
    stop = {"event": "stop", "by": "u1.op", "role": "operator", "stood_ms": 20}
    assert stopped_by(stop) == "stop by u1.op (operator)"
    aborted = {"outcome": "aborted", "reasons": [{"reason": "OUTSIDE_REGIONS"}]}
    assert stopped_by({"event": "outcome", "execution": aborted}) == "aborted: OUTSIDE_REGIONS"
    unknown = {"outcome": "unknown", "reasons": []}
    assert stopped_by({"event": "outcome", "execution": unknown}).startswith("unknown: ")
    assert stopped_by({"event": "outcome", "execution": {"outcome": "succeeded"}}) == ""
    assert stopped_by({"event": "decision", **REFUSED}) == ""
