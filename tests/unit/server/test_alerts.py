# SPDX-License-Identifier: Apache-2.0
"""Each alert is absent without its cause, and `STATUS` says `over` once the cause has ended.

Here is a whole gate. The alerts of its parts are in `test_liveness.py`, `test_log_maintenance.py`,
`test_retention.py`, `tests/unit/test_rotation.py` and `tests/unit/test_witnesses.py`.
"""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path

import msgspec
import pytest

from authguard_r.anchoring import anchor, rotation
from authguard_r.core.mission import Mission
from authguard_r.core.standing import Outcome
from authguard_r.enforcement.signed_orders import Verb
from authguard_r.server import retention
from authguard_r.sim.robot import Faults
from authguard_r.wire.gate_limits import LIMITS
from authguard_r.wire.messages import ClientRole, Kind, Mode, Order, OrderKind
from fixtures import scenarios
from unit.server.demo_site import FORBIDDEN, GO, SCAN, DemoGate, Guest
from unit.server.test_emergencies import EmergencyGate, worlds_mission

ROOT = Path(__file__).resolve().parents[3]


def shown(house: DemoGate, what: str | None = None) -> list[bool]:
    """Return of each such alert in `STATUS` whether it is over."""
    person = house.enter(ClientRole.AUDITOR)
    alerts = person.ask(Kind.STATUS)["alerts"]
    person.leave()
    return [told.get("over", False) for told in alerts if what in {None, told["what"]}]


def listen(house: DemoGate) -> None:
    """Let the gate do what it does once a second."""
    house.do(house.service._listen)


def command(house: DemoGate, verb: Verb) -> None:
    person = house.enter(ClientRole.OPERATOR)
    person.ask(Kind.ORDER, Order(act=OrderKind.COMMAND, token=house.order(verb)))
    person.leave()
    listen(house)


def other(mission: Mission) -> Mission:
    """Return the same mission under another id."""
    return msgspec.structs.replace(mission, mid="another-mission")


def planner(house: DemoGate) -> Guest:
    return house.enter(ClientRole.PLANNER)


def stops(house: DemoGate, count: int) -> None:
    """Let a planner stop the robot so many times more."""
    for _ in range(count):
        house.stop(ClientRole.PLANNER, house.service.queries.stops + 1)


def budget(house: DemoGate) -> int:
    return house.mission.budgets.planner_stops


def test_a_day_without_any_cause_raises_no_alert() -> None:
    with EmergencyGate(mission=worlds_mission()) as house:
        client = planner(house)
        listen(house)
        house.do(lambda: house.service.stops.stop_process_silent(is_silent=False))
        house.activate()
        for plan in (SCAN, GO, FORBIDDEN, SCAN):
            listen(house)
            house.propose(client, plan)
            house.do(house.service.log_maintenance.look)
            house.do(house.service.retention.look)
        stops(house, budget(house))
        command(house, Verb.SUSPEND)
        house.propose(client, SCAN)
        command(house, Verb.RESUME)
        house.propose(client, SCAN)
        command(house, Verb.COMPLETE)
        assert shown(house) == []
        assert house.log("alert") == []


ENDS = (Verb.SUSPEND, Verb.COMPLETE, Verb.REVOKE)


@pytest.mark.parametrize("verb", ENDS)
def test_no_progress_is_over_once_the_mission_is_suspended_or_ends(verb: Verb) -> None:
    with DemoGate(refusals=3) as house:
        client = planner(house)
        house.activate()
        for _ in range(2):
            house.propose(client, FORBIDDEN)
        assert shown(house) == []
        house.propose(client, FORBIDDEN)
        listen(house)
        assert shown(house, "no progress") == [False]
        command(house, verb)
        assert shown(house, "no progress") == [True]
        for _ in range(9):  # a planner cannot succeed now: that is no news
            house.propose(client, FORBIDDEN)
        assert shown(house) == [True]
        assert len(house.log("alert")) == 1


def test_a_row_begins_anew_after_a_resume() -> None:
    with DemoGate(refusals=3) as house:
        client = planner(house)
        house.activate()
        for _ in range(4):
            house.propose(client, FORBIDDEN)
        command(house, Verb.SUSPEND)
        command(house, Verb.RESUME)
        for _ in range(2):
            house.propose(client, FORBIDDEN)
        assert shown(house, "no progress") == [True]
        house.propose(client, FORBIDDEN)
        assert shown(house, "no progress") == [True, False]
        house.advance(
            LIMITS.explain_within_ms
        )  # why the gate has stopped the robot is known by then
        house.propose(client, SCAN)
        assert shown(house, "no progress") == [True, True]


@pytest.mark.parametrize("verb", ENDS)
def test_nobody_is_asked_any_more_once_the_mission_is_suspended_or_ends(verb: Verb) -> None:
    with DemoGate(refusals=0, mission=scenarios.mission(on_refusal="ask")) as house:
        client = planner(house)
        house.activate()
        house.propose(client, SCAN)
        listen(house)
        assert shown(house) == []
        house.propose(client, FORBIDDEN)
        listen(house)
        assert shown(house, "a person is asked") == [False]
        command(house, verb)
        assert shown(house, "a person is asked") == [True]
        house.propose(client, FORBIDDEN)
        assert shown(house) == [True]


def test_an_operators_own_stop_asks_nobody() -> None:
    with DemoGate(refusals=0, mission=scenarios.mission(on_refusal="ask")) as house:
        client = planner(house)
        house.activate()
        number = house.begin(client, GO)
        house.advance(500)
        house.stop(ClientRole.OPERATOR, 1)
        (step,) = house.rest(client, number)["steps"]
        assert step["execution"]["outcome"] == Outcome.ABORTED
        assert shown(house) == []


