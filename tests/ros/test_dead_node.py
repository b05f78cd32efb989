# SPDX-License-Identifier: Apache-2.0
"""However the gate's own node dies, the base stands and the goal is canceled by who watches it.

The node, the dead-man and the actuator's relay as they are deployed, a gate, and a robot; the
processes of `test_stopping.py` put single faults into a stand-in. How fast it is,
`benchmarks/ros_faults.py` measures. Spec page: docs/spec/ros-stopping.md; lessons L1, L19
"""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2 (tests/ros/make.sh makes an environment)")

from geometry_msgs.msg import Twist
from test_msgs.action import Fibonacci

from gates import RunningGate, until
from ros.graph import Base, Goal, Graph, Stick, graph_of
from ros.hospital import HERE
from ros.stuck import EXECUTORS, LOOP
from ros.test_mediation import twist
from ros_stopping import Actor

#: From a fault to a base that stands and a goal that is canceled, in seconds.
SOON_S = 1.0
STUCK = (sys.executable, str(Path(__file__).with_name("stuck.py")))
FAULTS = {
    "killed": signal.SIGKILL,
    "stopped by the kernel": signal.SIGSTOP,
    "dead-locked executors": EXECUTORS,
    "a stuck loop of asyncio": LOOP,
}
ARMED = '"event": "armed"'


@pytest.fixture(autouse=True)
def _as_deployed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Share no memory, as deploy/ros/ros.env says: who writes to a stopped process waits for it."""
    monkeypatch.setenv("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")


class Guarded:
    """A robot whose wheels hear the relay, and whose goals the dead-man may cancel."""

    def __init__(self, graph: Graph, ending: ExitStack) -> None:
        self.graph = graph
        self.wheels = Base(graph.robot, Twist, "/base/cmd_vel")
        text = (HERE / "map.yaml").read_text()
        text = text.replace("[/robot]}", "[/robot], publishes: [/base/cmd_vel]}")
        source = graph.folder / "source.yaml"  # the graph gives it its domain
        source.write_text(text)
        self.map = graph.folder / "guarded.yaml"
        self.map.write_text(text.replace("domain: 1\n", f"domain: {graph.domain}\n"))
        self.relay = self._start(ending, "actuator", "wheels", "/base/cmd_vel")
        self.deadman = self._start(ending, "deadman")
        graph.start(source, STUCK)
        self.deadman.says(ARMED)
        until(lambda: self.wheels.told, "the relay")

    def _start(self, ending: ExitStack, module: str, *words: str) -> Actor:
        name = f"authguard_r.ros.nodes.{module}"
        actor = Actor(["-m", name, str(self.map), *words, "--demo"], sys.executable)
        ending.callback(actor.end)
        actor.event("ready")
        return actor

    def stood_s(self, after: float) -> float:
        """Return when the wheels were told zero, and never anything else since."""

        def found() -> float | None:
            told = zip(self.wheels.at_s, self.wheels.speeds, strict=False)
            since = [(at, speed) for at, speed in tuple(told) if at > after]
            zeros = [at for at, speed in since if speed == 0.0]
            return zeros[0] if zeros else None

        stood = until(found, "wheels that stand")
        assert isinstance(stood, float)
        return stood


@contextmanager
def guarded(folder: Path, gate: RunningGate) -> Iterator[Guarded]:
    with graph_of(folder, gate) as graph, ExitStack() as ending:
        yield Guarded(graph, ending)


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
