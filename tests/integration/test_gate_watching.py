# SPDX-License-Identifier: Apache-2.0
"""While the robot moves: whatever ends its permission, it stands within a bounded, recorded time.

Real processes: gate, stop lane, robot, estimator. Each test begins with a robot at home, breaks one
thing in mid-motion and looks at the robot's sensors, at the log and at the registry afterwards. How
soon it stands for each cause: test_gate_bounds.py
"""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from authguard_r.client import GateClient
from authguard_r.core.errors import AuthGuardError
from authguard_r.core.mission import Mission
from authguard_r.core.standing import Outcome
from authguard_r.enforcement.signed_orders import Verb
from authguard_r.wire.messages import ClientRole
from fixtures import scenarios
from fixtures.estimator import attesting
from fixtures.gate_process import Line, RunningGate, Told, order, until
from fixtures.shared_gate import SharedGate
from integration.scripted_gate import Sensors

GO = (scenarios.HOSPITAL / "replies" / "01-collect.json").read_bytes()
#: The walk takes 44 s of the robot's time; at this speed of its clock, a good two seconds.
FAST = ("--speed-up", "8")
#: Longest time to stand, in milliseconds, that the gate's configuration allows.
STAND_MS = 2_000


class Walk:
    """A robot on its way to the pharmacy, and what its planner is told at the end."""

    def __init__(
        self, gate: RunningGate, plan: bytes = GO, *, dialect: str = "openai", key: str = "walk"
    ) -> None:
        self.gate = gate
        self.client = gate.mid or "walks"
        self._plan, self._dialect, self._key = plan, dialect, key
        self.answer: dict[str, Any] = {}
        self.error: BaseException | None = None
        self._planner = gate.client(ClientRole.PLANNER, self.client)
        self.released = threading.Event()
        self._thread = threading.Thread(target=self._ask, daemon=True)
        self._thread.start()

    def _ask(self) -> None:
        try:
            self.answer = self._planner.propose(
                self._plan,
                dialect=self._dialect,
                key=self._key,
                on_step=lambda _: self.released.set(),
            )
        except AuthGuardError as error:
            self.error = error
        self.released.set()

    def planner_dies(self) -> None:
        """End the planner's connection, as the end of its process would."""
        self._planner._line.shutdown(socket.SHUT_RDWR)
        self._thread.join(30)

    def moving(self) -> None:
        """Wait until the robot really moves."""
        assert self.released.wait(30)
        assert not self.answer, self.answer
        with sensors(self.gate) as seen:
            seen.until(lambda s: speed(s) > 0)

    def ended(self) -> dict[str, Any]:
        """Return the first step's report once the plan has ended."""
        self._thread.join(30)
        assert self.error is None, self.error
        step: dict[str, Any] = self.answer["steps"][0]
        return step


@contextmanager
def sensors(gate: RunningGate) -> Iterator[Sensors]:
    seen = Sensors(gate.run / "sensors.sock")
    try:
        yield seen
    finally:
        seen.close()


def speed(snapshot: Any) -> int:
    value = snapshot.readings["speed_mm_s"].value
    assert isinstance(value, int)
    return value


def stands(gate: RunningGate) -> None:
    """The robot stands, and goes on standing."""
    with sensors(gate) as seen:
        first = seen.until(lambda s: speed(s) == 0)
        place = (first.pose.x_mm, first.pose.y_mm)
        for _ in range(10):
            later = seen.next()
            assert (later.pose.x_mm, later.pose.y_mm) == place


def outcome(gate: RunningGate) -> Told:
    """Return the record of the one released action's end."""
    found = until(lambda: [r for r in gate.news() if r.kind == "outcome"], "an outcome")
    return found[-1]


def walking(gate: RunningGate, mission: Mission | None = None) -> tuple[Walk, Mission, str]:
    """Return a walk that has begun, its mission and the digest of that."""
    mission = gate.mission() if mission is None else mission
    standing = gate.activate(gate.token(mission))
    walk = Walk(gate)
    walk.moving()
    return walk, mission, standing["digest"]


def operator(gate: RunningGate) -> GateClient:
    return gate.client(ClientRole.OPERATOR, "orders")


@pytest.fixture(scope="module")
def shared() -> Iterator[SharedGate]:
    with SharedGate(robot=FAST, estimator=True, renew_within_ms=300) as made:
        yield made


@pytest.fixture
def gate(shared: SharedGate) -> Iterator[RunningGate]:
    with shared.one_test() as running:
        yield running


def test_an_allowed_walk_arrives_and_the_log_says_so(gate: RunningGate) -> None:
    walk, _, _ = walking(gate)
    assert walk.ended()["execution"]["outcome"] == "succeeded"
    assert outcome(gate).decision == "succeeded"


