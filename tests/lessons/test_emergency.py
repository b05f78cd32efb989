# SPDX-License-Identifier: Apache-2.0
"""What went wrong on the emergency path of this project; one test for each kind of fault."""

from __future__ import annotations

from pathlib import Path

from authguard_r.core.errors import ControllerError
from authguard_r.enforcement.emergency.policy import Caller
from authguard_r.server.emergencies import STRANGE
from authguard_r.wire.messages import ClientRole
from fixtures import emergency_policies, scenarios
from fixtures.emergency_files import forge, record
from unit.server.demo_site import GO
from unit.server.test_emergencies import EmergencyGate, planner, worlds_mission
from unit.server.test_fences import deaf

TWICE = {**emergency_policies.GO_SAFE, "per_hour": 2}


def test_the_speed_from_before_the_stop_refused_the_help_that_the_stop_was_for() -> None:
    with EmergencyGate(TWICE, mission=worlds_mission(), speed_up=1) as house:
        house.activate()
        house.begin(planner(house), GO)
        house.advance(1_000)
        assert house.robot.state.speed_mm_s > emergency_policies.GO_SAFE["params"]["speed_mm_s"]
        person = house.enter(ClientRole.OPERATOR, "nurse")
        with deaf(house):  # the newest speed that anybody has measured is from before the stop
            called = house.begin_call(person, "go-safe")
            house.advance(700)
        assert house.rest(person, called)["execution"]["outcome"] == "succeeded"
        assert len(house.road.log.uses(Caller.OPERATOR, "go-safe")) == 1


def test_tries_that_did_not_start_used_up_what_was_left_for_a_person() -> None:
    def refuse(*_: object) -> None:
        raise ControllerError("it does not begin")

    with EmergencyGate(TWICE, at="station-103") as house:
        assert house.remote is not None
        house.admit = refuse
        guest, person = planner(house), house.enter(ClientRole.OPERATOR, "nurse")
        for _ in range(3):
            assert house.call(guest, "go-safe")["execution"]["outcome"] == "not_started"
        house.admit = lambda *_: None
        for caller in (guest, person):
            for _ in range(2):
                assert house.call(caller, "go-safe")["execution"]["outcome"] == "succeeded"
            assert house.call(caller, "go-safe")["reasons"] == ["RATE_EXCEEDED"]


def test_entries_of_a_journal_without_a_key_entered_the_log_as_an_operators_emergencies(
    tmp_path: Path,
) -> None:
    path = tmp_path / "journal"
    with EmergencyGate(journal=path):
        pass
    forge(path, *(record(n, caller="operator", by="u1000.nurse") for n in range(1, 5)))
    with EmergencyGate(journal=path) as house:
        assert (house.told, house.alerts) == ([], [{"what": STRANGE, "entries": 4}])


def test_one_entry_of_another_robot_kept_the_gate_from_starting(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    with EmergencyGate(journal=path):
        pass
    forge(path, record(1, robot=scenarios.OTHER))
    with EmergencyGate(journal=path) as house:
        assert house.call(planner(house), "go-safe")["execution"]["outcome"] == "succeeded"
