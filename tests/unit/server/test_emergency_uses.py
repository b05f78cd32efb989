# SPDX-License-Identifier: Apache-2.0
"""Who may use an emergency capability how often: each caller by itself, and nothing for nothing.

Spec page: docs/spec/emergency.md#uses
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from authguard_r.core.action import Action
from authguard_r.core.errors import ControllerError
from authguard_r.core.lease import Lease
from authguard_r.enforcement.emergency.policy import MOST_PER_HOUR, Caller
from authguard_r.enforcement.emergency_audit import EmergencyStanding, _after
from authguard_r.enforcement.emergency_enforcer import EmergencyReport
from authguard_r.store.memory import MemoryStore
from authguard_r.wire.messages import ClientRole
from fixtures import emergency_policies
from fixtures.emergency_files import record
from unit.server.demo_site import HandClock
from unit.server.test_emergencies import Disk, EmergencyGate, _Kept, always, planner

HOUR_MS = 3_600_000
NEAR = emergency_policies.guard("human_distance_mm", "le", 1_500)


def refuses(house: EmergencyGate) -> None:
    """Let the controller's end take nothing: whatever is released does not begin."""

    def refuse(_action: Action, _lease: Lease) -> None:
        raise ControllerError("it does not begin")

    assert house.remote is not None
    house.admit = refuse


def takes(house: EmergencyGate) -> None:
    """Let the controller's end take everything again."""
    assert house.remote is not None
    house.admit = lambda _action, _lease: None


def set_distance(house: EmergencyGate, distance_mm: int) -> None:
    house.robot.state = replace(house.robot.state, human_distance_mm=distance_mm)


def counts(house: EmergencyGate, caller: Caller, capability: str = "go-safe") -> tuple[int, int]:
    """Return how many uses and given back tries are known."""
    log = house.road.log
    return (len(log.uses(caller, capability)), len(log.tries(caller, capability)))


def test_what_was_not_started_is_no_use_and_the_next_start_knows(tmp_path: Path) -> None:
    store, clock = _Kept(MemoryStore()), HandClock()
    road: dict[str, Any] = {"store": store, "clock": clock, "journal": tmp_path / "journal"}
    with EmergencyGate(at="station-103", **road) as house:
        refuses(house)
        assert house.call(planner(house), "go-safe")["execution"]["outcome"] == "not_started"
        assert counts(house, Caller.PLANNER) == (0, 1)
        house.crashes = True
    with EmergencyGate(at="station-103", **road) as house:
        assert counts(house, Caller.PLANNER) == (0, 1)


def test_what_was_not_started_while_the_store_was_gone_is_no_use_either(tmp_path: Path) -> None:
    disk, clock = Disk(), HandClock()
    disk.close = lambda: None  # type: ignore[method-assign] - it outlives its gate
    road: dict[str, Any] = {"store": disk, "clock": clock, "journal": tmp_path / "journal"}
    with EmergencyGate(at="station-103", **road) as house:
        guest = planner(house)
        assert house.call(guest, "go-safe")["execution"]["outcome"] == "succeeded"
        refuses(house)
        disk.dead = True
        assert house.call(guest, "go-safe")["execution"]["outcome"] == "not_started"
        house.crashes = True
    disk.dead = False
    for _ in range(2):
        with EmergencyGate(at="station-103", **road) as house:
            assert counts(house, Caller.PLANNER) == (1, 1)
            assert [decision for decision, _ in house.told] == [
                *("accept", "succeeded", "accept", "not_started")
            ]
            house.crashes = True


@pytest.mark.parametrize("outcome", ["succeeded", "failed", "aborted", "unknown"])
def test_what_began_is_a_use_however_it_ended(outcome: str) -> None:
    begun = _after(EmergencyStanding(), record(1))
    assert _after(begun, record(2, decision=outcome, ticket=record(1).ticket)).uses == {
        "planner go-safe": (1,)
    }


def test_an_end_that_is_heard_of_twice_gives_one_use_back() -> None:
    """A gate that is killed while the journal comes into the log reads the rest of it again."""
    used = _after(
        _after(EmergencyStanding(), record(1)),
        record(2, decision="succeeded", ticket=record(1).ticket),
    )
    begun = _after(used, record(3))
    end = record(4, decision="not_started", ticket=record(3).ticket)
    once = _after(begun, end)
    assert once.uses == {"planner go-safe": (1,), "planner go-safe not_started": (3,)}
    assert _after(once, end).uses == once.uses


