# SPDX-License-Identifier: Apache-2.0
"""However the gate's own node dies, the base stands and the goal is canceled by who watches it.

The node, the dead-man and the actuator's relay as they are deployed, a gate, and a robot; the
processes of `test_stopping.py` put single faults into a stand-in. How fast it is,
`benchmarks/ros_dead_node.py` measures. Spec page: docs/spec/ros-stopping.md; lessons L1, L19
"""

from __future__ import annotations

import signal
import time
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2 (tests/ros/make.sh makes an environment)")

from geometry_msgs.msg import Twist
from test_msgs.action import Fibonacci

from fixtures.gate_process import RunningGate, until
from ros.deployed import FAULTS, TRANSPORT, guarded
from ros.graph import Goal, Stick
from ros.test_mediation import twist

#: From a fault to a base that stands and a goal that is canceled, in seconds.
SOON_S = 1.0


@pytest.fixture(autouse=True)
def _as_deployed(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in TRANSPORT.items():
        monkeypatch.setenv(name, value)


@pytest.mark.parametrize("fault", FAULTS.values(), ids=FAULTS.keys())
def test_a_goal_of_a_node_that_does_not_live_is_canceled_by_the_dead_man(
    tmp_path: Path, mortal: RunningGate, fault: signal.Signals
) -> None:
    with guarded(tmp_path, mortal) as it:
        planner = it.graph.planner()
        client = planner.client(Fibonacci, "/llm/fibonacci")
        assert Goal(planner, client, Fibonacci.Goal(order=3)).accepted
        begun = it.graph.signal(fault)
        arm = it.graph.robot.arm
        until(lambda: arm.canceled, "the cancellation")
        assert arm.canceled_s - begun < SOON_S
        it.deadman.says('"event": "canceled"')
        it.graph.signal(signal.SIGKILL)


@pytest.mark.parametrize("fault", FAULTS.values(), ids=FAULTS.keys())
def test_the_base_of_a_node_that_does_not_live_stands_whatever_its_planner_says(
    tmp_path: Path, mortal: RunningGate, fault: signal.Signals
) -> None:
    with guarded(tmp_path, mortal) as it:
        stick = Stick(it.graph.planner(), Twist, "/llm/cmd_vel")
        stick.message = twist(0.2)
        until(lambda: 0.2 in it.wheels.speeds, "the velocity")
        begun = it.graph.signal(fault)
        stood = it.stood_s(begun)
        assert stood - begun < SOON_S
        sent, told = stick.sent, len(it.wheels.told)
        until(lambda: stick.sent > sent + 50, "a second of velocities")
        assert set(it.wheels.speeds[told:]) <= {0.0}
        it.graph.signal(signal.SIGKILL)


def test_a_node_that_wakes_up_moves_nothing_that_was_decided_before(
    tmp_path: Path, mortal: RunningGate
) -> None:
    """Its gate has given up the lease meanwhile, and it has dropped what it held itself."""
    with guarded(tmp_path, mortal) as it:
        stick = Stick(it.graph.planner(), Twist, "/llm/cmd_vel")
        stick.message = twist(0.2)
        until(lambda: 0.2 in it.wheels.speeds, "the velocity")
        begun = it.graph.signal(signal.SIGSTOP)
        it.stood_s(begun)
        stick.message = None
        told = len(it.wheels.told)
        until(lambda: [r for r in mortal.news() if r.kind == "outcome"], "the gate's own end of it")
        woke = it.graph.signal(signal.SIGCONT)
        until(lambda: it.wheels.last_s > woke and time.monotonic() > woke + 1, "a second of life")
        assert set(it.wheels.speeds[told:]) == {0.0}
