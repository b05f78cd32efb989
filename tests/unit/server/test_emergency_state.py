# SPDX-License-Identifier: Apache-2.0
"""An emergency action begins on state from after the robot stands, as a mission's does.

Spec page: docs/spec/emergency.md#the-road
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import pytest

from authguard_r.core.safety import Hazard, SafetyDecision, SafetyFinding
from authguard_r.enforcement.emergency.policy import Caller
from authguard_r.enforcement.emergency_enforcer import EmergencyReport
from authguard_r.wire.messages import ClientRole
from fixtures import emergency_policies
from unit.server.demo_site import GO, SCAN, STEP_MS, Guest
from unit.server.test_emergencies import Disk, EmergencyGate, always, planner, worlds_mission
from unit.server.test_fences import deaf

NEAR = emergency_policies.guard("human_distance_mm", "le", 1_500)


def walking(house: EmergencyGate) -> Guest:
    """Let the mission's robot walk, faster than the emergency capability lets it."""
    guest = planner(house)
    house.activate()
    house.begin(guest, GO)
    house.advance(1_000)
    assert house.robot.state.speed_mm_s > 300
    return guest


def uses(
    house: EmergencyGate, caller: Caller = Caller.OPERATOR, capability: str = "go-safe"
) -> int:
    return len(house.road.log.uses(caller, capability))


def see(house: EmergencyGate, **changes: Any) -> None:
    house.robot.state = msgspec.structs.replace(house.robot.state, **changes)


def test_a_robot_that_was_too_fast_is_helped_once_newer_state_shows_that_it_stands() -> None:
    with EmergencyGate(mission=worlds_mission(), speed_up=1) as house:
        walking(house)
        person = house.enter(ClientRole.OPERATOR, "nurse")
        with deaf(house):
            called = house.begin_call(person, "go-safe")
            house.advance(1_000)
            assert not house.service.leases  # it stands, and nobody has measured since
            assert (person.answer(called), house.told) == (None, [])
        answer = house.rest(person, called)
        assert answer["execution"]["outcome"] == "succeeded"
        assert house.told == [("accept", "go-safe"), ("succeeded", "go-safe")]
        assert uses(house) == 1


@pytest.mark.parametrize("wait_ms", [0, 700])
def test_a_call_is_refused_when_no_newer_state_comes_in_time(wait_ms: int) -> None:
    with EmergencyGate(mission=worlds_mission(), speed_up=1, state_wait_ms=wait_ms) as house:
        walking(house)
        guest = planner(house, "caller")
        with deaf(house):
            called = house.begin_call(guest, "go-safe")
            assert house.remote is not None
            while house.service.leases or not house.remote.at_rest:
                house.advance(STEP_MS)
            stood_ms = house.clock.ms
            answer = house.rest(guest, called)
            assert wait_ms <= house.clock.ms - stood_ms <= wait_ms + 2 * STEP_MS
        assert (answer["outcome"], set(answer["reasons"])) == ("reject", {"STATE_BEFORE_MOTION"})
        assert (house.told, uses(house, Caller.PLANNER)) == ([], 0)
        assert house.alerts == []  # a robot's estimator was slow: that is nobody's lie


def test_a_call_right_after_a_motion_waits_and_is_no_false_emergency() -> None:
    with EmergencyGate(mission=worlds_mission(), at="station-103") as house:
        guest = planner(house)
        house.activate()
        house.propose(guest, SCAN)
        with deaf(house):
            house.gate.ledger.raise_fence()
            called = house.begin_call(guest, "go-safe")
            house.advance(500)
            assert guest.answer(called) is None
        assert house.rest(guest, called)["execution"]["outcome"] == "succeeded"
        assert house.alerts == []


def test_a_false_call_is_refused_at_once_whatever_the_fence_is() -> None:
    with EmergencyGate() as house, deaf(house):
        house.gate.ledger.raise_fence()
        assert house.call(planner(house), "call-help")["reasons"] == ["GUARD_FALSE"]
        assert [alert["what"] for alert in house.alerts] == ["false emergency"]


def test_what_newer_state_shows_to_be_no_emergency_is_refused_without_a_record_of_its_begin() -> (
    None
):
    with EmergencyGate(
        {**emergency_policies.GO_SAFE, "guards": [NEAR]}, mission=worlds_mission()
    ) as house:
        see(house, human_distance_mm=1_400)
        house.advance(STEP_MS)
        guest = planner(house)
        with deaf(house):
            house.gate.ledger.raise_fence()
            called = house.begin_call(guest, "go-safe")
            see(house, human_distance_mm=5_000)
        assert house.rest(guest, called)["reasons"] == ["GUARD_FALSE"]
        assert (house.told, uses(house, Caller.PLANNER)) == ([], 0)


