# SPDX-License-Identifier: Apache-2.0
"""What a gate does when its world is broken: the clock, the disk, the lane, the controller.

Real processes. Whatever is broken, stops are served, nothing is released that is not on disk, and
once it is mended the work goes on.
"""

from __future__ import annotations

import itertools
import os
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import apsw
import msgspec
import pytest

from authguard_r.client import GateClient
from authguard_r.core.encoding import decode, encode_fast
from authguard_r.core.errors import AuthGuardError, EnvironmentFault
from authguard_r.core.reasons import Reason
from authguard_r.enforcement.signed_orders import Verb
from authguard_r.store.transactions import ClockWatermark
from authguard_r.wire.messages import ClientRole
from fixtures.gate_process import RunningGate, order, until
from integration.test_gate_watching import FAST, GO, connected, operator, walking

HOUR_MS = 3_600_000
HIJACK = b'navigate_to(destination="Station 103", speed=0.8)'


@pytest.fixture
def gate() -> Iterator[RunningGate]:
    with RunningGate(robot=FAST, estimator=True) as running:
        yield running


def turn_the_clock_back(gate: RunningGate, by_ms: int) -> None:
    """Make the store of an ended gate say that it was later than it is."""
    connection = apsw.Connection(str(gate.store))
    query = "SELECT value FROM held WHERE kind = 'clock' AND key = 'high'"
    high = decode(connection.execute(query).get, ClockWatermark, where="high")
    later = encode_fast(msgspec.structs.replace(high, utc_ms=high.utc_ms + by_ms))
    connection.execute("UPDATE held SET value = ? WHERE kind = 'clock' AND key = 'high'", (later,))
    connection.close()


def test_a_clock_that_is_behind_leaves_stops_and_nothing_else(gate: RunningGate) -> None:
    gate.activate()
    assert gate.stop_process("gate") == 0
    turn_the_clock_back(gate, HOUR_MS)
    gate.start_gate()
    until(lambda: connected(gate), "the controller's return")
    # what was left open cannot be settled yet
    with gate.client(ClientRole.PLANNER) as planner, pytest.raises(EnvironmentFault) as refused:
        planner.propose(GO, dialect="openai")
    assert refused.value.reason is Reason.CLOCK_BEHIND
    until(lambda: gate.refusals("CLOCK_BEHIND"), "the refusal's record")
    with operator(gate) as person:
        alerts = until(lambda: person.status()["alerts"], "the alert")
        assert "the clock is behind" in [alert["what"] for alert in alerts]
    with GateClient.connect(gate.stop_socket, role=ClientRole.OPERATOR) as hand:
        assert hand.stop()["stopped"] is True
    until(lambda: [r for r in gate.records() if r.kind == "stop"], "the stop's record")


@contextmanager
def on_a_small_disk(**bounds: Any) -> Iterator[tuple[RunningGate, Path]]:
    """Yield a gate whose store is on a file system of 8 MiB, and the folder of that."""
    if os.geteuid() != 0:
        pytest.skip("mounting a small file system needs root")
    gate = RunningGate(robot=FAST, estimator=True, **bounds)
    disk = gate.folder / "disk"
    disk.mkdir()
    if os.system(f"mount -t tmpfs -o size=8m tmpfs {disk} 2>/dev/null") != 0:
        gate.end()
        pytest.skip("this machine lets nobody mount a file system")
    gate.store = disk / "robot.db"
    try:
        with gate:
            yield gate, disk
    finally:
        os.system(f"umount -l {disk}")


def test_a_full_disk_refuses_releases_and_keeps_room_for_outcomes_and_stops() -> None:
    with on_a_small_disk(reserve_bytes=1 << 20) as (gate, disk):
        walk, mission, digest = walking(gate)
        filler = fill(disk / "filler")
        step = walk.ended()
        assert step["execution"]["outcome"] == "succeeded"
        assert step["execution"]["recorded"] is True  # thanks to the reserve
        refused = walk.answer["steps"][1]
        assert (refused["reasons"], refused["released"]) == (["STORE_FULL"], False)
        with GateClient.connect(gate.stop_socket, role=ClientRole.OPERATOR) as hand:
            assert hand.stop()["stopped"] is True
        until(lambda: [r for r in gate.records() if r.kind == "stop"], "the stop's record")
        filler.unlink()
        with operator(gate) as person:
            resumed = person.command(order(gate, mission, digest, Verb.RESUME))
            assert resumed["status"] == "active"

        def goes_on() -> bool:
            with gate.client(ClientRole.PLANNER, "next") as planner:
                step = planner.propose(b'pick_up(object="P1", force=12)')["steps"][0]
            time.sleep(0.3)  # refusals in a row would stop the robot
            return bool(step["execution"]["outcome"] == "succeeded")

        until(goes_on, "the work")
        assert gate.stop_process("gate") == 0


