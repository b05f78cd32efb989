# SPDX-License-Identifier: Apache-2.0
"""Who floods the gate waits for himself: everybody else is served within a turn or two of his.

Real processes. The gate is held still (SIGSTOP) while everybody writes what he wants, so that it
finds all of it at once; what it did first is then read from the log and from the answers. Nothing
here is measured in time.
"""

from __future__ import annotations

import itertools
import json
import os
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count, groupby
from pathlib import Path

import pytest

from authguard_r.approvals import Selection
from authguard_r.core.encoding import Tag, b64
from authguard_r.core.identifiers import Digest
from authguard_r.core.mission import Mission
from authguard_r.core.token import sign_object
from authguard_r.keys.signer import folder_signer
from authguard_r.wire.frames import Frame, frame
from authguard_r.wire.gate_limits import LIMITS
from authguard_r.wire.messages import ClientRole, Kind, Observe, Order, OrderKind, Propose
from fixtures import scenarios
from fixtures.gate_process import Line, RunningGate, Told, shown, until
from integration.test_gate_watching import FAST

#: Proposals that a flooder makes at once.
EACH = 40
#: Of each flooder, before somebody who came at the same time: its turn in the ring, and the one
#: that the gate may have been about to give when it was held.
TURNS = 2
#: Long texts that somebody else tells of meanwhile; a held gate's socket takes no more.
WORDS = 4
SCAN = b"scan()"
#: Refused before a decision, and by one.
UNREADABLE, FORBIDDEN = b"fly_to(the_moon)", b'navigate_to(destination="Office 1", speed=0.5)'
NUMBER = count(1)


def busy_mission(gate: RunningGate) -> Mission:
    """Return a mission of many scans, on state that does not age while the gate is held."""
    (scan,) = (g for g in scenarios.draft()["grants"] if g["id"] == "look-out")
    budgets = {**scenarios.draft()["budgets"], "rate": {"count": 100, "per": "1 s"}}
    return gate.mission(
        grants=[{**scan, "repeat": 40, "starts": 40}],
        guards=[{"variable": "battery_permille", "ge": 200, "max_age": "60 s"}],
        closing=None,
        budgets=budgets,
    )


class Flooder:
    """A planner that does not wait for its answers."""

    def __init__(self, gate: RunningGate, plan: bytes) -> None:
        self.own = f"flood-{next(NUMBER)}"
        self.name = f"u{os.geteuid()}.{self.own}"
        self.plan = plan
        self.line = Line(gate.socket).hello(ClientRole.PLANNER, self.own)
        self.answers: list[Frame] = []

    def pour(self) -> None:
        """Make all proposals in one go."""
        self.line.send(b"".join(self.proposal(number) for number in range(1, EACH + 1)))

    def proposal(self, number: int) -> bytes:
        asked = Propose(key=f"{self.own}-{next(NUMBER)}", plan=self.plan, dialect="auto")
        return frame(Kind.PROPOSE, number, asked)

    def listen(self) -> None:
        """Take every answer."""
        while len(self.answers) < EACH:
            got = self.line.next()
            assert got is not None, "a flooder keeps its connection"
            self.answers.append(got)

    @property
    def rows(self) -> list[int]:
        """How many were shed in a row, each time."""
        runs = groupby(self.answers, key=lambda got: got.kind is Kind.ERROR)
        return [len(list(run)) for shed, run in runs if shed]

    @property
    def served(self) -> int:
        """How many were decided."""
        return sum(got.kind is Kind.REPLY for got in self.answers)


@contextmanager
def held(gate: RunningGate) -> Iterator[None]:
    """Hold the gate still: what is written meanwhile, it finds all at once."""
    state = Path(f"/proc/{gate.pid}/stat")
    os.kill(gate.pid, signal.SIGSTOP)
    try:
        until(lambda: state.read_text().rpartition(")")[2].split()[0] == "T", "the gate's halt")
        yield
    finally:
        os.kill(gate.pid, signal.SIGCONT)


