# SPDX-License-Identifier: Apache-2.0
"""What stands before a base: velocities go on while the gate's node lives, else the base stands.

A class for a robot's own node, and a node of its own that relays to another topic:
`python -m authguard_r.integrations.ros.nodes.actuator MAP NAME TOPIC`.
Spec page: docs/spec/ros-stopping.md#before-a-base
"""

from __future__ import annotations

import math
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

from geometry_msgs.msg import Twist
from rclpy.node import Node

from authguard_r.client.link import ProcessLog
from authguard_r.core.errors import MalformedError
from authguard_r.integrations.ros.latch import MS, LatchCause
from authguard_r.integrations.ros.map import Mediated, MediationKind, RosMap, read_map
from authguard_r.integrations.ros.nodes.heartbeat import (
    ALL,
    PublisherEvent,
    actuation_qos,
    listen,
    new_latch,
)
from authguard_r.integrations.ros.nodes.process import run_node

#: Between two looks of the own watch, in seconds.
LOOK_S = 0.01
#: A base that has to stand gets this command again after so long, in milliseconds.
AGAIN_MS = 50
#: What this robot's map can have a base hear.
TWIST = "geometry_msgs/msg/Twist"


class Actuator:
    """Hands velocities to a robot's driver while they come from one living publisher.

    It begins stopped, and any doubt stops it: then the driver gets zero, again and again, and no
    velocity goes on until a fresh lease (`latch.Latch`). Its watch is a thread of its own: an
    executor that is stuck stops the base too.

    Args:
        node: the robot's own; its executor brings the velocities.
        topic: the whole name of the topic that moves the base.
        drive: sends the driver a velocity; zero is to stand. It is called from two threads, one at
            a time, and has to return at once: while it does not, nothing can stop the base.
        told: what is asked of the middleware.
        log: says once what happened.

    Raises:
        EnvironmentFault: the name is remapped, or this DDS says nothing of its publishers.
    """

    def __init__(
        self,
        node: Node,
        topic: str,
        drive: Callable[[Twist], None],
        *,
        told: PublisherEvent = ALL,
        log: ProcessLog | None = None,
    ) -> None:
        self._node = node
        self._topic = topic
        self._drive = drive
        self._log = log or ProcessLog()
        self._latch = new_latch()
        self._lock = threading.Lock()  # no velocity overtakes a stop
        self._told_ns = 0
        self._over = threading.Event()
        self._watching = threading.Thread(target=self._watch, name="actuator", daemon=True)
        self._subscription = listen(
            node, topic, Twist, heard=self._heard, lost=self._lost, told=told
        )
        self._watching.start()

    @property
    def why(self) -> LatchCause | None:
        """Why the base has to stand; None: velocities go on."""
        return self._latch.why

    def close(self) -> None:
        """Stop the base, and listen no more."""
        self._over.set()
        self._watching.join()
        self._node.destroy_subscription(self._subscription)
        self._lost(LatchCause.CLOSED)

    def _heard(self, velocity: Twist, who: bytes) -> None:
        values = _values(velocity)
        if not all(math.isfinite(value) for value in values):
            self._lost(LatchCause.NOT_FINITE)
            return
        with self._lock:
            before = self._latch.why
            # the clock is read under the lock: time that was waited for counts
            why = self._latch.hear(who, time.monotonic_ns(), is_neutral=not any(values))
            if why is None:
                self._tell(velocity)
            elif before is None:
                self._stand()
            if self._latch.why is not before:
                self._say()

    def _lost(self, why: LatchCause) -> None:
        """Stop the base, if it is not; a second time changes nothing."""
        with self._lock:
            if self._latch.stop(why):
                self._stand()
                self._say()

    def _watch(self) -> None:
        """Look whether velocities come, in a thread that no executor can keep."""
        while not self._over.wait(LOOK_S):
            with self._lock:
                now_ns = time.monotonic_ns()
                if self._latch.look(now_ns):
                    self._stand()
                    self._say()
                elif not self._latch.is_open and now_ns - self._told_ns >= AGAIN_MS * MS:
                    self._stand()

    def _stand(self) -> None:
        self._tell(Twist())

    def _tell(self, velocity: Twist) -> None:
        """Command the driver; after a failure send zero until the driver accepts it."""
        self._told_ns = time.monotonic_ns()
        try:
            self._drive(velocity)
        except Exception as error:  # noqa: BLE001 - not ours, and a stop may not end with it
            self._latch.stop(LatchCause.DRIVER)
            self._told_ns = 0  # at the next look
            self._log.say("driver failed", self._topic, message=repr(error))

    def _say(self) -> None:
        why = self._latch.why
        if why is None:
            self._log.say("moves", self._topic)
        else:
            self._log.say("stopped", self._topic, why=why)


def _values(velocity: Twist) -> tuple[float, ...]:
    linear, angular = velocity.linear, velocity.angular
    return (linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)


def relay_of(ros: RosMap, key: str, topic: str) -> Mediated:
    """Return what a relay is to hear.

    Args:
        ros: the robot's map.
        key: what is mediated.
        topic: where the relay publishes.

    Raises:
        MalformedError: it is no velocity, or the map does not give its enclave that topic.
    """
    item = ros.mediated.get(key)
    if item is None or item.kind is not MediationKind.STREAM or item.type != TWIST:
        raise MalformedError(f"expected a stream of `{TWIST}`, got `{key}`", where="mediated")
    if topic not in ros.processes[item.by].publishes:
        text = f"expected one of the topics that `{item.by}` publishes, got `{topic}`"
        raise MalformedError(text, where=f"processes.{item.by}.publishes")
    return item


def main(words: list[str] | None = None) -> int:
    """Relay until SIGTERM: `MAP NAME TOPIC`."""

    def ready(path: str, key: str, topic: str) -> tuple[RosMap, str, Callable[[Node], Actuator]]:
        ros = read_map(Path(path))
        item = relay_of(ros, key, topic)

        def build(node: Node) -> Actuator:
            base = node.create_publisher(Twist, topic, actuation_qos())
            return Actuator(node, item.private, base.publish)

        return ros, item.by, build

    given = sys.argv[1:] if words is None else words
    return run_node("authguard_actuator", given, ("MAP", "NAME", "TOPIC"), ready)


if __name__ == "__main__":
    sys.exit(main())
