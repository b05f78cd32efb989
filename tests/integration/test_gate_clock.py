# SPDX-License-Identifier: Apache-2.0
"""A wall clock that steps back while the gate serves: stops go on, nothing else is begun.

Real processes: gate, stop lane, robot, estimator. The kernel has one wall clock for everybody, so
these processes are started with an interpreter whose `time` reads the machine's clock and adds what
a file says; the test writes the file. Monotonic clocks are the machine's own, as after a real step.
"""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import Any

import pytest

from authguard_r.core.errors import AuthGuardError, EnvironmentFault
from authguard_r.core.mission import Mission
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Outcome
from authguard_r.enforcement.signed_orders import Verb
from authguard_r.wire.gate_limits import LIMITS
from authguard_r.wire.messages import ClientRole, Kind, Propose
from fixtures.gate_process import AUTHGUARD, Line, RunningGate, order, shown, until
from integration.test_gate_watching import FAST, operator, sensors, speed, stands

HOUR_MS = 3_600_000
AHEAD_MS = 5 * 60_000
SCAN = b"scan()"
#: Slow enough to stay in the dock, whatever a test does meanwhile.
GO = b'navigate_to(destination="Pharmacy", speed=0.05)'
NUMBER = count(1)
#: What each interpreter runs at its start; the file holds milliseconds, as text of one length.
STARTUP = """
import os, time
_file = os.open({path!r}, os.O_RDONLY)
_right_ns = time.time_ns
time.time_ns = lambda: _right_ns() + int(os.pread(_file, 32, 0)) * 1_000_000
time.time = lambda: time.time_ns() / 1e9
"""


class WallClock:
    """The wall clock of every process that is started meanwhile.

    Args:
        folder: for the file, and for what the interpreters run.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder
        self._file = os.open(folder / "wrong-ms", os.O_WRONLY | os.O_CREAT)
        self.is_wrong_by(0)
        startup = STARTUP.format(path=str(folder / "wrong-ms"))
        (folder / "sitecustomize.py").write_text(startup)

    def is_wrong_by(self, wrong_ms: int) -> None:
        """Step to this far from the machine's clock, at once and for all processes."""
        os.pwrite(self._file, f"{wrong_ms:+032d}".encode(), 0)

    def close(self) -> None:
        os.close(self._file)


@pytest.fixture(scope="module")
def clock(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WallClock]:
    made = WallClock(tmp_path_factory.mktemp("clock"))
    others = os.environ.get("PYTHONPATH", "")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", f"{made.path}{os.pathsep}{others}" if others else str(made.path))
        yield made
    made.close()


@pytest.fixture(scope="module")
def running(clock: WallClock) -> Iterator[RunningGate]:
    with RunningGate(robot=FAST, estimator=True, refusals=0, fold_ms=0) as running:
        yield running


class Active:
    """A mission that is active while a test runs, and its orders."""

    def __init__(self, gate: RunningGate) -> None:
        self.gate = gate
        self.mission: Mission = gate.mission(mission=f"clock-{next(NUMBER)}")
        self.digest = gate.activate(gate.token(self.mission))["digest"]

    def order(self, verb: Verb, **more: Any) -> dict[str, Any]:
        """Give a signed order; return the standing after it."""
        with operator(self.gate) as person:
            return person.command(order(self.gate, self.mission, self.digest, verb, **more))

    @property
    def status(self) -> dict[str, Any]:
        with operator(self.gate) as person:
            mission: dict[str, Any] = person.status()["mission"]
        return mission


@pytest.fixture
def gate(running: RunningGate, clock: WallClock) -> Iterator[RunningGate]:
    with shown(running):
        running.mark()
        yield running
        clock.is_wrong_by(0)


@pytest.fixture
def active(gate: RunningGate, clock: WallClock) -> Iterator[Active]:
    made = Active(gate)
    yield made
    clock.is_wrong_by(0)
    made.order(Verb.COMPLETE)