def test_the_last_look_before_the_robot_is_sent_counts_newer_state_alone() -> None:
    with EmergencyGate(at="station-103") as house:
        call = house.road.judge("go-safe", Caller.PLANNER, "u1.x", stands=True)  # type: ignore[arg-type]
        house.gate.ledger.raise_fence()
        ended = house.road.begin(call)
        assert isinstance(ended, EmergencyReport)
        assert ended.outcome == "not_started"
        assert {finding.reason for finding in ended.reasons} == {"STATE_BEFORE_MOTION"}
        assert uses(house, Caller.PLANNER) == 0


def test_an_end_that_comes_into_the_log_now_makes_the_next_call_wait_and_not_fail(
    tmp_path: Path,
) -> None:
    """The record of an end raises the fence; of what the journal had, that is now."""
    disk = Disk()
    with EmergencyGate(at="station-103", journal=tmp_path / "journal", store=disk) as house:
        guest = planner(house)
        disk.dead = True
        assert house.call(guest, "go-safe")["execution"]["outcome"] == "succeeded"
        disk.dead = False
        assert house.call(guest, "go-safe")["execution"]["outcome"] == "succeeded"
        assert [decision for decision, _ in house.told] == ["accept", "succeeded"] * 2


def test_a_second_gate_that_lacks_newer_state_makes_a_call_wait_and_no_other_hazard_does() -> None:
    with EmergencyGate(at="station-103") as house:
        house.gate.ledger.raise_fence()
        call = house.road.judge("go-safe", Caller.PLANNER, "u1.x")  # type: ignore[arg-type]
        older = msgspec.structs.replace(call.scene, state=house.gate.enforcer.inputs.state)
        for hazards, scene, is_early in [
            ((Hazard.STATE_UNKNOWN,), older, True),
            ((Hazard.STATE_UNKNOWN,), call.scene, False),  # newer state would say the same
            ((Hazard.STATE_UNKNOWN, Hazard.HUMAN_PROXIMITY), older, False),
            ((), older, False),
        ]:
            found = tuple(SafetyFinding(hazard, "x", "y", "z") for hazard in hazards)
            safety = SafetyDecision(safe=not found, findings=found)
            asked = msgspec.structs.replace(call, scene=scene, safety=safety)
            assert (asked.is_early, asked.released) == (is_early, not found)


def test_while_the_emergency_action_runs_only_the_age_of_state_counts() -> None:
    with EmergencyGate(at="station-103", speed_up=1) as house:
        guest = planner(house)
        number = house.begin_call(guest, "go-safe")
        house.advance(1_000)
        with deaf(house):
            house.gate.ledger.raise_fence()
            house.advance(1_000)
            assert guest.answer(number) is None
        assert house.rest(guest, number)["execution"]["outcome"] == "succeeded"


def test_a_stop_refuses_a_call_that_waits_for_state() -> None:
    with EmergencyGate(at="station-103") as house:
        guest = planner(house)
        with deaf(house):
            house.gate.ledger.raise_fence()
            called = house.begin_call(guest, "go-safe")
            house.stop(ClientRole.OPERATOR, 1)
        assert house.rest(guest, called)["reasons"] == ["STOPPED"]
        assert house.told == []


def test_a_controller_that_goes_away_meanwhile_refuses_a_call_that_waits_for_state() -> None:
    with EmergencyGate(at="station-103") as house:
        guest = planner(house)
        with deaf(house):
            house.gate.ledger.raise_fence()
            called = house.begin_call(guest, "go-safe")
            assert house.controller is not None
            house.controller.leave()
            house.controller = house.session = None
        assert house.rest(guest, called)["reasons"] == ["CONTROLLER_FAILED"]
        assert house.told == []


# what the gate calls by itself


def test_the_gate_stops_no_mission_for_guards_that_hold_on_older_state_alone() -> None:
    mine = always(guards=[NEAR], callers=["gate"])
    with EmergencyGate(mine, mission=worlds_mission(), speed_up=1) as house:
        walking(house)
        with deaf(house):
            see(house, human_distance_mm=1_400)
            house.gate.ledger.raise_fence()
            house.advance(2 * house.config.state_wait_ms)
            assert len(house.service.leases) == 1
            assert (house.told, house.log("refusal")) == ([], [])
        house.advance(30_000)
        assert house.told == [("accept", "mine"), ("succeeded", "mine")]
        assert uses(house, Caller.GATE, "mine") == 1


def test_the_gate_does_not_call_again_because_its_own_motion_made_state_older() -> None:
    with EmergencyGate(always(), at="station-103") as house:
        house.advance(20_000)
        assert house.told == [("accept", "mine"), ("succeeded", "mine")]
        for _ in range(3):
            with deaf(house):
                house.gate.ledger.raise_fence()
                house.advance(500)
        house.advance(5_000)
        assert len(house.told) == 2
