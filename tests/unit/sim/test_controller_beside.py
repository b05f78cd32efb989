# SPDX-License-Identifier: Apache-2.0
"""Several actions of one controller at once: each has its own lease, and a stop is everybody's.

The desk is driven by frames and time; what moves is a row of lamps, each lit until it is put out.
Source: docs/spec/gate-protocol.md#controllers
"""

from __future__ import annotations

from collections.abc import Mapping

from authguard_r.client.controller import KEPT, ControllerSession, MessageSource
from authguard_r.core.action import Action
from authguard_r.core.identifiers import ActionType, Digest
from authguard_r.core.standing import Outcome, Spend
from authguard_r.wire.messages import Begun, Ended, Kind, Stood
from fixtures import scenarios
from unit.sim.controller_bench import LIFE, Bench, drive, ticket

LAMP = Action(type=ActionType("lamp"), tool="lamps", params={})


class Lamp:
    """One of them, lit or out (`core.ports.Flight`)."""

    def __init__(self) -> None:
        self.ended: Outcome | None = None

    def outcome(self) -> Outcome | None:
        return self.ended

    def used(self) -> Spend:
        return Spend()


class Lamps:
    """A body of three lamps; a velocity dims the one whose stream it is."""

    rid = scenarios.RID
    sampled = frozenset({"linear_mm_s"})
    obeys = True
    late_ms = 0
    stands = True

    def __init__(self) -> None:
        self.lamps: dict[Digest, Lamp] = {}
        self.dimmed: list[tuple[Digest, dict[str, int]]] = []

    def has_room(self, action: Action) -> bool:
        lit = [lamp for lamp in self.lamps.values() if lamp.ended is None]
        return len(lit) < 3 and action.type in {"lamp", "drive"}

    def begin(self, action: Action, ticket: Digest) -> Lamp:
        self.lamps[ticket] = Lamp()
        return self.lamps[ticket]

    def streams(self, action: Action) -> bool:
        return action.type == "drive"

    def steer(self, ticket: Digest, params: Mapping[str, int]) -> None:
        self.dimmed.append((ticket, dict(params)))

    def close(self, ticket: Digest) -> None:
        self.lamps[ticket].ended = Outcome.SUCCEEDED

    def brake(self) -> None:
        for lamp in self.lamps.values():
            lamp.ended = lamp.ended or Outcome.ABORTED

    def pass_time(self, ms: int) -> None:
        pass


class Row(Bench):
    """A desk of lamps."""

    def __init__(self) -> None:
        super().__init__(opened=())
        self.lamps = Lamps()
        self.session = ControllerSession(self.lamps, life=LIFE, now_ms=self.now_ms)
        self.open()

    def light(self, *numbers: int, **changes: int) -> None:
        for number in numbers:
            (sent,) = self.dispatch(LAMP, number, ticket=ticket(number), **changes)
            assert sent.body == Begun(ticket=ticket(number))
        self.sent.clear()

    def go_on(self, duration_ms: int, *numbers: int) -> None:
        """Let time pass; these are renewed."""
        until = self.now_ms + duration_ms
        while self.now_ms < until:
            self.now_ms += 20
            for number in numbers:
                self.renew(number)
            self.sent += self.session.tick(self.now_ms)

    @property
    def ends(self) -> list[tuple[str, str, str]]:
        """How actions ended: number, outcome, why."""
        said = [one.body for one in self.sent if isinstance(one.body, Ended)]
        return [(one.ticket.lstrip("0"), str(one.outcome), str(one.why)) for one in said]


def test_three_run_and_each_ends_by_itself() -> None:
    row = Row()
    row.light(1, 2, 3)
    row.lamps.lamps[ticket(2)].ended = Outcome.SUCCEEDED
    row.go_on(400, 1, 2, 3)
    assert row.ends == [("2", "succeeded", "")]
    assert not row.session.stands
    row.light(4)  # in its place


def test_what_the_body_has_no_room_for_is_busy_and_runs_never() -> None:
    row = Row()
    row.light(1, 2, 3)
    for number, action in ((4, LAMP), (5, scenarios.navigate("dock", "pharmacy"))):
        (sent,) = row.dispatch(action, number)
        body = sent.body
        assert isinstance(body, Ended)
        assert (body.outcome, body.why) == (Outcome.NOT_STARTED, "BUSY")
    assert set(row.lamps.lamps) == {ticket(1), ticket(2), ticket(3)}


def test_a_lease_that_nobody_renews_stops_the_robot_and_says_of_each_why() -> None:
    """No stop is for one of them: a robot that stands is what a stop means."""
    row = Row()
    row.light(1, 2, 3)
    row.go_on(400, 1, 3)
    assert row.ends == [
        ("1", "aborted", "STOPPED"),
        ("2", "aborted", "RENEWAL_LOST"),
        ("3", "aborted", "STOPPED"),
    ]
    assert row.sent[-1].body == Stood(stops=1, life=LIFE)


def test_one_that_lasts_too_long_stops_the_robot() -> None:
    row = Row()
    row.light(1)
    row.light(2, max_ms=100)
    row.go_on(120, 1, 2)
    assert row.ends == [("1", "aborted", "STOPPED"), ("2", "aborted", "LEASE_ENDED")]


def test_a_stop_ends_all_of_them_and_the_robot_stands_once() -> None:
    row = Row()
    row.light(1, 2, 3)
    row.halt()
    assert [end[1:] for end in row.ends] == [("aborted", "STOPPED")] * 3
    assert [one.kind for one in row.sent].count(Kind.STOOD) == 1


def test_a_gate_that_is_gone_ends_all_of_them_and_hears_of_each_when_it_comes_back() -> None:
    row = Row()
    row.light(1, 2)
    row.close()
    row.sent.clear()
    row.open()
    assert row.ends == [("1", "aborted", "RENEWAL_LOST"), ("2", "aborted", "RENEWAL_LOST")]


def test_samples_and_the_close_of_a_stream_are_its_own() -> None:
    row = Row()
    row.light(1)
    for number in (2, 3):
        row.dispatch(drive(100), number)
    row.sample(3, linear_mm_s=50)
    assert row.lamps.dimmed == [(ticket(3), {"linear_mm_s": 50})]
    row.go_on(200, 1, 2, 3)  # no sample came: of the one that had one
    assert row.lamps.dimmed[1:] == [(ticket(3), {})]
    row.sent.clear()
    row.finish(3)
    assert row.ends == [("3", "succeeded", "")]


def test_an_order_of_before_is_never_carried_out_a_second_time() -> None:
    row = Row()
    row.light(1, 2)
    for number in (1, 2):
        row.lamps.lamps[ticket(number)].ended = Outcome.SUCCEEDED
    row.go_on(20)
    for number in (1, 2):
        (sent,) = row.dispatch(LAMP, number)
        assert sent.kind is Kind.ENDED
    assert [end[0] for end in row.ends] == ["1", "2", "1", "2"]


def test_only_the_last_ends_are_kept() -> None:
    row = Row()
    for number in range(1, KEPT + 2):
        row.light(number)
        row.lamps.lamps[ticket(number)].ended = Outcome.SUCCEEDED
        row.go_on(20)
    row.close()
    row.sent.clear()
    row.open()
    assert [end[0] for end in row.ends] == [str(n) for n in range(2, KEPT + 2)]
    assert all(one.channel is MessageSource.GATE for one in row.sent)
