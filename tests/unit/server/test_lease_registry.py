# SPDX-License-Identifier: Apache-2.0
"""An open lease is renewed while it holds, and settled once when it has ended."""

from __future__ import annotations

import pytest

from authguard_r.client.controller import MessageSource
from authguard_r.core.identifiers import Digest
from authguard_r.core.standing import Outcome
from authguard_r.enforcement.signed_orders import Verb
from authguard_r.server.lease_registry import LeaseRegistry
from authguard_r.sim.robot import Faults
from authguard_r.wire.messages import ClientRole, Dispatch, Ended, Kind, Mode, Order, OrderKind
from fixtures import scenarios
from unit.server.demo_site import GO, SCAN, DemoGate, Guest, reasons, ticket_of
from unit.sim.controller_bench import framed


def walking(house: DemoGate) -> tuple[Guest, int]:
    """Return a planner and its request, half a second into a walk."""
    planner = house.enter(ClientRole.PLANNER)
    house.activate()
    number = house.begin(planner, GO)
    house.advance(500)
    return planner, number


def renewals(house: DemoGate) -> int:
    """Return how many renewals the controller gets in the next half second."""
    assert house.controller is not None
    count = 0
    for _ in range(10):
        house.clock.ms += 50
        house.attest()
        house.do(house.service._look)
        house.controller.pull()
        count += sum(item.kind is Kind.RENEW for item in house.controller.got)
        house.pump()
    return count


def test_a_lease_is_renewed_only_while_it_holds() -> None:
    with DemoGate(faults=Faults(ignores_stops=True)) as house:
        planner, number = walking(house)
        assert renewals(house) >= 10
        house.stop(ClientRole.OPERATOR, 1)
        assert renewals(house) == 0
        house.rest(planner, number)
        assert len(house.service.leases) == 0


@pytest.mark.parametrize(
    ("faults", "reason"),
    [
        (Faults(drift_to="office-2"), "OUTSIDE_REGIONS"),
        (Faults(localization_stops_ms=8_000), "STATE_STALE"),
        (Faults(estimator_dies_ms=8_000), "STATE_STALE"),
        (Faults(overspeed_permille=1_500), "BOUND_EXCEEDED"),
    ],
)
def test_what_breaks_its_lease_is_stopped_and_the_log_says_when_it_stood(
    faults: Faults, reason: str
) -> None:
    with DemoGate(faults=faults) as house:
        planner = house.enter(ClientRole.PLANNER)
        house.activate()
        (step,) = house.rest(planner, house.begin(planner, GO))["steps"]
        assert step["execution"]["outcome"] == "aborted"
        assert reason in reasons(step)
        (record,) = house.log("outcome")
        assert 0 <= record.open["stood_ms"] <= 200
        assert house.robot.state.speed_mm_s == 0
        assert house.standing.open == ()


def test_a_robot_that_does_not_say_that_it_stands_suspends_its_mission() -> None:
    with DemoGate(faults=Faults(answers_late_ms=60_000), stand_within_ms=1_000) as house:
        planner, number = walking(house)
        (step,) = house.rest(planner, number)["steps"]
        assert step["execution"]["outcome"] == "unknown"
        assert house.standing.status == "suspended"
        (release,) = house.standing.open
        operator = house.enter(ClientRole.OPERATOR)
        token = house.order(Verb.RESOLVE, ticket=release.ticket, outcome=Outcome.ABORTED)
        answer = operator.ask(Kind.ORDER, Order(act=OrderKind.COMMAND, token=token))
        assert answer["standing"].get("open", []) == []


def test_a_controller_that_is_busy_after_the_commit_gives_all_back_that_the_release_took() -> None:
    """The start of its grant and the mission's actions alike: nothing of it was begun."""
    with DemoGate() as house:
        planner = house.enter(ClientRole.PLANNER)
        house.activate()
        before = house.standing
        assert house.session is not None
        other = Dispatch(
            ticket=Digest("o" * 43),
            action=scenarios.navigate("dock", "pharmacy"),
            max_ms=60_000,
            renew_within_ms=60_000,
            life=house.session.life,
            stops=house.session.stops,
        )
        house.session.handle(MessageSource.GATE, framed(Kind.DISPATCH, other), house.clock.ms)
        (step,) = house.rest(planner, house.begin(planner, GO))["steps"]
        assert (step["released"], step["execution"]["outcome"]) == (True, "not_started")
        assert reasons(step) == ["BUSY"]
        after = house.standing
        assert (after.actions, after.open) == (0, ())
        assert (before.actions, before.open) == (0, ())
        assert after.uses["go-to-pharmacy"].starts == 0
        assert after.spent == before.spent
        assert [record.link.decision for record in house.log("outcome")] == ["not_started"]


def test_an_outcome_is_told_once_however_often_it_is_said() -> None:
    with DemoGate() as house:
        planner, number = walking(house)
        ended = Ended(ticket=ticket_of(house), outcome=Outcome.FAILED)
        assert house.controller is not None
        house.controller.say(Kind.ENDED, ended)
        house.controller.say(Kind.ENDED, ended)
        assert planner.answer(number) is not None
        assert [r.link.decision for r in house.log("outcome")] == ["failed"]


def test_what_is_open_can_be_listed_until_it_has_ended() -> None:
    with DemoGate() as house:
        planner, number = walking(house)
        (lease,) = house.service.leases.leases()
        assert (lease.ticket, lease.action) == (ticket_of(house), "navigate")
        assert (lease.since_ms, lease.until_ms) == (0, 180_000)
        house.rest(planner, number)
        assert house.service.leases.leases() == ()


def test_nobody_has_to_be_told_where_there_is_no_controller() -> None:
    with DemoGate(mode=Mode.SHADOW) as house:
        planner = house.enter(ClientRole.PLANNER)
        house.activate()
        number = house.begin(planner, SCAN)
        assert len(house.service.leases) == 1
        assert house.rest(planner, number)["steps"][0]["execution"]["outcome"] == "succeeded"
        empty = LeaseRegistry(None, None)
        empty.look()
        assert len(empty) == 0