def test_hijacks_that_are_only_counted_on_a_full_disk_are_in_the_log_after_a_clean_stop() -> None:
    counts = "refusals are only counted: the disk is full"
    with on_a_small_disk(reserve_bytes=1 << 20, refusals=0) as (gate, disk):
        gate.activate()
        numbers = itertools.count()

        def is_recorded() -> bool:
            with gate.client(ClientRole.PLANNER, f"planner-{next(numbers)}") as planner:
                (step,) = planner.propose(HIJACK)["steps"]
            assert (step["outcome"], step["released"]) == ("reject", False)
            return bool(step["execution"]["recorded"])

        assert is_recorded()
        filler = fill(disk / "filler")
        until(lambda: not is_recorded(), "a refusal that is only counted")
        assert not is_recorded()
        assert not is_recorded()
        with operator(gate) as person:
            told = until(
                lambda: [a for a in person.status()["alerts"] if a["what"] == counts], "the alert"
            )
        assert not told[-1].get("over")
        assert gate.stop_process("gate") == 0
        filler.unlink()
        records = gate.records()
    refused = [record for record in records if record.reasons == ["DESTINATION_OUT_OF_SCOPE"]]
    counted = [record.open for record in refused if record.open.get("cause") == "no room"]
    assert [record["repeats"] for record in counted] == [3]
    whole = [record for record in refused if "repeats" not in record.open]
    assert len(whole) == next(numbers) - 3
    assert counts in [record.open.get("what") for record in records if record.kind == "alert"]


def fill(path: Path) -> Path:
    """Use up every byte of a file system."""
    with path.open("wb", buffering=0) as file:
        for size in (1 << 16, 1 << 12, 1):
            try:
                while True:
                    file.write(bytes(size))
            except OSError:
                continue
    return path


def test_a_stop_lane_that_dies_is_started_again(gate: RunningGate) -> None:
    first = gate.lane_pid
    assert first is not None
    os.kill(first, signal.SIGKILL)
    second = until(lambda: (pid := gate.lane_pid) and pid != first and pid, "another lane")
    assert second != first

    def served() -> bool:
        try:
            with GateClient.connect(gate.stop_socket, role=ClientRole.AUDITOR) as anybody:
                said = anybody.stop()
        except AuthGuardError:
            return False
        return bool(said["stopped"])

    until(served, "a stop through the new lane")
    alerts = [r.open["what"] for r in gate.records() if r.kind == "alert"]
    assert "the stop process is gone" in alerts


@pytest.mark.smoke
def test_a_stop_while_no_gate_runs_is_recorded_by_the_next_one(gate: RunningGate) -> None:
    gate.activate()
    gate.kill9()
    with GateClient.connect(gate.stop_socket, role=ClientRole.OPERATOR, client="night") as hand:
        said = hand.stop("the gate is down")
    assert said["controller"] is True  # the lane holds its own connection to the robot
    gate.start_gate()
    stops = until(lambda: [r for r in gate.records() if r.kind == "stop"], "the stop's record")
    assert [r.sealed["why"] for r in stops if r.open["by"].endswith("night")] == [
        "the gate is down"
    ]


def test_a_controller_that_comes_back_goes_on_where_it_stands(gate: RunningGate) -> None:
    gate.activate()
    gate.stop_process("robot")
    with gate.client(ClientRole.PLANNER, "early") as planner:
        answer = planner.propose(GO, dialect="openai")
    reported = answer["steps"][0]
    assert reported["execution"]["outcome"] in {None, "not_started"}  # or its state is too old
    gate.start_robot(*FAST)

    def arrives() -> bool:
        with gate.client(ClientRole.PLANNER, "late") as planner:
            step = planner.propose(GO, dialect="openai")["steps"][0]
        return bool(step["outcome"] == "accept")

    until(arrives, "an accepted walk")


def test_a_planner_that_leaves_gets_no_further_step_begun(gate: RunningGate) -> None:
    walk, _, _ = walking(gate)
    walk.planner_dies()
    until(lambda: '"role":"planner","here":false' in gate.said(), "the planner's leaving")
    until(lambda: [r for r in gate.records() if r.kind == "outcome"], "the first step's end")
    # whoever comes back asks for the same plan after everything that was to come of it
    with gate.client(ClientRole.PLANNER, "walks") as back:
        answer = back.propose(GO, dialect="openai", key="walk")
    assert (answer["repeated"], answer["planned"], len(answer["steps"])) == (True, 2, 1)
    assert len([r for r in gate.records() if r.kind == "decision"]) == 1
