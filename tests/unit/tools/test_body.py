# SPDX-License-Identifier: Apache-2.0
"""A body behind calls of tools: the first word on a flight counts, and a stop of nothing is none.

Source: docs/spec/adapters.md#driving
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import pytest
from msgspec.structs import replace

from authguard_r.client.controller import ExecutionNews
from authguard_r.client.link import ProcessLog
from authguard_r.core.action import Action
from authguard_r.core.errors import ControllerError
from authguard_r.core.identifiers import ActionType, Digest, ToolId
from authguard_r.core.standing import Outcome
from authguard_r.integrations.tools import body as body_module
from authguard_r.integrations.tools.body import ToolBody, ToolDrivers, ToolGoal
from authguard_r.integrations.tools.server import CallError, ToolAnswer
from authguard_r.normalize import Binder
from authguard_r.normalize.dialects import Call
from authguard_r.normalize.rebuild import Rebuilder
from fixtures import scenarios


class Silent:
    """A server that is there, and to which nothing can be said."""

    ready = True

    async def call(
        self, tool: str, arguments: dict[str, Any], within_s: float, *, ticket: str | None = None
    ) -> ToolAnswer:
        raise CallError("nobody listens", sent=False)


class Robot:
    """A server that answers each call with the next of its words; the last stays."""

    ready = True
    is_ticket_checked = True

    def __init__(self, **words: list[ToolAnswer | CallError | None]) -> None:
        self.words = words
        self.calls: list[str] = []

    async def call(
        self, tool: str, arguments: dict[str, Any], within_s: float, *, ticket: str | None = None
    ) -> ToolAnswer:
        if self.is_ticket_checked:
            assert ticket == (TICKET if tool == "navigate_to" else None)
        self.calls.append(tool)
        left = self.words[tool]
        word = left.pop(0) if len(left) > 1 else left[0]
        if word is None:  # it drives, and says nothing
            await asyncio.sleep(3_600)
        if isinstance(word, CallError):
            raise word
        assert word is not None
        return word


DONE, ERROR = ToolAnswer(is_error=False), ToolAnswer(is_error=True)
LOST = CallError("nobody answers", sent=True)
GO, TICKET = scenarios.navigate("dock", "pharmacy"), scenarios.TICKET


def body_of(
    robot: Robot,
    *stops: str,
    demand: dict[str, Any] | None = None,
    moves: dict[str, Any] | None = None,
) -> ToolBody:
    """Return a body with these stop calls; of them, and of moves, the binding demands something."""
    binding = scenarios.binding()
    say = replace(binding.tools["say"], succeeds=demand or {})
    go = replace(binding.tools["navigate_to"], **(moves or {}))
    binding = replace(binding, tools={**binding.tools, "say": say, "navigate_to": go})
    means = ToolDrivers(
        site=scenarios.site(),
        binder=Binder(scenarios.site(), binding),
        rebuilder=Rebuilder(scenarios.site(), binding),
        stops=tuple(Call(stop, {"text": "halt"}, "stop") for stop in stops),
    )
    return ToolBody(scenarios.RID, robot, means, lambda: None, ProcessLog())


async def until(holds: Callable[[], object]) -> None:
    async with asyncio.timeout(30):
        while not holds():
            await asyncio.sleep(0.005)


@pytest.fixture(autouse=True)
def soon(monkeypatch: pytest.MonkeyPatch) -> None:
    """A second try comes soon."""
    monkeypatch.setattr(body_module, "AGAIN_S", 0.01)


def test_a_move_that_did_not_arrive_is_stopped_before_anybody_is_told() -> None:
    async def talk() -> None:
        robot = Robot(navigate_to=[ERROR], say=[DONE])
        body = body_of(robot, "say")
        handle = body.begin(GO, TICKET)
        await until(lambda: handle.outcome() is not None)
        assert (handle.outcome(), body.stands) == (Outcome.FAILED, True)
        assert robot.calls == ["navigate_to", "say"]
        body.begin(GO, TICKET)  # and goes on

    asyncio.run(talk())


def test_without_stop_calls_a_move_that_did_not_arrive_leaves_a_doubt() -> None:
    async def talk() -> None:
        body = body_of(Robot(navigate_to=[ERROR, DONE]))
        handle = body.begin(GO, TICKET)
        await until(lambda: handle.outcome() is not None)
        assert not body.stands
        body.brake()
        await asyncio.sleep(0.05)
        assert not body.stands
        handle = body.begin(GO, TICKET)
        await until(lambda: handle.outcome() is not None)
        assert body.stands  # it arrived

    asyncio.run(talk())


def test_a_server_that_is_lost_in_motion_is_told_to_stop_until_it_says_so() -> None:
    async def talk() -> None:
        robot = Robot(navigate_to=[LOST], say=[LOST, ERROR, DONE])
        body = body_of(robot, "say")
        handle = body.begin(GO, TICKET)
        await until(lambda: handle.outcome() is not None)
        assert handle.outcome() is Outcome.UNKNOWN
        with pytest.raises(ControllerError, match="being stopped"):
            body.begin(GO, TICKET)
        body.brake()  # it is at it already
        await until(lambda: body.stands)
        assert robot.calls == ["navigate_to", "say", "say", "say"]

    asyncio.run(talk())


def test_a_stop_that_failed_once_is_tried_again() -> None:
    async def talk() -> None:
        robot = Robot(navigate_to=[None], say=[LOST, LOST, DONE])
        body = body_of(robot, "say")
        handle = body.begin(GO, TICKET)
        await until(lambda: robot.calls)
        body.brake()
        await until(lambda: handle.outcome() is not None)
        assert (handle.outcome(), body.stands) == (Outcome.UNKNOWN, False)
        await until(lambda: body.stands)
        assert robot.calls == ["navigate_to", "say", "say", "say"]

    asyncio.run(talk())


def test_what_the_binding_demands_of_a_stop_call_has_to_stand_in_its_answer() -> None:
    async def talk() -> None:
        no, yes = (ToolAnswer(is_error=False, structured={"ok": ok}) for ok in (False, True))
        robot = Robot(navigate_to=[None], say=[no, yes])
        body = body_of(robot, "say", demand={"ok": True})
        body.begin(GO, TICKET)
        await until(lambda: robot.calls)
        body.brake()
        await until(lambda: body.stands)
        assert robot.calls == ["navigate_to", "say", "say"]

    asyncio.run(talk())


def test_a_stop_call_that_the_binding_does_not_know_has_to_be_no_error() -> None:
    async def talk() -> None:
        robot = Robot(halt=[ERROR, DONE])
        body = body_of(robot, "halt")
        assert not body.stands  # nobody knows what a start before has left
        body.brake()
        await until(lambda: body.stands)
        assert robot.calls == ["halt", "halt"]

    asyncio.run(talk())


def test_who_lets_go_in_mid_motion_stops_first_and_does_not_wait_for_ever(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(body_module, "STOP_S", 0.1)

    async def talk() -> None:
        for said, stands in ((DONE, True), (None, False)):
            robot = Robot(navigate_to=[None], say=[said])
            body = body_of(robot, "say")
            body.begin(GO, TICKET)
            await until(lambda robot=robot: robot.calls)  # type: ignore[misc]
            await body.let_go()
            assert robot.calls[:2] == ["navigate_to", "say"]
            assert body.stands is stands
        idle = Robot()
        body = body_of(idle, "say")
        await body.let_go()
        with pytest.raises(ControllerError):  # who waited for a turn
            body.begin(GO, TICKET)
        assert idle.calls == []

    asyncio.run(talk())


def test_the_first_word_on_how_it_ended_counts() -> None:
    kind = scenarios.site().vocabulary[scenarios.navigate("dock", "pharmacy").type]
    handle = ToolGoal(kind)
    handle.end(Outcome.FAILED, ExecutionNews(b"x", ("x",)))
    handle.end(Outcome.SUCCEEDED)
    assert (handle.outcome(), handle.told()) == (Outcome.FAILED, ExecutionNews(b"x", ("x",)))


def test_a_call_that_was_never_made_leaves_a_robot_that_stands() -> None:
    async def talk() -> None:
        ended = asyncio.Event()
        means = ToolDrivers(
            site=scenarios.site(),
            binder=Binder(scenarios.site(), scenarios.binding()),
            rebuilder=Rebuilder(scenarios.site(), scenarios.binding()),
        )
        body = ToolBody(scenarios.RID, Silent(), means, ended.set, ProcessLog())
        handle = body.begin(GO, TICKET)
        assert not body.stands
        await ended.wait()
        assert handle.outcome() is Outcome.NOT_STARTED
        assert body.stands
        body.brake()  # nothing runs, and nothing is stopped
        assert handle.outcome() is Outcome.NOT_STARTED

    asyncio.run(talk())


class Broken(Silent):
    """A server whose answer cannot be carried."""

    async def call(self, *_: Any, **__: Any) -> ToolAnswer:
        raise ZeroDivisionError("a pattern of the server's own")


def test_a_fault_while_an_answer_is_carried_ends_its_call_and_is_said(capsys: Any) -> None:
    async def talk() -> None:
        ended = asyncio.Event()
        means = ToolDrivers(
            site=scenarios.site(),
            binder=Binder(scenarios.site(), scenarios.binding()),
            rebuilder=Rebuilder(scenarios.site(), scenarios.binding()),
        )
        body = ToolBody(scenarios.RID, Broken(), means, ended.set, ProcessLog())
        handle = body.begin(GO, TICKET)
        async with asyncio.timeout(10):
            await ended.wait()
        assert handle.outcome() is Outcome.UNKNOWN
        assert not body.stands  # it may have been carried out

    asyncio.run(talk())
    said = capsys.readouterr().err
    assert "ZeroDivisionError" in said
    assert "pattern" not in said


# -- beside ----------------------------------------------------------------------------------------

SCAN = Action(type=ActionType("scan_obstacles"), tool=ToolId("lidar"))


def beside_body(robot: Robot, *stops: str, moves: bool = False) -> ToolBody:
    """Return a body on a site whose scans may run beside other actions."""
    kind = scenarios.site().vocabulary[SCAN.type]
    words = {**scenarios.site().vocabulary, SCAN.type: replace(kind, beside=True, moves=moves)}
    site = replace(scenarios.site(), vocabulary=words)
    means = ToolDrivers(
        site=site,
        binder=Binder(site, scenarios.binding()),
        rebuilder=Rebuilder(site, scenarios.binding()),
        stops=tuple(Call(stop, {"text": "halt"}, "stop") for stop in stops),
    )
    return ToolBody(scenarios.RID, robot, means, lambda: None, ProcessLog())


def ticket(number: int) -> Digest:
    return Digest(str(number) * 43)


def test_what_may_run_beside_does_and_its_end_is_its_own() -> None:
    async def work() -> None:
        robot = Robot(navigate_to=[None], scan=[DONE], say=[DONE])
        robot.is_ticket_checked = False
        body = beside_body(robot, "say")
        drive = body.begin(GO, TICKET)
        assert (body.has_room(SCAN), body.has_room(GO)) == (True, False)
        scan = body.begin(SCAN, ticket(1))
        await until(lambda: scan.outcome() is not None)
        assert (scan.outcome(), drive.outcome()) == (Outcome.SUCCEEDED, None)
        made = [body.call_of(one) for one in (TICKET, ticket(1), ticket(2), None)]
        assert [one and one.tool for one in made] == ["navigate_to", "scan", None, None]
        body.brake()
        await until(lambda: drive.outcome() is not None)
        assert body.stands

    asyncio.run(work())


def test_a_stop_ends_what_runs_beside_and_no_more_than_a_few_run_at_once() -> None:
    async def work() -> None:
        robot = Robot(navigate_to=[None], scan=[None], say=[DONE])
        robot.is_ticket_checked = False
        body = beside_body(robot, "say")
        scans = [body.begin(SCAN, ticket(number)) for number in range(body_module.MOST_BESIDE)]
        assert (body.has_room(SCAN), body.has_room(GO)) == (False, True)
        drive = body.begin(GO, TICKET)
        await until(lambda: len(robot.calls) > len(scans))
        body.brake()
        assert {scan.outcome() for scan in scans} == {Outcome.ABORTED}
        await until(lambda: drive.outcome() is not None)
        assert (body.stands, robot.calls.count("say")) == (True, 1)
        await until(lambda: body.has_room(SCAN))
        last = body.begin(SCAN, ticket(9))
        await body.let_go()
        assert last.outcome() is Outcome.UNKNOWN

    asyncio.run(work())


def test_what_moves_the_robot_never_runs_beside() -> None:
    body = beside_body(Robot(navigate_to=[None], scan=[None]), moves=True)

    async def work() -> None:
        body.begin(GO, TICKET)
        assert not body.has_room(SCAN)
        await body.let_go()

    asyncio.run(work())
