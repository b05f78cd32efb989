# SPDX-License-Identifier: Apache-2.0
"""Whatever may have moved the robot raises the fence: state from before it counts for nothing.

Spec page: docs/spec/state.md#fences
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from authguard_r.core.standing import Outcome
from authguard_r.enforcement.signed_orders import Verb
from authguard_r.sim.robot import Faults
from authguard_r.wire.messages import ClientRole, OrderKind
from unit.server.demo_site import GO, SCAN, DemoGate, Guest
from unit.server.test_dispatcher import order
from unit.server.test_emergencies import EmergencyGate, worlds_mission
from unit.server.test_lease_registry import walking


@contextmanager
def deaf(house: DemoGate) -> Iterator[None]:
    """Let the estimator go on speaking and hear of no fence meanwhile."""
    house.advance(100)  # what was raised before has been heard
    assert house.robot.newest_fence == house.gate.ledger.fence
    hears = house.robot.fence
    house.robot.fence = lambda _: None  # type: ignore[method-assign]
    try:
        yield
    finally:
        house.robot.fence = hears  # type: ignore[method-assign]
        house.advance(100)


def decided(house: DemoGate, planner: Guest, plan: bytes = SCAN) -> list[str]:
    """Return why a plan is refused; nothing of one that is refused is released."""
    (step,) = house.propose(planner, plan)["steps"]
    assert step["released"] == (not step["reasons"])
    return list(step["reasons"])


def test_state_from_before_an_activation_counts_for_nothing() -> None:
    with DemoGate() as house:
        planner = house.enter(ClientRole.PLANNER)
        with deaf(house):
            house.activate()
            assert decided(house, planner) == ["STATE_BEFORE_MOTION"]
        assert decided(house, planner) == []


def test_state_from_before_a_resume_counts_for_nothing() -> None:
    """The estimator has measured since the stop: before the resume a person drove the robot."""
    with DemoGate() as house:
        planner = house.enter(ClientRole.PLANNER)
        house.activate()
        house.stop(ClientRole.OPERATOR, 1)
        with deaf(house):
            assert order(house, OrderKind.COMMAND, house.order(Verb.RESUME))["standing"]
            assert decided(house, planner) == ["STATE_BEFORE_MOTION"]
        assert decided(house, planner) == []


def test_state_from_before_a_resolve_counts_for_nothing() -> None:
    """Nobody knew what the robot did until a person says how its action ended."""
    with DemoGate(faults=Faults(answers_late_ms=60_000), stand_within_ms=1_000) as house:
        planner, number = walking(house)
        (step,) = house.rest(planner, number)["steps"]
        assert step["execution"]["outcome"] == "unknown"
        (release,) = house.standing.open
        settled = {"ticket": release.ticket, "outcome": Outcome.ABORTED}
        with deaf(house):
            before = decided(house, planner, GO)
            order(house, OrderKind.COMMAND, house.order(Verb.RESOLVE, **settled))
            after = decided(house, planner, GO)
        assert "STATE_BEFORE_MOTION" not in before
        assert "STATE_BEFORE_MOTION" in after
        assert "STATE_BEFORE_MOTION" not in decided(house, planner, GO)


@pytest.mark.parametrize("place", ["station-103", "dock"])
def test_state_from_before_the_end_of_an_emergency_action_counts_for_nothing(place: str) -> None:
    with EmergencyGate(mission=worlds_mission(), at=place) as house:
        planner = house.enter(ClientRole.PLANNER)
        house.activate()
        with deaf(house):
            person = house.enter(ClientRole.OPERATOR, "nurse")
            saved = house.call(person, "go-safe")
            assert saved["execution"]["outcome"] == "succeeded"
            assert decided(house, planner) == ["STATE_BEFORE_MOTION"]
        assert "STATE_BEFORE_MOTION" not in decided(house, planner)