def test_another_mission_asks_anew_at_once() -> None:
    mission = scenarios.mission(on_refusal="ask")
    with DemoGate(refusals=0, mission=mission) as house:
        client = planner(house)
        house.activate()
        house.propose(client, FORBIDDEN)
        person = house.enter(ClientRole.OPERATOR)
        person.ask(Kind.ORDER, Order(act=OrderKind.COMMAND, token=house.order(Verb.COMPLETE)))
        house.activate(other(mission))
        house.propose(client, FORBIDDEN)  # before the gate has looked again
        listen(house)
        assert shown(house, "a person is asked") == [True, False]


def test_planner_stops_are_over_when_their_mission_ends() -> None:
    with DemoGate() as house:
        house.activate()
        stops(house, budget(house))
        assert shown(house) == []
        stops(house, 1)
        listen(house)
        assert shown(house, "planner stops") == [False]
        command(house, Verb.SUSPEND)
        command(house, Verb.RESUME)
        assert shown(house, "planner stops") == [False]  # the mission's count is what it was
        command(house, Verb.COMPLETE)
        assert shown(house, "planner stops") == [True]
        house.activate(other(house.mission))
        listen(house)
        stops(house, budget(house))
        assert shown(house, "planner stops") == [True]
        stops(house, 1)
        assert shown(house, "planner stops") == [True, False]


def test_planner_stops_in_shadow_are_over_too() -> None:
    with DemoGate(mode=Mode.SHADOW) as house:
        house.activate()
        stops(house, budget(house) + 1)
        assert shown(house, "planner stops") == [False]
        command(house, Verb.REVOKE)
        assert shown(house, "planner stops") == [True]


def test_a_false_emergency_is_over_when_the_mission_ends_or_the_next_is_activated() -> None:
    with EmergencyGate(mission=worlds_mission()) as house:
        client = planner(house)
        assert house.call(client, "go-safe")["outcome"] == "accept"
        assert shown(house, "false emergency") == []
        house.call(client, "call-help")
        listen(house)
        assert shown(house, "false emergency") == [False]
        house.activate()
        listen(house)
        assert shown(house, "false emergency") == [True]
        for _ in range(2):
            house.call(client, "call-help")
        listen(house)
        assert shown(house, "false emergency") == [True, False]  # the mission's first
        command(house, Verb.SUSPEND)
        assert shown(house, "false emergency") == [True, False]
        command(house, Verb.COMPLETE)
        assert shown(house, "false emergency") == [True, True]
        assert [alert["calls"] for alert in house.alerts] == [1, 1]


@pytest.mark.parametrize("faults", [Faults(), Faults(controller_refuses=True)])
def test_an_emergency_is_over_when_its_end_is_recorded(faults: Faults) -> None:
    with EmergencyGate(at="station-103", speed_up=1, faults=faults) as house:
        client = planner(house)
        house.call(client, "fly")
        assert shown(house, "emergency") == []
        number = house.begin_call(client, "go-safe")
        if not faults.controller_refuses:
            house.advance(1_000)
            assert shown(house, "emergency") == [False]
        house.rest(client, number)
        assert house.told[-1] != ("accept", "go-safe")  # its end
        assert shown(house, "emergency") == [True]


def test_a_stop_that_nobody_confirmed_is_over_once_a_later_one_is_confirmed() -> None:
    with DemoGate() as house:
        house.stop(ClientRole.AUDITOR, 1)
        assert shown(house) == []
        house.stop(ClientRole.AUDITOR, 2, stood_ms=None)
        listen(house)
        assert shown(house, "a stop was not confirmed") == [False]
        house.stop(ClientRole.AUDITOR, 3)
        assert shown(house, "a stop was not confirmed") == [True]


def test_a_lane_is_silent_or_gone_and_neither_once_it_answers() -> None:
    silent, gone = "the stop process does not answer", "the stop process is gone"
    with DemoGate(robot=False) as house:
        lane = house.service.stops
        house.do(partial(lane.stop_process_silent, is_silent=False))
        assert shown(house) == []
        house.do(partial(lane.stop_process_silent, is_silent=True))
        assert (shown(house, silent), shown(house, gone)) == ([False], [])
        house.do(lambda: lane.stop_process_lost(None))
        assert (shown(house, silent), shown(house, gone)) == ([True], [False])
        house.do(partial(lane.stop_process_silent, is_silent=False))
        assert (shown(house, silent), shown(house, gone)) == ([True], [True])


#: Alerts whose names stand in a constant.
NAMED = {anchor.WHAT, anchor.SILENT, rotation.STUCK, retention.STUCK}


def test_the_specification_says_of_each_alert_when_it_ends() -> None:
    page = (ROOT / "docs" / "spec" / "gate-protocol.md").read_text().partition("## Alerts")[2]
    table = page.partition("\n#")[0]
    rows = dict(re.findall(r"^\| `([^`]+)` \|[^|]+\| *([^|]*?) *\|", table, re.MULTILINE))
    assert all(rows.values()), rows
    sources = "".join(path.read_text() for path in (ROOT / "src" / "authguard_r").rglob("*.py"))
    calls = r'(?:\.(?:alert|tell|holds)\(|"event": "alert", "what":)\s*"([^"]+)"'
    raised = set(re.findall(calls, sources)) | NAMED
    assert len(raised) > 10
    assert raised - set(rows) == set()