def propose(gate: RunningGate, plan: bytes = SCAN) -> dict[str, Any]:
    with gate.client(ClientRole.PLANNER, f"asks-{next(NUMBER)}") as planner:
        step: dict[str, Any] = planner.propose(plan)["steps"][0]
    return step


def works(gate: RunningGate) -> None:
    step = propose(gate)
    assert (step["outcome"], step["execution"]["outcome"]) == ("accept", "succeeded")


def refused(gate: RunningGate, reason: str) -> None:
    step = propose(gate)
    assert (step["outcome"], step["released"], step["reasons"]) == ("reject", False, [reason])


@contextmanager
def moving(gate: RunningGate) -> Iterator[tuple[Line, str]]:
    """Let the robot move; yield who is told of it and the release."""
    with Line(gate.socket).hello(ClientRole.PLANNER, "goes") as line:
        key = f"go-{next(NUMBER)}"
        line.say(Kind.PROPOSE, Propose(key=key, plan=GO, dialect="auto"))
        step = line.told(Kind.EVENT)
        assert step["released"] is True
        with sensors(gate) as seen:
            seen.until(lambda s: speed(s) > 0)
        yield line, step["ticket"]


def alerts(gate: RunningGate) -> list[str]:
    """Return what the gate has warned of: it looks at its clock once a second."""
    with operator(gate) as person:
        return [alert["what"] for alert in person.status()["alerts"]]


def test_what_moves_is_stopped_and_its_known_outcome_is_written_when_the_clock_returns(
    gate: RunningGate, active: Active, clock: WallClock
) -> None:
    with moving(gate) as (line, ticket):
        clock.is_wrong_by(-HOUR_MS)
        execution = line.told(Kind.REPLY)["steps"][0]["execution"]
    assert (execution["outcome"], execution["recorded"]) == ("aborted", False)
    assert execution["reasons"] == ["CLOCK_BEHIND"]
    stands(gate)
    assert active.status["open"] == [ticket]
    assert [r for r in gate.news() if r.kind == "outcome"] == []  # no record without a time
    clock.is_wrong_by(0)
    until(lambda: active.status["open"] == [], "an outcome in the log")
    (outcome,) = [r for r in gate.news() if r.kind == "outcome"]
    assert (outcome.decision, outcome.open["reasons"]) == ("aborted", ["CLOCK_BEHIND"])
    assert outcome.open["ticket"] == ticket
    assert active.status["status"] == "active"
    with pytest.raises(AuthGuardError):  # a person has nothing to resolve any more
        active.order(Verb.RESOLVE, ticket=ticket, outcome=Outcome.FAILED)
    with moving(gate) as (line, _):
        active.order(Verb.SUSPEND)
        assert line.told(Kind.REPLY)["steps"][0]["execution"]["recorded"] is True
    stands(gate)


