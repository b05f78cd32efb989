# SPDX-License-Identifier: Apache-2.0
"""One stop comes by two ways, and again until somebody confirms it: the log has it once."""

from __future__ import annotations

from typing import Any

import pytest

from authguard_r.enforcement.signed_orders import Verb
from authguard_r.wire.gate_limits import LIMITS
from authguard_r.wire.messages import ClientRole, Kind, Order, OrderKind, Stop
from unit.server.demo_site import DemoGate

OPERATOR, AUDITOR, PLANNER = ClientRole.OPERATOR, ClientRole.AUDITOR, ClientRole.PLANNER


def told(house: DemoGate) -> list[int | str]:
    """Return what the log says: after how long each stop was confirmed, -1: never, or its end."""
    found: list[int | str] = []
    for record in house.log("stop"):
        stood = record.open["stood_ms"]
        found.append(f"confirms {stood}" if record.open.get("confirms") else stood)
    return found


@pytest.mark.parametrize(
    ("stood", "expected"),
    [
        ([None, None, None], [-1]),
        ([None, 40], [-1, "confirms 40"]),
        ([None, None, 40, 50], [-1, "confirms 40", 50]),
        ([40, 50], [40, 50]),
        ([40, None], [40, -1]),
    ],
)
def test_a_stop_that_is_asked_for_again_is_the_same_until_it_is_confirmed(
    stood: list[int | None], expected: list[int | str]
) -> None:
    with DemoGate() as house:
        for n, one in enumerate(stood, 1):
            house.stop(AUDITOR, n, stood_ms=one, key="one")
        assert told(house) == expected


@pytest.mark.parametrize("other", [{"key": "two"}, {"key": ""}, {"uid": 6}, {"role": PLANNER}])
def test_another_name_user_or_role_is_another_stop(other: dict[str, Any]) -> None:
    with DemoGate() as house:
        house.stop(AUDITOR, 1, stood_ms=None, key="one")
        given = {"role": AUDITOR, "key": "one"} | other
        house.stop(given.pop("role"), 2, stood_ms=None, **given)
        assert told(house) == [-1, -1]


def test_a_name_is_the_same_stop_for_a_while_after_it_was_last_asked_for() -> None:
    with DemoGate() as house:
        house.stop(AUDITOR, 1, stood_ms=None, key="one")
        for n in (2, 3):
            house.advance(LIMITS.same_stop_ms - 500)
            house.stop(AUDITOR, n, stood_ms=None, key="one")
        assert told(house) == [-1]
        house.advance(LIMITS.same_stop_ms + 500)
        house.stop(AUDITOR, 4, stood_ms=None, key="one")
        assert told(house) == [-1, -1]


def test_a_planners_stop_that_is_confirmed_at_last_ends_the_alert_and_has_no_second_record() -> (
    None
):
    with DemoGate() as house:
        house.stop(PLANNER, 1, stood_ms=None, key="one")
        house.stop(PLANNER, 2, stood_ms=40, key="one")
        assert told(house) == [-1]
        house.stop(PLANNER, 3, stood_ms=None, key="two")
        assert len(house.log("alert")) == 2  # it was over: it is raised again


def test_an_operators_stop_that_is_asked_for_still_suspends_what_was_resumed() -> None:
    with DemoGate() as house:
        house.activate()
        house.stop(OPERATOR, 1, stood_ms=None, key="one")
        assert house.standing.status == "suspended"
        resume = Order(act=OrderKind.COMMAND, token=house.order(Verb.RESUME))
        house.enter(OPERATOR).ask(Kind.ORDER, resume)
        assert house.standing.status == "active"
        house.stop(OPERATOR, 2, stood_ms=None, key="one")
        assert house.standing.status == "suspended"
        assert told(house) == [-1]


def test_a_gate_that_is_asked_again_before_it_has_written_writes_what_was_said_last() -> None:
    """No controller is connected at first; what follows within a second is one record."""
    with DemoGate(robot=False) as house:
        hand = house.enter(AUDITOR)
        for _ in range(2):
            number = hand.say(Kind.STOP, Stop(why="a child", key="one"))
            said = house.until(lambda n=number: hand.answer(n))
            assert said["controller"] is False
            house.advance(LIMITS.stop_answer_ms // 4)
        house.advance(2 * LIMITS.stop_answer_ms)
        (record,) = house.log("stop")
        assert (record.open["stood_ms"], record.open["more"]) == (-1, 0)


def test_a_late_word_of_a_try_before_the_confirmation_is_no_other_stop() -> None:
    with DemoGate() as house:
        told_by_gate(house, None)
        house.stop(AUDITOR, 1, stood_ms=40, key="one")
        for _ in range(2):
            told_by_gate(house, None)
        assert told(house) == [-1, "confirms 40"]
        assert len(house.log("alert")) == 1
        told_by_gate(house, 50)
        assert told(house) == [-1, "confirms 40", 50]


def told_by_gate(house: DemoGate, stood_ms: int | None) -> None:
    """Let the gate tell of a stop that it carried out itself."""
    client = house.client(house.enter(AUDITOR, "auditor"))
    client.uid = 5  # the lane's auditor
    stop = Stop(why="", key="one")
    house.do(lambda: house.service.stops.taken(client, stop, stood_ms, 0))


def test_an_operators_stop_that_joins_another_suspends_what_was_resumed_meanwhile() -> None:
    with DemoGate(robot=False) as house:
        house.connect_robot()
        house.session = None  # it hangs
        house.activate()
        hand = house.enter(OPERATOR)
        hand.say(Kind.STOP, Stop(why="first", key="one"))
        house.pump()
        assert house.standing.status == "suspended"
        resume = Order(act=OrderKind.COMMAND, token=house.order(Verb.RESUME))
        house.enter(OPERATOR, "other").ask(Kind.ORDER, resume)
        assert house.standing.status == "active"
        hand.say(Kind.STOP, Stop(why="second", key="two"))
        house.pump()
        assert house.standing.status == "suspended"


def test_a_stop_that_is_confirmed_before_its_record_says_after_how_long_since_the_first_try() -> (
    None
):
    with DemoGate(robot=False) as house:
        hand = house.enter(AUDITOR)
        hand.say(Kind.STOP, Stop(why="", key="one"))
        house.advance(LIMITS.stop_answer_ms // 2)
        house.connect_robot()
        hand.say(Kind.STOP, Stop(why="", key="one"))
        house.advance(2 * LIMITS.stop_answer_ms)
        (record,) = house.log("stop")
        assert LIMITS.stop_answer_ms // 2 <= record.open["stood_ms"] < LIMITS.stop_answer_ms
