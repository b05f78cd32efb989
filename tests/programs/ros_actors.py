# SPDX-License-Identifier: Apache-2.0
"""Processes of a robot whose gate's node dies: a node that stands for the gate's, a base, a server.

    python ros_actors.py ROLE MAP [WORD...]

Run it in an environment with rclpy. Each takes commands as lines and says what happens as lines of
JSON, with the machine's monotonic clock. The package's
"""

from __future__ import annotations

import asyncio
import json
import queue
import signal
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import rclpy
from action_msgs.srv import CancelGoal
from geometry_msgs.msg import Twist
from loop_watch import LoopWatch
from rclpy.action import ActionClient, ActionServer, CancelResponse
from rclpy.context import Context
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.executors import Executor, MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.task import Future
from test_msgs.action import Fibonacci

from authguard_r.integrations.ros.map import RosMap, read_map
from authguard_r.integrations.ros.nodes.actuator import Actuator
from authguard_r.integrations.ros.nodes.deadman import Deadman
from authguard_r.integrations.ros.nodes.heartbeat import (
    Heartbeat,
    PublisherEvent,
    actuation_qos,
    gate_heartbeat,
    steady,
)

#: A goal that nobody cancels takes so long, in seconds.
GOAL_S = 20.0


def say(event: str, **more: Any) -> None:
    print(json.dumps({"event": event, "ns": time.monotonic_ns(), **more}), flush=True)


def hang() -> None:
    """Wait for a lock that nobody gives back: a dead-lock."""
    lock = threading.Lock()
    lock.acquire()
    lock.acquire()


def obey(node: Node, commands: dict[str, Callable[..., None]]) -> None:
    """Carry out each line in the node's own executor."""
    lines: queue.SimpleQueue[list[str]] = queue.SimpleQueue()

    def read() -> None:
        for line in sys.stdin:
            lines.put(line.split())

    def look() -> None:
        while not lines.empty():
            name, *words = lines.get()
            commands[name](*words)

    threading.Thread(target=read, daemon=True).start()
    node.create_timer(0.005, look, None, steady())


class Gate:
    """Stands for the gate's node: what it says, and the goal that it holds."""

    def __init__(self, node: Node, ros: RosMap, *words: str) -> None:
        self.node = node
        self.velocity = Twist()
        self.is_stubborn = "stubborn" in words  # goes on with its velocity after a silence
        self.is_mute = "mute" in words
        self.loop = asyncio.new_event_loop()
        threading.Thread(target=self.loop.run_forever, daemon=True).start()
        self.turns = LoopWatch(self.loop)
        self.samples = 0
        self.client = ActionClient(node, Fibonacci, ros.mediated["count"].private)
        self.goals: list[Any] = []
        self.beats = Heartbeat(
            node,
            ros.mediated["move"].private,
            Twist,
            self.sample,
            still_alive=self.lives,
            lapsed=self.lapsed,
        )
        gate_heartbeat(node, ros.heartbeat, still_alive=self.lives, lapsed=lambda: None)
        commands = {
            "drive": self.drive,
            "goal": self.goal,
            "end": self.end,
            "deadlock": hang,
            "stick": self.stick,
            "count": lambda: say("samples", count=self.samples),
            "leave": lambda: sys.exit(0),
        }
        obey(node, commands)

    def lives(self) -> bool:
        return not self.is_mute and self.turns()

    def sample(self) -> Twist:
        self.samples += 1
        return self.velocity

    def lapsed(self) -> None:
        say("lapsed")
        if not self.is_stubborn:
            self.velocity = Twist()

    def drive(self, x: str) -> None:
        self.velocity.linear.x = float(x)
        self.beats.beat()

    def goal(self) -> None:
        def answered(answer: Any) -> None:
            self.goals.append(answer.result())
            say("goal", accepted=answer.result().accepted)

        asked = 0

        def send() -> None:
            nonlocal asked
            if self.goals:
                self.sending.cancel()
            elif self.client.server_is_ready():  # to wait for it here would be a silence
                # a server that has not found this client yet drops what it asked
                if asked % 200 == 0:
                    goal = Fibonacci.Goal(order=20)
                    self.client.send_goal_async(goal).add_done_callback(answered)
                asked += 1

        self.goals.clear()
        self.sending = self.node.create_timer(0.01, send, None, steady())

    def end(self) -> None:
        """Do as a gate whose lease is over."""
        say("ended")
        self.velocity = Twist()
        self.beats.beat()
        for goal in self.goals:
            goal.cancel_goal_async()

    def stick(self) -> None:
        self.loop.call_soon_threadsafe(hang)


class Base:
    """A robot's base: its driver says what it is told, and why, whenever that changes."""

    def __init__(self, node: Node, ros: RosMap, *words: str) -> None:
        self.told: tuple[object, object] = (None, None)
        self.fails = False
        topic = ros.mediated["move"].private
        told = PublisherEvent(events="no-events" not in words, ids="no-ids" not in words)
        self.actuator = Actuator(node, topic, self.drive, told=told)
        obey(node, {"stick": hang, "fail": lambda: setattr(self, "fails", True)})

    def drive(self, velocity: Twist) -> None:
        if self.fails and velocity.linear.x:
            raise OSError("no bus")
        told = (velocity.linear.x, self.actuator.why)
        if told != self.told:
            self.told = told
            say("velocity", x=told[0], why=told[1])