def test_uses_that_are_older_than_an_hour_are_forgotten() -> None:
    kept = EmergencyStanding(
        uses={"go-safe": (1,), "gate let-go": (1, 2), "planner go-safe not_started": (1,)}
    )
    after = _after(kept, record(1, mono_ms=HOUR_MS + 1, caller="operator"))
    assert after.uses == {"gate let-go": (2,), "operator go-safe": (HOUR_MS + 1,)}


def test_planners_that_use_up_theirs_leave_the_operators_and_the_gates() -> None:
    for_all = always(id="mine", per_hour=1, callers=["gate", "operator", "planner"])
    with EmergencyGate({**for_all, "callers": ["operator", "planner"]}, at="station-103") as house:
        one, two = planner(house, "one"), planner(house, "two")
        person = house.enter(ClientRole.OPERATOR, "nurse")
        assert house.call(one, "mine")["execution"]["outcome"] == "succeeded"
        assert house.call(two, "mine")["reasons"] == ["RATE_EXCEEDED"]
        assert house.call(person, "mine")["execution"]["outcome"] == "succeeded"
        assert house.call(person, "mine")["reasons"] == ["RATE_EXCEEDED"]
    with EmergencyGate({**for_all, "guards": [NEAR]}, at="station-103") as house:
        guest = planner(house)
        number = house.begin_call(guest, "mine")
        set_distance(house, 1_400)
        house.advance(20_000)
        assert house.rest(guest, number)["reasons"] == ["GUARD_FALSE"]
        assert house.call(guest, "mine")["execution"]["outcome"] == "succeeded"
        assert [r.open["caller"] for r in house.log("emergency")[1:]] == [
            *("gate", "gate", "planner", "planner")
        ]


@pytest.mark.complete
def test_a_caller_that_begins_in_vain_over_and_over_is_refused_in_the_end() -> None:
    """Each try writes what may use the reserve: a planner must not fill the disk with them."""
    with EmergencyGate(at="station-103") as house:
        refuses(house)
        guest, person = planner(house), house.enter(ClientRole.OPERATOR, "nurse")
        for _ in range(MOST_PER_HOUR):
            assert house.call(guest, "go-safe")["execution"]["outcome"] == "not_started"
        for _ in range(5):
            assert house.call(guest, "go-safe")["reasons"] == ["RATE_EXCEEDED"]
        assert len(house.told) == 2 * MOST_PER_HOUR
        takes(house)
        assert house.call(guest, "go-safe")["reasons"] == ["RATE_EXCEEDED"]
        assert house.call(person, "go-safe")["execution"]["outcome"] == "succeeded"
        house.clock.ms += HOUR_MS
        house.look()
        assert house.call(guest, "go-safe")["execution"]["outcome"] == "succeeded"


def test_the_gates_own_tries_of_one_episode_are_few_and_no_uses() -> None:
    with EmergencyGate(always(guards=[NEAR], per_hour=1), at="station-103") as house:
        refuses(house)
        set_distance(house, 1_400)
        house.advance(30_000)
        told = [decision for decision, _ in house.told]
        assert told == ["accept", "not_started"] * 5  # after 0, 1, 3, 7 and 15 seconds
        assert counts(house, Caller.GATE, "mine") == (0, 5)
        takes(house)
        house.advance(20_000)
        assert house.told[10:] == [("accept", "mine"), ("succeeded", "mine")]
        assert counts(house, Caller.GATE, "mine") == (1, 5)


def test_the_gates_next_episode_does_not_wait_for_what_the_last_one_tried() -> None:
    with EmergencyGate(always(guards=[NEAR], per_hour=1), at="station-103") as house:
        refuses(house)
        set_distance(house, 1_400)
        house.advance(20_000)
        before = len(house.told)
        set_distance(house, 5_000)
        house.advance(500)
        takes(house)
        set_distance(house, 1_400)
        house.advance(2_000)
        assert house.told[before:][0] == ("accept", "mine")


def test_a_begin_that_no_disk_took_is_no_use() -> None:
    disk = Disk()
    with EmergencyGate(store=disk, at="station-103") as house:
        call = house.road.judge("go-safe", Caller.PLANNER, "u1.x", stands=True)  # type: ignore[arg-type]
        disk.dead = True
        assert isinstance(house.road.begin(call), EmergencyReport)
        assert counts(house, Caller.PLANNER) == (0, 0)
        disk.dead = False
