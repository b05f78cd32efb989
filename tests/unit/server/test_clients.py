# SPDX-License-Identifier: Apache-2.0
"""Clients and their turns: who sends much waits for himself; what is too much is shed unread."""

from __future__ import annotations

import json
from typing import Any

from authguard_r.core.identifiers import Identifier
from authguard_r.server.fair_queue import FairQueue, ServedClient
from authguard_r.wire.frames import Frame, FrameReader
from authguard_r.wire.gate_limits import LIMITS
from authguard_r.wire.messages import ClientRole, Fault, Kind


class Tape:
    """A line that keeps what is sent along it (`gate.clients.Line`)."""

    def __init__(self) -> None:
        self._reader = FrameReader(lambda _: 1 << 20)
        self.sent: list[Frame] = []
        self.is_paused = False
        self.dropped = ""

    def write(self, data: bytes) -> None:
        self.sent += self._reader.feed(data)

    def pause(self) -> None:
        assert not self.is_paused
        self.is_paused = True

    def resume(self) -> None:
        assert self.is_paused
        self.is_paused = False

    def drop(self, why: str) -> None:
        self.dropped = why


def client(name: str = "one", role: ClientRole = ClientRole.PLANNER) -> tuple[ServedClient, Tape]:
    line = Tape()
    return ServedClient(line, role=role, name=Identifier(name), uid=1), line


def ask(number: int = 1, kind: Kind = Kind.OBSERVE) -> Frame:
    return Frame(kind, number, b"{}")


def ring(shed: list[Any] | None = None) -> FairQueue:
    return FairQueue((shed if shed is not None else []).append)


def served(turns: FairQueue) -> list[tuple[str, int]]:
    """Return everything that waits, in the order in which it is served."""
    found = []
    while turns:
        for who, item in turns.take():
            assert isinstance(item, Frame)
            found.append((who.name, item.id))
    return found


def test_clients_are_served_in_turn_however_much_one_sends() -> None:
    turns, (one, _), (two, _), (three, _) = ring(), client("a"), client("b"), client("c")
    for number in range(5):
        turns.came(one, ask(number))
    turns.came(two, ask(10))
    turns.came(three, ask(20))
    turns.came(two, ask(11))
    order = [("a", 0), ("b", 10), ("c", 20), ("a", 1), ("b", 11), ("a", 2), ("a", 3), ("a", 4)]
    assert served(turns) == order
    assert not turns
    assert turns.take() == ()


def test_what_keeps_the_robot_safe_goes_first_and_starves_nobody() -> None:
    turns, (slow, _) = ring(), client("planner")
    robot, _ = client("robot", ClientRole.CONTROLLER)
    sensors, _ = client("sensors", ClientRole.ESTIMATOR)
    assert robot.urgent
    assert sensors.urgent
    assert not slow.urgent
    for number in range(3):
        turns.came(slow, ask(number))
        turns.came(robot, ask(10 + number, Kind.STOOD))
    turns.came(sensors, ask(20, Kind.SNAPSHOT))
    taken = [(who.name, item.id) for who, item in turns.take() if isinstance(item, Frame)]
    assert taken == [("robot", 10), ("planner", 0)]
    taken = [(who.name, item.id) for who, item in turns.take() if isinstance(item, Frame)]
    assert taken == [("sensors", 20), ("planner", 1)]


def test_a_second_proposal_is_shed_by_its_header_and_the_client_may_go_on_afterwards() -> None:
    shed: list[ServedClient] = []
    turns, (one, line) = ring(shed), client()
    turns.came(one, ask(1, Kind.PROPOSE))
    turns.came(one, Frame(Kind.PROPOSE, 2, b"\xff not even JSON"))
    turns.came(one, ask(3))  # anything else waits its turn
    assert shed == [one]
    (busy,) = line.sent
    assert (busy.kind, busy.id, json.loads(busy.body)["code"]) == (Kind.ERROR, 2, "BUSY")
    assert served(turns) == [("one", 1), ("one", 3)]
    turns.came(one, ask(4, Kind.PROPOSE))
    assert len(shed) == 2  # served is not answered
    turns.done(one)
    turns.came(one, ask(5, Kind.PROPOSE))
    assert served(turns) == [("one", 5)]
    assert (len(shed), one.shed) == (2, 0)


def test_a_proposal_of_a_client_that_is_gone_is_shed_without_an_answer() -> None:
    shed: list[ServedClient] = []
    turns, (one, line) = ring(shed), client()
    turns.came(one, ask(1, Kind.PROPOSE))
    one.gone = True
    turns.came(one, ask(2, Kind.PROPOSE))  # it came with what made the gate hang up
    assert (shed, line.sent, one.shed) == ([one], [], 1)


def test_after_many_shed_in_a_row_nothing_is_read_until_the_answer() -> None:
    turns, (one, line) = ring(), client()
    turns.came(one, ask(0, Kind.PROPOSE))
    for number in range(1, LIMITS.shed_proposals + 1):
        assert not line.is_paused
        turns.came(one, ask(number, Kind.PROPOSE))
    assert line.is_paused
    turns.came(one, ask(99, Kind.PROPOSE))  # it was in the same bytes
    served(turns)
    assert line.is_paused
    turns.done(one)
    assert not line.is_paused


def test_a_client_with_enough_waiting_is_not_read_until_it_was_served() -> None:
    turns, (one, line) = ring(), client()
    for number in range(LIMITS.waiting_requests):
        assert not line.is_paused
        turns.came(one, ask(number))
    assert line.is_paused
    turns.take()
    assert not line.is_paused


def test_who_does_not_read_is_put_aside_and_served_again_when_it_does() -> None:
    turns, (deaf, _), (other, _) = ring(), client("deaf"), client("other")
    deaf.clogged = True
    turns.came(deaf, ask(1))
    turns.came(deaf, ask(2))
    turns.came(other, ask(3))
    assert served(turns) == [("other", 3)]
    turns.came(deaf, ask(4))
    assert served(turns) == []
    deaf.clogged = False
    turns.reads(deaf)
    turns.reads(deaf)  # twice is once
    assert served(turns) == [("deaf", 1), ("deaf", 2), ("deaf", 4)]
    turns.reads(deaf)
    assert not turns


def test_what_a_client_asked_is_dropped_with_it_but_what_the_gate_began_goes_on() -> None:
    turns, (one, line), (other, _) = ring(), client("one"), client("other")
    begun: list[str] = []
    turns.came(one, ask(1))
    turns.put(one, lambda: begun.append("step"))
    turns.came(other, ask(2))
    one.gone = True
    items = [item for _ in range(3) for _, item in turns.take()]
    for item in items:
        if not isinstance(item, Frame):
            item()
    assert begun == ["step"]
    assert [item.id for item in items if isinstance(item, Frame)] == [2]
    one.reply(1, {})
    one.event(1, {})
    one.error(1, Fault(code="BUSY", message="", where=""))
    one.tell(Kind.HALT, {}, 1)
    assert line.sent == []  # nobody is there


def test_what_is_told_carries_the_number_of_what_it_answers() -> None:
    one, line = client()
    one.reply(1, {"a": 1})
    one.event(2, {})
    one.error(3, Fault(code="BUSY", message="m", where="w"))
    one.tell(Kind.HALT, {}, 4)
    told = [(item.kind, item.id) for item in line.sent]
    assert told == [(Kind.REPLY, 1), (Kind.EVENT, 2), (Kind.ERROR, 3), (Kind.HALT, 4)]
