# SPDX-License-Identifier: Apache-2.0
"""What went wrong when somebody stopped a robot, a gate was frozen, or its clock fell behind."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from authguard_r.audit.record import read_record
from authguard_r.core.encoding import b64
from authguard_r.core.errors import EnvironmentFault
from authguard_r.core.quantities import to_timestamp
from authguard_r.core.standing import Outcome
from authguard_r.enforcement.leases import Running
from authguard_r.estop.run_folder import FIRST_SPOOL, PID, SOCKET, is_served
from authguard_r.estop.supervisor import EStopSupervisor
from authguard_r.normalize import Step
from authguard_r.server.robot_lock import hold_robot
from fixtures import estop_fixtures, scenarios, templates
from fixtures.json_lines import whole_lines
from fixtures.templates import instance, token
from integration.stop_faults import leaves_a_stop
from unit.server.test_robot_lock import fill, names_of
from unit.sim.controller_bench import Bench, drive


def test_l35_a_stop_that_a_frozen_process_was_sent_is_carried_out_when_it_goes_on() -> None:
    """Its client waits for a welcome no more, and has left."""
    files = estop_fixtures.files()
    with estop_fixtures.process(files), estop_fixtures.standing_robot(files.run):
        pid = int((files.run / PID).read_text())
        os.kill(pid, signal.SIGSTOP)
        leaves_a_stop(files.run / SOCKET, "nobody waits")
        os.kill(pid, signal.SIGCONT)
        spool = files.run / FIRST_SPOOL
        (said,) = estop_fixtures.until(lambda: whole_lines(spool.read_bytes()), "the record")
    assert (said["why"], said["role"]) == ("nobody waits", "operator")
    assert said["stood_ms"] is not None


def test_l36_a_renewal_that_waited_in_a_socket_lets_nobody_drive_on() -> None:
    bench = Bench(at="public-corridor")
    bench.dispatch(drive(200))
    bench.wait(200)
    bench.now_ms += 5_000
    bench.renew()
    bench.wait(1_000)
    assert bench.speed == 0
    assert ("ENDED", "aborted", "RENEWAL_LOST") in bench.said()


def test_l37_a_machine_that_activates_a_mission_ends_no_persons_stop() -> None:
    sim = templates.admitted()
    sim.gate.enforcer.stop(by="hand", is_planner=False, suspends=True)
    now = sim.robot.wall_ms()
    window = {"not_before": to_timestamp(now), "expiry": to_timestamp(now + 1_400_000)}
    assert sim.gate.management.activate(token(instance(1, **window))).status == "suspended"
    scenarios.propose(sim, templates.actions(instance().fill)[0])
    assert sim.robot.state.region == "dock"
    sim.gate.close()


def test_l38_no_stop_process_outlives_the_gate_that_ends_last() -> None:
    files = estop_fixtures.files()
    killed, last = EStopSupervisor(files), EStopSupervisor(files)
    killed.start()  # and never ended: its gate was killed
    last.start()
    assert is_served(files.run / SOCKET)
    last.end()
    assert not is_served(files.run / SOCKET)
    killed.end()


def test_l39_a_gate_that_cannot_be_asked_holds_its_robot_all_the_same(tmp_path: Path) -> None:
    rid = f"frozen-{os.getpid()}"
    runs = [tmp_path / "one", tmp_path / "two"]
    for run in runs:
        run.mkdir()
    first = hold_robot(rid, "a" * 16, run=runs[0], store=tmp_path / "first.db")
    asking = fill(names_of(rid)[0])  # nobody answers, as where the process is frozen
    with pytest.raises(EnvironmentFault, match="running already"):
        hold_robot(rid, "a" * 16, run=runs[1], store=tmp_path / "second.db")
    for one in asking:
        one.close()
    first.release()


def test_l40_an_outcome_that_was_known_while_the_clock_was_behind_is_written_later() -> None:
    sim = scenarios.simulation()
    gate, hour_ms = sim.gate, 3_600_000
    mid = gate.management.activate(scenarios.token()).mid
    running = gate.enforcer.submit(
        Step(action=scenarios.navigate("dock", "pharmacy"), attested=()),
        planner="planner",
        evidence=b64(bytes(32)),
        context=sim.binder.context(),
    )
    assert isinstance(running, Running)
    sim.robot._start_ms -= hour_ms
    report = None
    while report is None:
        sim.robot.pause(100)
        report = running.poll()
    assert (report.outcome, report.outcome_recorded) == (Outcome.ABORTED, False)
    assert gate.watch.settle_owed() is False
    sim.robot._start_ms += hour_ms
    assert gate.watch.settle_owed() is True
    standing = gate.management.standing(mid)
    assert standing is not None
    assert standing.open == ()
    (last,) = gate.ledger.peek(lambda turn: turn.rows(turn.head()[0] - 1, 1))
    assert read_record(last[1], where="last").link.decision == "aborted"
    sim.gate.close()