def test_a_robot_that_leaves_its_way_is_stopped(gate: RunningGate) -> None:
    gate.restart_robot(*FAST, "--drift-to", "station-103")
    gate.activate()
    step = Walk(gate).ended()
    assert step["execution"]["outcome"] == "aborted"
    assert "OUTSIDE_REGIONS" in step["execution"]["reasons"]
    record = outcome(gate)
    assert 0 <= record.open["stood_ms"] <= STAND_MS
    print(f"drift: stood {record.open['stood_ms']} ms after it was found")
    stands(gate)


def test_a_dead_controller_leaves_an_outcome_that_only_a_person_can_settle(
    gate: RunningGate,
) -> None:
    walk, mission, digest = walking(gate)
    gate.stop_process("robot", sign=9)
    step = walk.ended()
    assert step["execution"]["outcome"] == "unknown"
    assert "CONTROLLER_FAILED" in step["execution"]["reasons"]
    with operator(gate) as person:
        status = person.status()["mission"]
        assert status["status"] == "suspended"
        (ticket,) = status["open"]
        settled = order(gate, mission, digest, Verb.RESOLVE, ticket=ticket, outcome=Outcome.ABORTED)
        assert person.command(settled).get("open", []) == []
        resumed = person.command(order(gate, mission, digest, Verb.RESUME))
        assert resumed["status"] == "active"


def test_an_operators_stop_suspends_until_a_signed_resume(gate: RunningGate) -> None:
    walk, mission, digest = walking(gate)
    with GateClient.connect(gate.stop_socket, role=ClientRole.OPERATOR, client="hand") as hand:
        said = hand.stop("somebody is in the way")
    assert said["stopped"] is True
    step = walk.ended()
    assert step["execution"]["outcome"] == "aborted"
    stands(gate)
    (stop,) = until(lambda: [r for r in gate.news() if r.kind == "stop"], "the stop's record")
    assert stop.sealed["why"] == "somebody is in the way"
    assert stop.open["by"].endswith(".hand")
    with operator(gate) as person:
        until(lambda: person.status()["mission"]["status"] == "suspended", "the suspension")
        with gate.client(ClientRole.PLANNER, "again") as planner:
            refused = planner.propose(GO, dialect="openai")
        assert refused["steps"][0]["reasons"] == ["MISSION_SUSPENDED"]
        person.command(order(gate, mission, digest, Verb.RESUME))
    with gate.client(ClientRole.PLANNER, "later") as planner:
        done = planner.propose(GO, dialect="openai")
    assert done["steps"][0]["outcome"] == "accept", done


def test_a_planners_stop_is_counted_and_too_many_raise_an_alert(gate: RunningGate) -> None:
    gate.activate()
    budget = gate.mission().budgets.planner_stops
    with GateClient.connect(gate.stop_socket, role=ClientRole.PLANNER, client="shy") as shy:
        for _ in range(budget + 2):
            assert shy.stop("I am afraid")["stopped"] is True

    def alerted() -> bool:
        return any(r.kind == "alert" and r.open["what"] == "planner stops" for r in gate.news())

    until(alerted, "the alert")
    with operator(gate) as person:
        assert person.status()["mission"]["status"] == "active"  # an alert takes no authority


def own_gate(**given: Any) -> RunningGate:
    """Return a gate that no other test has; it may run beside the shared one."""
    return RunningGate(trust=scenarios.second_trust_folder(), **given)


def test_refusals_in_a_row_raise_the_no_progress_alert_and_stop_the_robot() -> None:
    hijacked = (scenarios.HOSPITAL / "replies" / "03-hijacked-by-notice.json").read_bytes()
    with own_gate(simulate=True, refusals=5) as gate:
        gate.activate()
        with gate.client(ClientRole.PLANNER, "stubborn") as planner:
            for _ in range(5):
                assert (
                    planner.propose(hijacked, dialect="openai")["steps"][0]["outcome"] == "reject"
                )
        with operator(gate) as person:
            alerts = until(lambda: person.status()["alerts"], "an alert")
        assert [alert["what"] for alert in alerts] == ["no progress"]
        assert any(r.kind == "stop" and r.open["by"] == "gate" for r in gate.records())


def test_a_silent_planner_and_a_silent_estimator_raise_one_alert_each() -> None:
    quiet = {"planner_silence_ms": 500, "estimator_silence_ms": 500}
    with own_gate(**quiet) as gate, Line(gate.socket).hello(ClientRole.CONTROLLER):
        with attesting(gate):
            gate.activate()
        with operator(gate) as person:
            until(lambda: len(person.status()["alerts"]) >= 2, "both alerts")
            time.sleep(1.5)  # silence that goes on is no news
            what = sorted(alert["what"] for alert in person.status()["alerts"])
        assert what == ["estimator is silent", "planner is silent"]


