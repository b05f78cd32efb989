# SPDX-License-Identifier: Apache-2.0
"""A robot that says where it is, as odometry or as transforms, and the estimator that hears it."""

from __future__ import annotations

import asyncio
import json
import math
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from rclpy.qos import DurabilityPolicy, QoSProfile
from tf2_msgs.msg import TFMessage

from authguard_r.client.link import mono_ms
from authguard_r.client.sensing import SENSORS
from authguard_r.core.identifiers import RegionId
from authguard_r.sim.sensors import LOOK_MS, SensorServer
from authguard_r.sim.sight import snapshot_of
from authguard_r.sim.world import initial_state
from fixtures import scenarios
from fixtures.gate_process import RunningGate, environment, module, until
from fixtures.json_lines import whole_lines
from ros.graph import PATIENCE_S, Peer
from ros.hospital import HERE

#: Between two messages, in seconds.
PERIOD_S = 0.02
DOCK = (36.0, 1.5)
Bend = Callable[[Any], None]


def map_with(domain: int, source: str = "nav2-map.yaml", **position: Any) -> str:
    """Return a map whose place comes from somewhere."""
    plain = yaml.safe_load((HERE / source).read_text())
    where = {"map": "main", "floor": 1, "margin_mm": 150, "frame": "main", **position}
    return yaml.safe_dump({**plain, "domain": domain, "position": where})


def stamp(message: Any, ns: int) -> None:
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(ns, 1_000_000_000)


class Walker(Peer):
    """A robot's localization, fifty times a second; its clock is its own.

    Args:
        domain: where.
        at: where it stands at first.
        name: of its node.
    """

    def __init__(
        self, domain: int, at: tuple[float, float] = DOCK, name: str = "localization"
    ) -> None:
        super().__init__(name, domain)
        self._first = at
        self.at = at
        self.speed = (0.0, 0.0)
        self.said: float | None = None  # of its speed, whatever that is
        self.bend: Bend | None = None
        self.is_silent = False
        self.sent = 0
        self.ahead_ns = 5_000_000_000_000  # its clock is nobody's
        self._last_s = time.monotonic()
        self.start()
        self.node.create_timer(PERIOD_S, self._tick, callback_group=self.group)

    def start(self) -> None:
        """Make what it publishes with."""
        self._publisher = self.node.create_publisher(Odometry, "/odom", 10)

    def forget(self) -> None:
        """Stand where it stood at first, and say so; return once whoever listens knows of it."""
        is_new = self.at != self._first or self.is_silent or self.bend is not None
        self.speed, self.said = (0.0, 0.0), None
        self.at = self._first
        self.bend, self.is_silent = None, False
        sent = self.sent
        # a jump is not known yet when the last sound position is still fresh
        until(lambda: not is_new or self.sent > sent + 25, "half a second of it")

    def now_ns(self) -> int:
        return time.monotonic_ns() + self.ahead_ns

    def _tick(self) -> None:
        now_s = time.monotonic()
        took_s, self._last_s = now_s - self._last_s, now_s
        (x, y), (u, v) = self.at, self.speed
        self.at = (x + u * took_s, y + v * took_s)
        if not self.is_silent:
            self.say()
            self.sent += 1

    def say(self) -> None:
        message = self.message()
        if self.bend is not None:
            self.bend(message)
        self._publisher.publish(message)

    def message(self) -> Odometry:
        made = Odometry(child_frame_id="base_link")
        made.header.frame_id = "main"
        stamp(made, self.now_ns())
        made.pose.pose.position.x, made.pose.pose.position.y = self.at
        made.twist.twist.linear.x = math.hypot(*self.speed) if self.said is None else self.said
        return made


def transform(
    parent: str, child: str, at: tuple[float, float], ns: int, turn: float = 0.0
) -> TransformStamped:
    made = TransformStamped(child_frame_id=child)
    made.header.frame_id = parent
    stamp(made, ns)
    made.transform.translation.x, made.transform.translation.y = at
    made.transform.rotation.z, made.transform.rotation.w = math.sin(turn / 2), math.cos(turn / 2)
    return made


class Turned(Walker):
    """The same as transforms: odometry's frame is turned by a quarter, the base is ahead of it."""

    def start(self) -> None:
        self._publisher = self.node.create_publisher(TFMessage, "/tf", 10)
        lasting = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.lasting = self.node.create_publisher(TFMessage, "/tf_static", lasting)
        self.lasting.publish(TFMessage(transforms=[transform("foot", "base_link", (0.1, 0.0), 0)]))

    def message(self) -> TFMessage:
        (x, y), ns = self.at, self.now_ns()
        # main -> odom: at (30, 0), turned by a quarter; so the foot is at (y, -(x - 30)) there
        return TFMessage(
            transforms=[
                transform("main", "odom", (30.0, 0.0), ns, math.pi / 2),
                transform("odom", "foot", (y - 0.1, 30.0 - x), ns),
            ]
        )


