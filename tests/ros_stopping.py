# SPDX-License-Identifier: Apache-2.0
"""A robot on ROS 2 as processes that a test may kill, stop and dead-lock; no rclpy in here.

    with Robot() as robot:
        gate, base = robot.start("gate"), robot.start("base")
        gate.tell("drive 0.3")
        base.until(lambda line: line.get("x") == 0.3)

Every process that was started is ended by its number, whatever happened.
"""

from __future__ import annotations

import fcntl
import itertools
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from types import TracebackType
from typing import Any, Self

import yaml

try:
    from coverage import Coverage
except ImportError:  # an environment that measures no lines
    Coverage = None

ACTORS = Path(__file__).with_name("ros_actors.py")
MEASURED = Path(__file__).with_name("measured.py")
SOURCE = Path(__file__).resolve().parents[1] / "src"
#: Bound against hanging, in seconds; nothing is measured against it.
PATIENCE_S = 60.0
#: A process that was told to end is killed after so long, in seconds.
_END_S = 3.0
_DOMAINS = itertools.count(1 + os.getpid() % 90)
_SHARED = Path("/dev/shm")
_ENDS = {"goal canceled", "goal succeeded"}

Line = dict[str, Any]


def map_of(domain: int) -> dict[str, Any]:
    """Return the map of a robot with a base and one action."""
    move = {
        "kind": "stream",
        "type": "geometry_msgs/msg/Twist",
        "public": "/llm/cmd_vel",
        "private": "/cmd_vel",
        "by": "/robot/base",
    }
    count = {
        "kind": "action",
        "type": "test_msgs/action/Fibonacci",
        "public": "/llm/fibonacci",
        "private": "/fibonacci",
        "by": "/robot/arm",
    }
    ours = ("gate", "deadman", "planner", "estimator", "display")
    return {
        "schema": "authguard-r/ros-map/1",
        "robot": "r1",
        "domain": domain,
        "enclaves": {name: f"/authguard/{name}" for name in ours},
        "mediated": {"move": move, "count": count},
        "processes": {
            "/robot/base": {"nodes": ["/base"], "publishes": ["/base/cmd_vel"]},
            "/robot/arm": {"nodes": ["/arm"]},
        },
    }