class Wheels:
    """What a relay publishes to."""

    def __init__(self, node: Node, ros: RosMap, topic: str) -> None:
        self.x: float | None = None
        node.create_subscription(Twist, topic, self.drive, 10)

    def drive(self, velocity: Twist) -> None:
        if velocity.linear.x != self.x:
            self.x = velocity.linear.x
            say("velocity", x=self.x)


class Server:
    """An action's server: it works until it is done or canceled, whoever asked."""

    def __init__(self, node: Node, ros: RosMap, *words: str) -> None:
        self.node = node
        self.is_slow = "slow" in words
        self.goal_s = 1.0 if "brief" in words else GOAL_S
        ActionServer(
            node,
            Fibonacci,
            ros.mediated["count"].private,
            self.work,
            cancel_callback=self.cancel,
            result_timeout=2,
        )

    def cancel(self, _: Any) -> CancelResponse:
        if self.is_slow:
            time.sleep(0.4)
        return CancelResponse.ACCEPT

    async def work(self, goal: Any) -> Fibonacci.Result:
        say("goal began")
        end = time.monotonic() + self.goal_s
        over: Future[None] = Future()

        def look() -> None:
            if goal.is_cancel_requested or time.monotonic() >= end:
                timer.cancel()
                over.set_result(None)

        timer = self.node.create_timer(0.005, look, None, steady())
        await over
        if goal.is_cancel_requested:
            goal.canceled()
            say("goal canceled")
        else:
            goal.succeed()
            say("goal succeeded")
        return Fibonacci.Result()


class Refuser:
    """Answers as an action's server of rclcpp that refuses to cancel, until it is told to yield."""

    def __init__(self, node: Node, ros: RosMap, *words: str) -> None:
        self.refuses = True
        name = ros.mediated["count"].private
        node.create_service(CancelGoal, f"{name}/_action/cancel_goal", self.answer)
        obey(node, {"yield": lambda: setattr(self, "refuses", False)})

    def answer(self, _: Any, answer: CancelGoal.Response) -> CancelGoal.Response:
        say("asked", refused=self.refuses)
        if self.refuses:
            answer.return_code = CancelGoal.Response.ERROR_REJECTED
        return answer


class Rogue:
    """Publishes velocities beside the gate, with the right profile or with ROS's own."""

    def __init__(self, node: Node, ros: RosMap, profile: str, x: str, *words: str) -> None:
        events = PublisherEventCallbacks(
            incompatible_qos=lambda _: say("incompatible"),
            matched=lambda event: say("matched", count=event.current_count),
        )
        qos = actuation_qos() if profile == "right" else QoSProfile(depth=10)
        topic = ros.mediated["move"].private
        self.publisher = node.create_publisher(Twist, topic, qos, event_callbacks=events)
        self.velocity = Twist()
        self.velocity.linear.x = float(x)
        self.samples = 0
        node.create_timer(0.02, self.publish, None, steady())
        obey(node, {"count": lambda: say("samples", count=self.samples)})

    def publish(self) -> None:
        self.publisher.publish(self.velocity)
        self.samples += 1


class Looker:
    """Says what another node publishes and calls, as the graph has it."""

    def __init__(self, node: Node, ros: RosMap, name: str) -> None:
        def look() -> None:
            if name in node.get_node_names():
                topics = node.get_publisher_names_and_types_by_node(name, "/")
                clients = node.get_client_names_and_types_by_node(name, "/")
                services = node.get_service_names_and_types_by_node(name, "/")
                say("seen", topics=topics, clients=clients, services=services)

        node.create_timer(0.2, look, None, steady())


class Blind:
    """A dead-man that hears nothing of what DDS says of publishers."""

    def __init__(self, node: Node, ros: RosMap) -> None:
        self.deadman = Deadman(node, ros, told=PublisherEvent(events=False))


ROLES: dict[str, Callable[..., object]] = {
    "gate": Gate,
    "base": Base,
    "wheels": Wheels,
    "server": Server,
    "refuser": Refuser,
    "rogue": Rogue,
    "looker": Looker,
    "blind": Blind,
}


def main() -> None:
    role, path, *words = sys.argv[1:]
    ros = read_map(Path(path))
    context = Context()
    rclpy.init(context=context, domain_id=ros.domain)
    node = Node(role, context=context, start_parameter_services=False, enable_rosout=False)
    executor: Executor = SingleThreadedExecutor(context=context)
    if "several" in words:
        executor = MultiThreadedExecutor(3, context=context)
    executor.add_node(node)
    if "waiting" in words:  # it has started and loaded everything; its part begins on a line
        say("ready", role=role)
        sys.stdin.readline()
    actor = ROLES[role](node, ros, *words)
    say("ready", role=type(actor).__name__)
    over = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: over.set())
    with suppress(SystemExit):
        while not over.is_set():
            executor.spin_once(timeout_sec=0.1)
    node.destroy_node()
    context.try_shutdown()


if __name__ == "__main__":
    main()