class Running:
    """An estimator's process.

    Args:
        folder: for its map and what it says.
        gate: whose state it attests.
        text: the map.
        more: further words.
        changes: words in the place of the usual ones.
    """

    def __init__(
        self, folder: Path, gate: RunningGate, text: str, *more: str, **changes: object
    ) -> None:
        path = folder / "estimator-map.yaml"
        path.write_text(text)
        key = gate.trust / "keys" / f"estimator-{gate.rid}"
        given: dict[str, object] = {
            "map": path,
            "run": gate.run,
            "site": gate.site,
            "trust": gate.trust,
            "key": f"{key}.key.pem",
            "cert": f"{key}.cert.pem",
            **changes,
        }
        words = [word for name, value in given.items() for word in (f"--{name}", str(value))]
        self._folder = folder
        self._errors = (folder / "estimator.err").open("w")
        self.process = subprocess.Popen(
            [*module("authguard_r.integrations.ros.nodes.estimator"), *words, *more],
            stdout=subprocess.PIPE,
            stderr=self._errors,
            text=True,
            env=environment(measured=False),
            cwd=scenarios.ROOT,
        )

    def ready(self) -> dict[str, Any]:
        """Return what it says once the gate has taken a snapshot of it."""
        assert self.process.stdout is not None
        told: dict[str, Any] = json.loads(self.process.stdout.readline() or "{}")
        assert told.get("ready") is True, self.said()
        return told

    def said(self) -> str:
        """Return what it wrote to standard error."""
        return (self._folder / "estimator.err").read_text()

    def lines(self) -> list[dict[str, Any]]:
        """Return every whole line of it that is one of the log's."""
        return whole_lines(self.said(), begins="{")

    @property
    def is_alive(self) -> bool:
        """True while it runs."""
        return self.process.poll() is None

    def events(self) -> list[str]:
        """Return what it said of the position: `sound`, or why not."""
        found = [line for line in self.lines() if line["channel"] == "position"]
        return [str(line.get("why", line["event"])) for line in found]

    def end(self) -> int:
        """End it; return its exit code."""
        if self.process.poll() is None:
            self.process.terminate()
        try:
            return self.process.wait(PATIENCE_S)
        finally:
            self.process.kill()
            self.process.wait()
            if self.process.stdout is not None:
                self.process.stdout.close()
            self._errors.close()


@contextmanager
def estimating(
    folder: Path, gate: RunningGate, text: str, *more: str, is_ready: bool = True
) -> Iterator[Running]:
    """Yield an estimator whose first snapshot the gate has taken; print at its end what it said."""
    made = Running(folder, gate, text, "--demo", *more)
    try:
        if is_ready:
            made.ready()
        yield made
    finally:
        made.end()
        print(made.said())  # pytest shows it when the test fails


@contextmanager
def sensing(gate: RunningGate) -> Iterator[None]:
    """Serve what no localization knows: nobody is near, the battery is full, it holds nothing.

    They lie about the place and the speed: nothing of that may be attested.
    """
    state = initial_state(scenarios.site(), RegionId("pharmacy"))
    raw = snapshot_of(state, robot=gate.rid, epoch=0, seq=0)
    over = threading.Event()

    async def serve() -> None:
        server = SensorServer(gate.run / SENSORS, lambda: raw, clock=mono_ms)
        await server.open()
        while not over.is_set():
            server.look()
            await asyncio.sleep(LOOK_MS / 1_000)
        await server.close()

    thread = threading.Thread(target=lambda: asyncio.run(serve()), daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join(PATIENCE_S)


def heard_ms(gate: RunningGate, auditor: Any) -> int | None:
    """Return how long ago the gate heard of its estimator."""
    age: int | None = auditor.status()["heard"]["estimator_ms"]
    return age


def until_silent(gate: RunningGate, auditor: Any, ms: int = 300) -> None:
    """Wait until the gate has heard nothing of its estimator for a while."""
    until(lambda: (heard_ms(gate, auditor) or 0) > ms, "silence", seconds=PATIENCE_S)


def until_heard(gate: RunningGate, auditor: Any, ms: int = 100) -> None:
    """Wait until the gate hears of its estimator."""

    def is_heard() -> bool:
        age = heard_ms(gate, auditor)
        return age is not None and age < ms

    until(is_heard, "a snapshot", seconds=PATIENCE_S)
