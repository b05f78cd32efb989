# SPDX-License-Identifier: Apache-2.0
"""A guarded robot as it is deployed: the gate's node, its dead-man, its relay, a robot, a planner.

`TRANSPORT` is the caller's: who writes to a process that was stopped would wait for it in shared
memory.
"""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from geometry_msgs.msg import Twist

from fixtures.gate_process import RunningGate, until
from fixtures.ros_processes import Actor
from ros.graph import Base, Graph, graph_of
from ros.hospital import HERE
from ros.stuck import EXECUTORS, LOOP, ROBOTS

STUCK = (sys.executable, str(Path(__file__).with_name("stuck.py")))
#: What may become of the gate's node, by the signal that does it.
FAULTS = {
    "killed": signal.SIGKILL,
    "stopped by the kernel": signal.SIGSTOP,
    "dead-locked executors": EXECUTORS,
    "a dead-locked executor of the robot's side": ROBOTS,
    "a stuck loop of asyncio": LOOP,
}
ARMED, FOUND, CANCELED = (f'"event": "{name}"' for name in ("armed", "found", "canceled"))


class Guarded:
    """A robot whose wheels hear the relay, and whose goals the dead-man may cancel."""

    def __init__(self, graph: Graph, ending: ExitStack) -> None:
        self.graph = graph
        self.wheels = Base(graph.robot.wheels, Twist, "/base/cmd_vel")
        text = (HERE / "map.yaml").read_text()
        text = text.replace("[/robot]}", "[/robot], publishes: [/base/cmd_vel]}")
        source = graph.folder / "source.yaml"  # the graph gives it its domain
        source.write_text(text)
        self.map = graph.folder / "guarded.yaml"
        self.map.write_text(text.replace("domain: 1\n", f"domain: {graph.domain}\n"))
        self._source, self._ending = source, ending
        self.relay = self._start("actuator", "wheels", "/base/cmd_vel")
        self.deadman: Actor | None = None

    def begin(self) -> None:
        """Start the node, which may have died before, and wait until it is watched.

        Its dead-man begins anew, too: it says once what comes again and again.
        """
        if self.deadman is not None:
            self.deadman.end()
        self.deadman = self._start("deadman")
        self.graph.start(self._source, STUCK)
        self.deadman.says(ARMED)
        self.deadman.says(FOUND, times=2)  # of both servers: nodes find one another slowly
        self.wheels.forget()
        until(lambda: self.wheels.heard, "the relay")

    def canceled(self) -> None:
        """Wait until its dead-man has said that it canceled a goal."""
        assert self.deadman is not None
        self.deadman.says(CANCELED)

    def _start(self, module: str, *words: str) -> Actor:
        name = f"authguard_r.integrations.ros.nodes.{module}"
        actor = Actor(["-m", name, str(self.map), *words, "--demo"], sys.executable)
        self._ending.callback(actor.end)
        actor.event("ready")
        return actor

    def stood_s(self, after: float) -> float:
        """Return when the wheels were told zero, and never anything else since."""

        def found() -> float | None:
            since = [(at, said.linear.x) for at, said in tuple(self.wheels.heard) if at > after]
            zeros = [at for at, speed in since if speed == 0.0]
            return zeros[0] if zeros else None

        stood = until(found, "wheels that stand")
        assert isinstance(stood, float)
        return stood


@contextmanager
def guarded(folder: Path, gate: RunningGate) -> Iterator[Guarded]:
    """Yield one whose node lives."""
    with graph_of(folder, gate) as graph, ExitStack() as ending:
        made = Guarded(graph, ending)
        made.begin()
        yield made
