# SPDX-License-Identifier: Apache-2.0
"""However the gate's own node dies, the base stands and the goal is canceled by who watches it.

The node, the dead-man and the actuator's relay as they are deployed, a gate, and a robot; the
processes of `test_stopping.py` put single faults into a stand-in. How fast it is,
`benchmarks/ros_dead_node.py` measures. Spec page: docs/spec/ros-stopping.md; lessons L1, L19
"""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from contextlib import ExitStack

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2 (tests/ros/make.sh makes an environment)")

from geometry_msgs.msg import Twist
from test_msgs.action import Fibonacci

from fixtures.gate_process import RunningGate, until
from ros.deployed import FAULTS, Guarded
from ros.graph import Goal, Stick, graph_of
from ros.shared_graph import SharedGate
from ros.test_mediation import twist

#: From a fault to a base that stands and a goal that is canceled, in seconds.
SOON_S = 1.0


@pytest.fixture(scope="module")
def deployed(gate: RunningGate, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Guarded]:
    """A robot with its relay, which outlives each test's node."""
    with ExitStack() as ending:
        graph = ending.enter_context(graph_of(tmp_path_factory.mktemp("graph"), gate))
        yield Guarded(graph, ending)


@pytest.fixture
def robot(deployed: Guarded, shared_gate: SharedGate) -> Iterator[Guarded]:
    """The same with a node that lives; what became of it is dead after the test."""
    shared_gate.renew()
    deployed.begin()
    shared_gate.mark()
    deployed.graph.forget()
    yield deployed
    deployed.graph.signal(signal.SIGKILL)
    print(deployed.graph.said())
    deployed.graph.end_node()
    deployed.graph.rest()


def moves(robot: Guarded) -> Stick:
    """Have a planner steer the base; return what with."""
    stick = Stick(robot.graph.planner(), Twist, "/llm/cmd_vel")
    stick.message = twist(0.2)
    until(lambda: 0.2 in robot.wheels.speeds, "the velocity")
    return stick


@pytest.mark.parametrize(
    "fault",
    [pytest.param(fault, id=name) for name, fault in FAULTS.items()],
)
def test_a_node_that_does_not_live_moves_nothing_and_its_goal_is_canceled_by_the_dead_man(
    robot: Guarded, fault: signal.Signals
) -> None:
    planner, chimes = robot.graph.planner(), robot.graph.robot.chimes
    goal = Goal(planner, planner.client(Fibonacci, "/llm/chimes"), Fibonacci.Goal(order=3))
    assert goal.accepted
    stick = moves(robot)
    begun = robot.graph.signal(fault)
    stood = robot.stood_s(begun)
    until(lambda: chimes.canceled, "the cancellation")
    assert chimes.canceled_s - begun < SOON_S
    assert stood - begun < SOON_S
    robot.canceled()
    sent, told = stick.sent, len(robot.wheels.heard)
    until(lambda: stick.sent > sent + 50, "a second of velocities")
    assert set(robot.wheels.speeds[told:]) <= {0.0}


def test_a_node_that_wakes_up_moves_nothing_that_was_decided_before(
    robot: Guarded, gate: RunningGate
) -> None:
    """Its gate has given up the lease meanwhile, and it has dropped what it held itself."""
    stick = moves(robot)
    begun = robot.graph.signal(signal.SIGSTOP)
    robot.stood_s(begun)
    stick.message = None
    told = len(robot.wheels.heard)
    until(lambda: [r for r in gate.news() if r.kind == "outcome"], "the gate's own end of it")
    woke = robot.graph.signal(signal.SIGCONT)
    until(lambda: robot.wheels.last_s > woke and time.monotonic() > woke + 1, "a second of life")
    assert set(robot.wheels.speeds[told:]) == {0.0}