class Actor:
    """One process, and everything that it said.

    Args:
        words: what it is started with.
        python: of an environment with rclpy.
        unread: nobody reads its standard error, as when a log's shipper died.
    """

    def __init__(self, words: list[str], python: str, *, unread: bool = False) -> None:
        # an environment's variables are not another's
        env = {name: value for name, value in os.environ.items() if "ROS_WHEELS" not in name}
        env |= {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "PYTHONPATH": str(SOURCE)}
        if Coverage is not None and Coverage.current() is not None:
            config = str(SOURCE.parent / "pyproject.toml")
            if words[0] == "-m":
                words = [str(MEASURED), config, *words[1:]]
            else:
                env |= {"COVERAGE_PROCESS_START": config}
        self.process = subprocess.Popen(
            [python, "-u", *words],
            env=env,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        if unread:
            assert self.process.stderr is not None
            self.process.stderr.close()
        self.lines: list[Line] = []
        self.errors: list[str] = []
        self._news = threading.Condition()
        self._readers = [
            threading.Thread(target=self._read, daemon=True),
            *([] if unread else [threading.Thread(target=self._read_errors, daemon=True)]),
        ]
        for reader in self._readers:
            reader.start()

    def tell(self, line: str) -> None:
        """Give it a command."""
        assert self.process.stdin is not None
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()

    def until(self, holds: Callable[[Line], Any], *, after: int = 0) -> Line:
        """Return the first line of which something holds, waiting for it.

        Args:
            holds: asked of each line.
            after: of the machine's monotonic clock; earlier lines do not count.
        """
        end = time.monotonic() + PATIENCE_S
        seen = 0
        with self._news:
            while True:
                for line in self.lines[seen:]:
                    if line["ns"] >= after and holds(line):
                        return line
                seen = len(self.lines)
                if not self._news.wait(end - time.monotonic()):
                    raise AssertionError(f"it did not happen: {self.lines[-5:]} {self.errors[-5:]}")

    def until_now(self, holds: Callable[[Line], Any]) -> None:
        """Wait until something holds of the last line."""
        end = time.monotonic() + PATIENCE_S
        with self._news:
            while not holds(self.lines[-1]):
                if not self._news.wait(end - time.monotonic()):
                    raise AssertionError(f"it did not happen: {self.lines[-5:]}")

    def says(self, words: str, *, times: int = 1) -> None:
        """Wait until so many lines of its standard error have these words."""
        end = time.monotonic() + PATIENCE_S
        with self._news:
            while sum(words in line for line in self.errors) < times:
                if not self._news.wait(end - time.monotonic()):
                    raise AssertionError(f"it did not say `{words}`: {self.errors[-5:]}")

    def event(self, name: str, *, after: int = 0) -> Line:
        """Return the first line of an event, waiting for it."""
        return self.until(lambda line: line["event"] == name, after=after)

    def ended(self, *, after: int) -> Line:
        """Return the line that says how a goal ended, waiting for it."""
        return self.until(lambda line: line["event"] in _ENDS, after=after)

    def until_more(self, samples: int) -> None:
        """Wait until a gate has published so many samples more."""
        wanted = self._count() + samples
        while self._count() < wanted:
            pass

    def _count(self) -> int:
        asked = time.monotonic_ns()
        self.tell("count")
        return int(self.event("samples", after=asked)["count"])

    def velocity(self, x: float, *, after: int = 0) -> Line:
        """Return the line that says that the base was told this velocity, waiting for it."""
        return self.until(lambda line: line["event"] == "velocity" and line["x"] == x, after=after)

    def open(self, *, after: int = 0) -> Line:
        """Return the line that says that velocities go on to the base, waiting for it."""
        return self.until(lambda line: line["event"] == "velocity" and not line["why"], after=after)

    def velocities(self) -> list[float]:
        """Return every velocity that a base was told, in order."""
        return [line["x"] for line in self.lines if line["event"] == "velocity"]

    def send(self, number: signal.Signals) -> int:
        """Send it a signal, and return when."""
        sent = time.monotonic_ns()
        self.process.send_signal(number)
        return sent

    def told_to_end(self) -> None:
        """Tell it to end, and do not wait for it."""
        self.process.send_signal(signal.SIGCONT)
        self.process.terminate()

    def end(self) -> None:
        """End it, and read the rest of what it said."""
        self.told_to_end()
        try:
            self.process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        for reader in self._readers:
            reader.join()
        for stream in (self.process.stdin, self.process.stdout, self.process.stderr):
            assert stream is not None
            with suppress(BrokenPipeError):  # it was killed with a command unread
                stream.close()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for text in self.process.stdout:
            line = {"event": "ready", "ns": 0} if text == "ready\n" else json.loads(text)
            with self._news:
                self.lines.append(line)
                self._news.notify_all()

    def _read_errors(self) -> None:
        assert self.process.stderr is not None
        for text in self.process.stderr:
            with self._news:
                self.errors.append(text.rstrip())
                self._news.notify_all()


class Robot:
    """The processes of one robot; a context manager.

    Args:
        python: of an environment with rclpy; None takes this one.
    """

    def __init__(self, python: str | None = None) -> None:
        self._python = python or sys.executable
        self._folder = TemporaryDirectory(prefix="ros-")
        self.map = Path(self._folder.name) / "map.yaml"
        self.map.write_text(yaml.safe_dump(map_of(next(_DOMAINS) % 100 + 1)))
        self._actors: list[Actor] = []

    def start(self, role: str, *words: str, waits: bool = True) -> Actor:
        """Start a process of `ros_actors`."""
        return self._start([str(ACTORS), role, str(self.map), *words], waits=waits)

    def run(self, module: str, *words: str, waits: bool = True, unread: bool = False) -> Actor:
        """Start a module of the package's as its own process."""
        command = ["-m", f"authguard_r.ros.nodes.{module}", str(self.map), *words, "--demo"]
        return self._start(command, waits=waits, unread=unread)

    def _start(self, words: list[str], *, waits: bool = True, unread: bool = False) -> Actor:
        actor = Actor(words, self._python, unread=unread)
        self._actors.append(actor)
        if waits:
            actor.event("ready")
        return actor

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for actor in self._actors:
            actor.told_to_end()
        for actor in self._actors:
            actor.end()
        self._folder.cleanup()
        clean_shared()


def move(base: Actor, gate: Actor, x: float = 0.3) -> None:
    """Have a base move; where the machine was late, and it stopped, begin anew."""
    while True:
        gate.tell("drive 0")
        base.until_now(lambda line: line["event"] == "velocity" and not line["why"])
        told = time.monotonic_ns()
        gate.tell(f"drive {x}")
        line = base.until(lambda line: line["event"] == "velocity", after=told)
        if line["x"] == x:
            return


class Driving:
    """A robot that moves, with a goal that runs: what a fault is put into.

    Args:
        robot: its processes.
        base: words of its base.
        gate: words of what stands for the gate's node.
    """

    def __init__(
        self, robot: Robot, *, base: tuple[str, ...] = (), gate: tuple[str, ...] = ()
    ) -> None:
        self.server = robot.start("server", waits=False)
        self.base = robot.start("base", *base, waits=False)
        self.deadman = robot.run("deadman", waits=False)
        self.gate = robot.start("gate", *gate, waits=False)
        for actor in (self.server, self.base, self.deadman, self.gate):
            actor.event("ready")
        self.deadman.says("armed")
        self.deadman.says('"found"')
        self.gate.tell("goal")
        self.server.event("goal began")
        move(self.base, self.gate)

    def fault(self, name: str) -> int:
        """Put a fault into the gate's node, and return when: a signal's name, or a command."""
        if name in signal.Signals.__members__:
            return self.gate.send(signal.Signals[name])
        begun = time.monotonic_ns()
        self.gate.tell(name)
        return begun

    def stopped_ms(self, begun_ns: int) -> float:
        """Return how long after that the base was told to stand, waiting for it."""
        return float(self.base.velocity(0.0, after=begun_ns)["ns"] - begun_ns) / 1e6

    def canceled_ms(self, begun_ns: int) -> float:
        """Return how long after that the goal was canceled, waiting for it."""
        line = self.server.ended(after=begun_ns)
        assert line["event"] == "goal canceled"
        return float(line["ns"] - begun_ns) / 1e6


def clean_shared() -> None:
    """Remove shared memory that killed processes of ours left; what anybody holds stays."""
    for lock in _SHARED.glob("fastdds_*_el"):
        try:
            with lock.open("rb") as file:
                # each process that uses a segment holds its lock
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                name = lock.name.removesuffix("_el")
                for left in (name, f"sem.{name}_mutex", lock.name):
                    (_SHARED / left).unlink(missing_ok=True)
        except OSError:
            continue