@pytest.mark.smoke
def test_nothing_is_decided_or_ordered_until_the_clock_has_caught_up(
    gate: RunningGate, active: Active, clock: WallClock
) -> None:
    with gate.client(ClientRole.AUDITOR, "watches") as auditor:
        events = auditor.watch(idle_ms=60_000)
        works(gate)
        clock.is_wrong_by(-HOUR_MS)
        refused(gate, "CLOCK_BEHIND")
        told = next(e for e in events if e["event"] == "decision" and e["outcome"] == "reject")
        assert told["time_ms"] is None  # nobody is told a time that may be wrong
    with operator(gate) as person:
        for act in (
            lambda: person.evaluate(SCAN),
            lambda: active.order(Verb.SUSPEND),
            lambda: person.activate(gate.token(gate.mission(mission="next"))),
        ):
            with pytest.raises(EnvironmentFault) as fault:
                act()
            assert fault.value.reason is Reason.CLOCK_BEHIND
    assert active.status["status"] == "active"  # what can be read, is
    until(lambda: "the clock is behind" in alerts(gate), "the alert")
    until(lambda: gate.refusals("CLOCK_BEHIND"), "the refusal's record")
    clock.is_wrong_by(LIMITS.skew_ms // 2 - HOUR_MS)  # later, but not late enough
    refused(gate, "CLOCK_BEHIND")
    clock.is_wrong_by(-LIMITS.skew_ms // 2)  # as good as right: nobody has to do anything
    works(gate)


def test_a_stop_is_carried_out_and_its_suspension_written_when_the_time_is_right(
    gate: RunningGate, active: Active, clock: WallClock
) -> None:
    clock.is_wrong_by(-HOUR_MS)
    # to the lane alone: a client of ours tells the gate too, and the first to tell is written
    with Line(gate.stop_socket).hello(ClientRole.OPERATOR) as line:
        line.say(Kind.STOP, {"why": "is it late?"}, 1)
        assert line.told(Kind.REPLY)["stopped"] is True
    stop = until(lambda: [r for r in gate.news() if r.kind == "stop"], "the stop's record")[0]
    assert stop.sealed["why"] == "is it late?"
    # the lane's clock is the machine's; the log's has not gone back with it
    assert time_of(gate, stop.seq) - stop.open["at_ms"] > HOUR_MS // 2
    assert active.status["status"] == "active"  # nothing was written yet, so nothing is released
    refused(gate, "STOPPED")
    clock.is_wrong_by(0)
    until(lambda: active.status["status"] == "suspended", "the suspension")
    refused(gate, "MISSION_SUSPENDED")
    assert active.order(Verb.RESUME)["status"] == "active"
    until(lambda: propose(gate)["execution"]["outcome"] == "succeeded", "the work")


def time_of(gate: RunningGate, seq: int) -> int:
    """Return the trusted time of a record."""
    with gate.client(ClientRole.AUDITOR, "reads") as auditor:
        (row,) = auditor.records(seq, 1)["records"]
    return int(row["record"]["link"]["time_ms"])


def test_a_clock_that_was_ahead_and_is_set_right_is_behind_what_was_committed(
    gate: RunningGate, clock: WallClock
) -> None:
    """The step that really happens, and last here: time that was committed does not come again.

    An order that ran out stays so, and after all of it the log is whole, in the order of time.
    """
    active = Active(gate)
    used = order(gate, active.mission, active.digest, Verb.SUSPEND)  # good for a minute
    clock.is_wrong_by(AHEAD_MS)
    assert carried_out(gate, used) == "EXPIRED"
    works(gate)
    clock.is_wrong_by(0)
    refused(gate, "CLOCK_BEHIND")
    assert carried_out(gate, used) == "CLOCK_BEHIND"
    clock.is_wrong_by(AHEAD_MS)  # as that much later
    works(gate)
    assert carried_out(gate, used) == "EXPIRED"
    clock.is_wrong_by(AHEAD_MS - LIMITS.skew_ms // 2)
    works(gate)
    assert active.status["status"] == "active"
    with gate.client(ClientRole.AUDITOR, "reads") as auditor:
        rows = auditor.records(0, 1_000)["records"]
    times = [row["record"]["link"]["time_ms"] for row in rows]
    assert times == sorted(times)
    assert verified(gate)["size"] >= len(rows)


def carried_out(gate: RunningGate, token: bytes) -> str:
    """Return why an order is not carried out."""
    with operator(gate) as person, pytest.raises(AuthGuardError) as refused:
        person.command(token)
    return str(refused.value.reason)


def verified(gate: RunningGate) -> dict[str, Any]:
    """Return what `audit verify` says of a log that is whole."""
    words = [str(AUTHGUARD), "audit", "verify", str(gate.store), "--json"]
    said = subprocess.run(words, capture_output=True, check=False)
    assert said.returncode == 0, said
    found: dict[str, Any] = json.loads(said.stdout)
    return found