@pytest.mark.smoke
def test_a_killed_gate_leaves_a_standing_robot_and_a_suspended_mission(gate: RunningGate) -> None:
    walk, mission, digest = walking(gate)
    began = time.monotonic()
    gate.kill9()
    with sensors(gate) as seen:
        seen.until(lambda s: speed(s) == 0)
    took_ms = round((time.monotonic() - began) * 1_000)
    print(f"dead man: stood {took_ms} ms after the gate was killed")
    stands(gate)
    walk._thread.join(30)
    assert walk.error is not None  # the planner is told that the gate is gone
    gate.start_gate()
    with operator(gate) as person:
        status = until(
            lambda: (m := person.status()["mission"]) and m["status"] == "suspended" and m,
            "the suspension",
        )
        (ticket,) = status["open"]
        with gate.client(ClientRole.PLANNER, walk.client) as planner:
            again = planner.propose(GO, dialect="openai", key="walk")
            assert again["repeated"] is True
            assert again["steps"][0]["execution"]["outcome"] is None  # nobody recorded how it ended
            refused = planner.propose(GO, dialect="openai")
            assert refused["steps"][0]["reasons"][0] == "MISSION_SUSPENDED"
        settled = order(gate, mission, digest, Verb.RESOLVE, ticket=ticket, outcome=Outcome.ABORTED)
        person.command(settled)
        assert person.command(order(gate, mission, digest, Verb.RESUME))["status"] == "active"
    until(lambda: connected(gate), "the controller's return")
    with gate.client(ClientRole.PLANNER, walk.client) as planner:
        done = planner.propose(GO, dialect="openai", key="walk-2")
    assert done["steps"][0]["outcome"] == "accept", done


def connected(gate: RunningGate) -> bool:
    """True while robot and estimator are connected to the gate, and the robot to the stop lane."""
    with operator(gate) as person:
        roles = {client["role"] for client in person.status()["clients"]}
    return {"controller", "estimator"} <= roles and is_at_lane(gate)


def is_at_lane(gate: RunningGate) -> bool:
    """True while the newest robot is connected to the stop lane, by its own log."""
    logs = gate.folder.glob("*-robot.err")
    newest = max(logs, key=lambda path: int(path.name.partition("-")[0]))
    events = re.findall(r'"event": "(\w+)", "channel": "stop.sock"', newest.read_text())
    return events[-1:] == ["connected"]


def test_a_clean_end_stops_the_robot_and_writes_how(gate: RunningGate) -> None:
    walking(gate)
    assert gate.stop_process("gate") == 0
    record = outcome(gate)
    assert (record.decision, record.open["reasons"]) == ("aborted", ["STOPPED"])
    stands(gate)
    gate.start_gate()
    with operator(gate) as person:
        assert person.status()["mission"]["status"] == "active"  # nothing is in doubt


def test_a_gate_that_hangs_renews_nothing_and_the_robot_stands(gate: RunningGate) -> None:
    walk, _, _ = walking(gate)
    os.kill(gate.pid, signal.SIGSTOP)
    try:
        stands(gate)
        with GateClient.connect(gate.stop_socket, role=ClientRole.OPERATOR) as hand:
            assert hand.stop()["stopped"] is True  # the lane does not need the gate
    finally:
        os.kill(gate.pid, signal.SIGCONT)
    step = walk.ended()
    assert step["execution"]["outcome"] == "aborted"


def test_a_second_gate_for_the_same_robot_is_refused(gate: RunningGate) -> None:
    other = RunningGate(trust=gate.trust)
    try:
        with pytest.raises(AssertionError, match="running already"):
            other.start_gate()
    finally:
        other.end()


def test_a_repeat_is_answered_from_what_is_recorded(gate: RunningGate) -> None:
    walk, _, _ = walking(gate)
    first = walk.ended()
    with gate.client(ClientRole.PLANNER, walk.client) as planner:
        again = planner.propose(GO, dialect="openai", key="walk")
        assert again["repeated"] is True
        assert again["steps"][0]["seq"] == first["seq"]
        assert again["steps"][0]["execution"] == first["execution"]
    gate.restart()
    with gate.client(ClientRole.PLANNER, walk.client) as planner:
        after = planner.propose(GO, dialect="openai", key="walk")
        assert after["repeated"] is True
        assert after["steps"][0]["execution"] == first["execution"]
        with pytest.raises(Exception, match="KEY_REUSED"):
            planner.propose(b"another plan", key="walk")
    releases = [r for r in gate.news() if r.kind == "decision" and r.decision == "accept"]
    assert len(releases) == len(json.loads(json.dumps(walk.answer))["steps"])