@contextmanager
def flooding(gate: RunningGate, plans: list[bytes]) -> Iterator[list[Flooder]]:
    flooders = [Flooder(gate, plan) for plan in plans]
    try:
        yield flooders
    finally:
        for flooder in flooders:
            flooder.line.close()


def planner_of(record: Told) -> str:
    """Return whose proposal a record is about, empty when it is about none."""
    if record.kind == "decision":
        return str(record.sealed["action"]["meta"]["planner"])
    return str(record.open.get("client", ""))


def of(records: list[Told], client: str, *, shed: bool = False) -> list[Told]:
    """Return what was recorded of a client's proposals: those that were shed, or the others."""
    return [r for r in records if planner_of(r) == client and (r.reasons == ["BUSY"]) is shed]


@pytest.fixture(scope="module")
def gate() -> Iterator[RunningGate]:
    with RunningGate(robot=FAST, estimator=True, refusals=0, fold_ms=0) as running:
        yield running


@pytest.fixture(scope="module")
def mission(gate: RunningGate) -> tuple[Mission, Digest]:
    mission = busy_mission(gate)
    return mission, Digest(gate.activate(gate.token(mission))["digest"])


#: Each choice is signed after the one before, however fast they are signed.
_later = itertools.count(time.time_ns() // 1_000_000)


def chosen(gate: RunningGate, mission: Mission, digest: Digest) -> Order:
    """Return an operator's order, signed, that is carried out each time and stops nothing."""
    value = Selection(
        mid=mission.mid,
        version=mission.version,
        mission=digest,
        grant=mission.actions[0].id,
        row=0,
        nonce=b64(scenarios.random_bytes(16)),
        expires_ms=time.time_ns() // 1_000_000 + 600_000,
        issued_ms=next(_later),
    )
    signer = folder_signer(gate.trust, "operator-1")
    return Order(act=OrderKind.SELECT, token=sign_object(value, Tag.SELECTION, signer))


@pytest.mark.smoke
@pytest.mark.parametrize(
    "plans",
    [[UNREADABLE], [FORBIDDEN], [UNREADABLE, FORBIDDEN] * 3],
    ids=["one-unreadable", "one-forbidden", "six"],
)
def test_between_a_request_and_its_answer_a_flooder_has_a_turn_or_two(
    gate: RunningGate, mission: tuple[Mission, Digest], plans: list[bytes]
) -> None:
    orders = [chosen(gate, *mission) for _ in range(2)]
    with gate.client(ClientRole.OPERATOR, "asks") as person:  # its step waits for no newer state
        until(lambda: person.evaluate(SCAN)["steps"][0]["outcome"] == "accept", "state of now")
    with (
        shown(gate),
        flooding(gate, plans) as flooders,
        Line(gate.socket).hello(ClientRole.PLANNER, "talks") as talker,
        Line(gate.socket).hello(ClientRole.PLANNER, f"works-{next(NUMBER)}") as worker,
        Line(gate.socket).hello(ClientRole.OPERATOR, "early") as early,
        Line(gate.socket).hello(ClientRole.OPERATOR, "late") as late,
    ):
        gate.mark()
        shed_before = shed(gate)
        with held(gate):
            flooders[0].pour()
            early.say(Kind.ORDER, orders[0])
            for flooder in flooders[1:]:
                flooder.pour()
            for number in range(WORDS):  # a part of it is looked through in each turn
                talker.say(Kind.OBSERVE, Observe(channel="camera", text="word " * 800), number)
            key = f"scan-{next(NUMBER)}"
            worker.say(Kind.PROPOSE, Propose(key=key, plan=SCAN, dialect="auto"))
            late.say(Kind.ORDER, orders[1])
        assert worker.told(Kind.EVENT)["released"] is True
        (step,) = worker.told(Kind.REPLY)["steps"]
        assert step["execution"]["outcome"] == "succeeded"
        for operator in (early, late):
            assert operator.told(Kind.REPLY)["standing"]["status"] == "active"
        for flooder in flooders:
            flooder.listen()
        for _ in range(WORDS):
            talker.told(Kind.REPLY)

        def written() -> list[Told] | None:
            news = gate.news()
            told = sum(len(of(news, f.name)) + len(of(news, f.name, shed=True)) for f in flooders)
            return news if told >= sum(f.served + len(f.rows) for f in flooders) else None

        news = until(written, "that everything decided is in the log")
        # fair: what the others asked for came after at most that much of each flooder's
        ordered = [r.seq for r in news if r.open.get("verb") == "select"]
        assert len(ordered) == len(orders)
        for at in (step["seq"], *ordered):
            for flooder in flooders:
                assert len([r for r in of(news, flooder.name) if r.seq < at]) <= TURNS
        assert sum(f.served for f in flooders) > TURNS * len(flooders)  # there was much to come
        # whole: each proposal was decided or shed, and the log and `status` say how many were
        for flooder in flooders:
            assert sorted(got.id for got in flooder.answers) == list(range(1, EACH + 1))
            codes = {json.loads(g.body)["code"] for g in flooder.answers if g.kind is Kind.ERROR}
            assert codes == {"BUSY"}
            assert flooder.served + sum(flooder.rows) == EACH
            assert max(flooder.rows) <= LIMITS.shed_proposals
            assert len(of(news, flooder.name)) == flooder.served
            assert len(of(news, flooder.name, shed=True)) == len(flooder.rows)
        assert shed(gate) - shed_before == sum(sum(f.rows) for f in flooders)
        # connected: a flooder that waits for its answer is served like anybody
        for flooder in flooders:
            flooder.line.send(flooder.proposal(EACH + 1))
            assert flooder.line.told(Kind.REPLY)["repeated"] is False


def shed(gate: RunningGate) -> int:
    with gate.client(ClientRole.AUDITOR, "counts") as auditor:
        return int(auditor.status()["refusals"]["shed"])


def test_work_goes_on_while_clients_flood_without_a_pause(
    gate: RunningGate, mission: tuple[Mission, Digest]
) -> None:
    """The same with nobody held: each answer that a flooder takes is followed by a new flood."""
    with flooding(gate, [UNREADABLE, FORBIDDEN, UNREADABLE]) as flooders:
        with gate.client(ClientRole.PLANNER, f"works-{next(NUMBER)}") as worker:
            for _ in range(8):
                for flooder in flooders:
                    flooder.pour()
                (step,) = worker.propose(SCAN)["steps"]
                assert step["execution"]["outcome"] == "succeeded"
                with gate.client(ClientRole.OPERATOR, "orders") as operator:
                    token = chosen(gate, *mission).token
                    assert operator.select(token)["status"] == "active"
                for flooder in flooders:
                    flooder.answers.clear()
                    flooder.listen()
                    assert flooder.served + sum(flooder.rows) == EACH
        assert {f.name for f in flooders} <= names(gate)


def names(gate: RunningGate) -> set[str]:
    with gate.client(ClientRole.AUDITOR, "counts") as auditor:
        return {client["client"] for client in auditor.status()["clients"]}


def test_what_a_flood_was_refused_is_counted_in_the_log_to_the_last_one() -> None:
    """Repeats are folded, as in a fresh set-up: a few records, which say how many there were."""
    with RunningGate(rid=scenarios.OTHER, simulate=True, refusals=0) as gate:
        with flooding(gate, [UNREADABLE] * 3) as flooders:
            with held(gate):
                for flooder in flooders:
                    flooder.pour()
            for flooder in flooders:
                flooder.listen()
        assert gate.stop_process("gate") == 0
        records = gate.records()
        for flooder in flooders:
            for was_shed, expected in ((False, flooder.served), (True, len(flooder.rows))):
                told = of(records, flooder.name, shed=was_shed)
                assert sum(r.open.get("repeats", 1) for r in told) == expected
                assert len(told) <= 2  # the first, and the count of the others
