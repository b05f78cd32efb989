# SPDX-License-Identifier: Apache-2.0
"""A store that was put back, deleted or copied, and the gate that starts on it: real processes."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from authguard_r.client import GateClient
from authguard_r.core.errors import AuthGuardError
from authguard_r.core.mission import Mission
from authguard_r.enforcement.signed_orders import Verb
from authguard_r.wire.messages import ClientRole
from fixtures import scenarios
from fixtures.gate_process import AUTHGUARD, RunningGate, order, until
from integration.test_gate_clock import HOUR_MS, WallClock
from integration.test_gate_clock import clock as clock  # noqa: PLC0414 - a fixture
from integration.test_gate_watching import FAST, connected, operator

SCAN = b"scan()"


class CountedGate(RunningGate):
    """A gate with a counter, in another folder than its store."""

    def __init__(self, **more: Any) -> None:
        super().__init__(**more)
        self.counter = self.folder / "other" / "counter"
        self.counter.parent.mkdir()

    def start_gate(self, *more: str) -> dict[str, Any]:
        return super().start_gate("--counter", str(self.counter), *more)

    def ended(self) -> Path:
        """End the gate and return a copy of its store."""
        assert self.stop_process("gate") == 0
        copy = self.folder / f"copy-{len(list(self.folder.glob('copy-*')))}.db"
        shutil.copy(self.store, copy)
        return copy

    @property
    def anchor(self) -> dict[str, Any]:
        with operator(self) as person:
            anchor: dict[str, Any] = person.status()["anchor"]
        return anchor

    @property
    def mission_status(self) -> str | None:
        with operator(self) as person:
            mission = person.status()["mission"]
        return None if mission is None else str(mission["status"])

    def refused(self) -> list[str]:
        """Return why a proposal is refused now."""
        with self.client(ClientRole.PLANNER) as planner:
            step = planner.propose(SCAN)["steps"][0]
        assert (step["outcome"], step["released"]) == ("reject", False)
        reasons: list[str] = step["reasons"]
        return reasons

    def works(self) -> None:
        """Something is carried out, once estimator and robot are back with this gate."""

        def begun() -> dict[str, Any] | None:
            with self.client(ClientRole.PLANNER) as planner:
                step: dict[str, Any] = planner.propose(SCAN)["steps"][0]
            # the robot begins nothing before the gate has heard which start of it this is
            early = step["released"] and step["execution"]["outcome"] == "not_started"
            return None if early or step.get("retryable") else step

        step = until(begun, "a released action that is begun")
        assert step["execution"]["outcome"] == "succeeded", step

    def recovers(self, *words: str) -> dict[str, Any]:
        """Accept the store as a person does at a terminal; return what the command says."""
        said = [str(AUTHGUARD), "recover", "--trust", str(self.trust), "--gate", str(self.run)]
        done = subprocess.run(
            [*said, "--yes", "--json", *words], capture_output=True, check=False, cwd=scenarios.ROOT
        )
        told: dict[str, Any] = json.loads(done.stdout)
        time.sleep(1 - time.time() % 1)  # a mission of the acceptance's own second is refused
        return {"exit": done.returncode, **told}


@pytest.fixture
def gate() -> Iterator[CountedGate]:
    with CountedGate(robot=FAST, estimator=True) as running:
        yield running


def active(gate: CountedGate, **changes: Any) -> tuple[Mission, str]:
    mission = gate.mission(**changes)
    return mission, gate.activate(gate.token(mission))["digest"]


def resumed(gate: CountedGate, mission: Mission, digest: str) -> None:
    with operator(gate) as person:
        person.command(order(gate, mission, digest, Verb.RESUME))


@pytest.mark.smoke
def test_a_snapshot_that_is_put_back_waits_for_a_signed_order_and_a_resume(
    gate: CountedGate,
) -> None:
    mission, digest = active(gate)
    snapshot = gate.ended()
    gate.start_gate()
    until(lambda: connected(gate), "robot and estimator")
    gate.works()
    gate.ended()
    shutil.copy(snapshot, gate.store)
    gate.start_gate()
    until(lambda: connected(gate), "robot and estimator")

    anchor = gate.anchor
    assert (anchor["state"], anchor["why"]) == ("put_back", "behind")
    assert gate.mission_status == "suspended"
    assert gate.refused() == ["ROLLED_BACK"]
    with operator(gate) as person:
        assert "the store was rolled back" in [a["what"] for a in person.status()["alerts"]]
        with pytest.raises(AuthGuardError) as refused:
            person.command(order(gate, mission, digest, Verb.RESUME))
        assert refused.value.reason == "ROLLED_BACK"
        with pytest.raises(AuthGuardError) as refused:
            person.evaluate(SCAN)
        assert refused.value.reason == "ROLLED_BACK"
        assert "ROLLED_BACK" in person.metrics() or person.records(0)["records"]
    with GateClient.connect(gate.stop_socket, role=ClientRole.PLANNER) as hand:
        assert hand.stop()["stopped"] is True
    (alert,) = [r for r in gate.records() if r.open.get("what") == "the store was rolled back"]
    assert alert.open["counted"] > alert.open["size"]
    assert '"why":"behind"' in gate.said()

    told = gate.recovers()
    assert (told["exit"], told["accepted"]["status"]) == (0, "suspended")
    assert gate.anchor["state"] == "counted"
    assert gate.refused() == ["MISSION_SUSPENDED"]
    resumed(gate, mission, digest)
    gate.works()
    gate.restart()
    until(lambda: connected(gate), "robot and estimator")
    assert gate.anchor["state"] == "counted"
    gate.works()
    told = gate.recovers()
    assert (told["exit"], told["error"]["code"]) == (1, "TRANSITION_REFUSED")


@pytest.fixture
def quick() -> Iterator[CountedGate]:
    """A gate with the robot inside: nothing else has to start."""
    with CountedGate(simulate=True) as running:
        yield running


def test_a_store_that_was_deleted_takes_no_mission_of_before(quick: CountedGate) -> None:
    mission, _ = active(quick)
    token = quick.token(mission)
    quick.ended()
    quick.store.unlink()
    quick.start_gate()
    assert quick.anchor["why"] == "replaced"
    assert quick.refused() == ["ROLLED_BACK"]
    until(lambda: quick.recovers()["exit"] == 0, "the signed order")
    with operator(quick) as person, pytest.raises(AuthGuardError) as refused:
        person.activate(token)
    assert refused.value.reason == "ROLLED_BACK"
    active(quick, mission="anew")
    quick.works()


def test_a_copy_that_went_on_elsewhere_is_not_this_robots_last(quick: CountedGate) -> None:
    active(quick)
    copy = quick.ended()
    for store in (copy, quick.store):  # the copy goes on first, and further
        first, quick.store = quick.store, store
        counter = quick.counter.read_bytes()
        quick.start_gate()
        for _ in range(3 if store == copy else 1):
            with quick.client(ClientRole.PLANNER) as planner:
                planner.propose(b"scan(")
        quick.ended()
        if store == copy:
            quick.counter.write_bytes(counter)  # the other machine has a counter of its own
            quick.store = first
    quick.store = copy
    quick.start_gate()
    assert quick.anchor["why"] == "forked"
    assert quick.refused() == ["ROLLED_BACK"]


def test_a_counter_that_is_lost_is_a_persons_to_replace(quick: CountedGate) -> None:
    mission, digest = active(quick)
    quick.ended()
    quick.counter.unlink()
    quick.start_gate()
    assert (quick.anchor["why"], quick.anchor["number"]) == ("counter_missing", 0)
    assert quick.refused() == ["ROLLED_BACK"]
    quick.restart()
    assert quick.anchor["why"] == "counter_missing"
    assert not quick.counter.exists()
    assert quick.recovers()["exit"] == 0
    assert quick.counter.exists()
    resumed(quick, mission, digest)
    quick.works()


def test_a_gate_that_was_merely_killed_is_refused_nothing(quick: CountedGate) -> None:
    mission, digest = active(quick)
    quick.kill9()
    quick.start_gate()
    assert quick.anchor["state"] == "counted"
    until(lambda: quick.mission_status == "suspended", "the recovery")
    resumed(quick, mission, digest)
    quick.works()


def test_a_second_store_is_no_way_to_a_second_gate(quick: CountedGate) -> None:
    """One robot has one gate, whatever folder, store and counter the second one names."""
    with pytest.raises(AssertionError, match="is running already"):
        CountedGate(simulate=True).__enter__()
    assert quick.anchor["state"] == "counted"


def test_a_deleted_store_does_not_make_the_clock_right(
    quick: CountedGate, clock: WallClock
) -> None:
    active(quick)
    quick.ended()
    quick.store.unlink()
    clock.is_wrong_by(-HOUR_MS)
    quick.start_gate()
    with quick.client(ClientRole.PLANNER) as planner, pytest.raises(AuthGuardError) as refused:
        planner.propose(SCAN)
    assert refused.value.reason == "CLOCK_BEHIND"
    assert quick.anchor["why"] == "replaced"
    told = quick.recovers()
    assert told["error"]["code"] == "CLOCK_BEHIND"
    clock.is_wrong_by(0)


def test_a_machine_without_a_clock_serves_stops_until_somebody_sets_it(
    gate: CountedGate, clock: WallClock
) -> None:
    """1970 at boot: what was counted says that it is later, so no certificate seems too young."""
    mission, digest = active(gate)
    gate.ended()
    clock.is_wrong_by(-time.time_ns() // 1_000_000)
    gate.start_gate()
    with gate.client(ClientRole.PLANNER) as planner, pytest.raises(AuthGuardError) as refused:
        planner.propose(SCAN)
    assert refused.value.reason == "CLOCK_BEHIND"
    with GateClient.connect(gate.stop_socket, role=ClientRole.OPERATOR, client="hand") as hand:
        hand.stop("dark")  # the robot has hung up: it takes no gate at its word without a clock
    until(lambda: [r for r in gate.records() if r.kind == "stop"], "the stop's record")
    clock.is_wrong_by(0)
    until(lambda: gate.mission_status == "suspended", "the suspension")
    until(lambda: connected(gate), "robot and estimator")
    resumed(gate, mission, digest)
    gate.works()


def test_a_simulation_that_lost_time_is_where_the_clocks_are() -> None:
    """Held up for seconds: a mission that begins now, by its author's clock, begins now."""
    with RunningGate(simulate=True) as gate:
        os.kill(gate.pid, signal.SIGSTOP)
        try:
            time.sleep(2.5)
        finally:
            os.kill(gate.pid, signal.SIGCONT)
        gate.activate()
        with gate.client(ClientRole.PLANNER) as planner:
            step = planner.propose(SCAN)["steps"][0]
    assert (step["reasons"], step["released"]) == ([], True)
