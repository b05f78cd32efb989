# SPDX-License-Identifier: Apache-2.0
"""A courier on ROS 2 that is as real as its topics: it drives, carries, and shows signs.

    python robot.py MAP RUN X Y

It serves what the map mediates (a goal of Nav2, velocities, a lamp, a gripper), publishes odometry,
its battery's level and what its camera reads, and gives its other sensors to `RUN/sensors.sock`.
Faults come as lines on standard input: `say TEXT` (a sign that may lie), `drift MM_S` (it slips to
its right while it drives), `push X Y` (somebody pushes it there), `show`. What happens is told as
lines of JSON on standard output, by the machine's monotonic clock. How-to: docs/howto/ros-story.md
"""

from __future__ import annotations

import asyncio
import json
import math
import queue
import signal
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from typing import Any

from geometry_msgs.msg import Twist
from nav2_msgs.action import NavigateToPose
from nav_msgs.msg import Odometry
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future
from std_msgs.msg import Float32, String
from std_srvs.srv import SetBool

from authguard_r.integrations.ros import (
    LOOK_MS,
    SENSORS,
    Actuator,
    Identifier,
    Label,
    Position,
    Reading,
    RosMap,
    SensorServer,
    Snapshot,
    VariableId,
    made_node,
    mono_ms,
    read_map,
    steady,
)

#: Between two steps of its wheels, in seconds; each is a message of odometry.
TICK_S = 0.02
#: How fast it drives to a goal, in m/s: below what its binding is released for, slip included.
SPEED = 0.45
#: How it speeds up and brakes, in m/s^2: as its profile says.
BRAKE = 1.0
#: How fast a person pushes it, in m/s.
PUSH = 0.4
#: The corridor's middle line: from room to room it goes along it.
MIDDLE_Y = 1.5
#: It is where it was sent when it is so near, in meters.
NEAR = 0.005
BATTERY_PERMILLE = 870

Point = tuple[float, float]


def say(event: str, **more: Any) -> None:
    """Tell one thing that happened, as a line of JSON."""
    sys.stdout.write(json.dumps({"event": event, "ns": time.monotonic_ns(), **more}) + "\n")
    sys.stdout.flush()


def legs_to(at: Point, goal: Point) -> list[Point]:
    """Return straight legs to a goal: into the corridor, along it, and out of it."""
    return [(at[0], MIDDLE_Y), (goal[0], MIDDLE_Y), goal]


class Wheels:
    """Where the robot is and how it moves; everything in meters and seconds.

    Args:
        at: where it stands at first.
    """

    def __init__(self, at: Point) -> None:
        self.at = at
        self.legs: list[Point] = []
        self.slip = 0.0  # to its right, while it drives
        self.hand = (0.0, 0.0)  # a velocity that it is told
        self.pushed_to: Point | None = None
        self.speed = 0.0  # toward the end of its leg
        self._heading = (1.0, 0.0)

    @property
    def left(self) -> float:
        """How far it still has to go."""
        points = [self.at, *self.legs]
        return sum(math.dist(a, b) for a, b in pairwise(points))

    def tick(self, took_s: float, *, may_move: bool) -> float:
        """Move on; return how fast it was.

        Args:
            took_s: since the last step.
            may_move: False: it brakes, whatever it was sent to do.
        """
        before = self.at
        if self.pushed_to is not None:
            self._be_pushed(PUSH * took_s, self.pushed_to)
        elif self.legs or self.speed:
            self._drive(took_s, may_move=may_move)
        elif may_move:
            self._go(self.hand[0] * took_s, self.hand[1] * took_s)
        return math.dist(before, self.at) / took_s

    def _drive(self, took_s: float, *, may_move: bool) -> None:
        distance = math.dist(self.at, self.legs[0]) if self.legs else 0.0
        if distance > NEAR:
            x, y = self.legs[0]
            self._heading = ((x - self.at[0]) / distance, (y - self.at[1]) / distance)
        wanted = min(SPEED, math.sqrt(2 * BRAKE * distance)) if may_move else 0.0
        change = BRAKE * took_s
        self.speed = max(min(wanted, self.speed + change), self.speed - change, 0.0)
        if self.legs and distance <= NEAR:
            self.legs.pop(0)
            self.speed = 0.0
        ahead = self.speed * took_s
        aside = self.slip * took_s if self.speed else 0.0
        x, y = self._heading
        self._go(ahead * x + aside * y, ahead * y - aside * x)

    def _be_pushed(self, step: float, to: Point) -> None:
        distance = math.dist(self.at, to)
        if distance <= step:
            self.at, self.pushed_to = to, None
            return
        self._go((to[0] - self.at[0]) * step / distance, (to[1] - self.at[1]) * step / distance)

    def _go(self, x: float, y: float) -> None:
        self.at = (self.at[0] + x, self.at[1] + y)


class Courier:
    """The robot's node: every name that its map has for it.

    Args:
        node: its owner.
        ros: the robot's map.
        position: of it, in which frame it says where it is.
        at: where it stands at first.
    """

    def __init__(self, node: Node, ros: RosMap, position: Position, at: Point) -> None:
        self.node = node
        self.wheels = Wheels(at)
        self.holds = False
        self._position = position
        self._goal: Any = None
        self._over: Future[None] | None = None
        self._stood = True
        self._why: object = ""
        self._last_s = time.monotonic()
        private = {name: item.private for name, item in ros.mediated.items()}
        self._base = Actuator(node, private["drive"], self._steer)
        ActionServer(
            node,
            NavigateToPose,
            private["navigate"],
            self._navigate,
            goal_callback=self._asked,
            cancel_callback=self._asked_to_cancel,
            result_timeout=2,
        )
        node.create_service(SetBool, private["light"], self._shine)
        node.create_service(SetBool, private["grip"], self._grip)
        self._odometry = node.create_publisher(Odometry, position.odometry, 10)
        self._battery = node.create_publisher(Float32, "/battery", 10)
        self._sign = node.create_publisher(String, ros.shown["sign"].private, 10)
        node.create_timer(TICK_S, self._tick, None, steady())
        node.create_timer(1.0, self._tell_battery, None, steady())

    # what it is asked

    def _asked(self, _: Any) -> GoalResponse:
        return GoalResponse.ACCEPT if self._goal is None else GoalResponse.REJECT

    def _asked_to_cancel(self, _: Any) -> CancelResponse:
        say("goal brakes")
        return CancelResponse.ACCEPT

    async def _navigate(self, goal: Any) -> NavigateToPose.Result:
        at = goal.request.pose.pose.position
        self._goal, self._over = goal, Future()
        self.wheels.legs = legs_to(self.wheels.at, (at.x, at.y))
        say("goal began", x=at.x, y=at.y)
        await self._over
        self._goal = None
        if goal.is_cancel_requested:
            goal.canceled()
            say("goal canceled")
        else:
            goal.succeed()
            say("goal succeeded")
        return NavigateToPose.Result()

    def _steer(self, velocity: Twist) -> None:
        """Take a velocity of the gate's node, on one of two threads."""
        self.wheels.hand = (velocity.linear.x, velocity.linear.y)

    def _shine(self, asked: Any, answer: Any) -> Any:
        say("light", on=asked.data)
        answer.success = True
        return answer

    def _grip(self, asked: Any, answer: Any) -> Any:
        """Take what lies ready, or hand it over."""
        answer.success = asked.data is not self.holds
        self.holds = asked.data
        say("gripper", closed=asked.data, done=answer.success)
        return answer

    # what it does

    def _tick(self) -> None:
        now_s = time.monotonic()
        took_s, self._last_s = now_s - self._last_s, now_s
        wheels, goal, why = self.wheels, self._goal, self._base.why
        if why is not self._why:
            self._why = why
            say("base", why=why)
        is_canceled = goal is not None and goal.is_cancel_requested
        # the base stands without the gate's node, whoever sent a goal
        speed = wheels.tick(took_s, may_move=why is None and not is_canceled)
        say("at", x=round(wheels.at[0], 4), y=round(wheels.at[1], 4), speed=round(speed, 3))
        self._tell_place(speed)
        if speed and self._stood:
            say("moves")
        elif not speed and not self._stood:
            say("stands")
        self._stood = not speed
        if goal is not None:
            self._tell_goal(goal, is_over=is_canceled or not wheels.legs)

    def _tell_goal(self, goal: Any, *, is_over: bool) -> None:
        """Say how far it is, and end it once the wheels stand."""
        goal.publish_feedback(NavigateToPose.Feedback(distance_remaining=self.wheels.left))
        if is_over and not self.wheels.speed and self._over is not None:
            self.wheels.legs = []
            self._over.set_result(None)

    def _tell_place(self, speed: float) -> None:
        made = Odometry(child_frame_id=self._position.child)
        made.header.frame_id = self._position.frame
        made.header.stamp = self.node.get_clock().now().to_msg()
        made.pose.pose.position.x, made.pose.pose.position.y = self.wheels.at
        made.twist.twist.linear.x = speed
        self._odometry.publish(made)

    def _tell_battery(self) -> None:
        self._battery.publish(Float32(data=BATTERY_PERMILLE / 1_000))

    # faults, by lines

    def obey(self, line: str) -> None:
        """Carry out one line."""
        name, _, rest = line.strip().partition(" ")
        commands: dict[str, Callable[[str], None]] = {
            "say": lambda text: self._sign.publish(String(data=text)),
            "drift": self._drift,
            "push": self._push,
            "show": lambda _: say("shown", at=self.wheels.at, holds=self.holds),
        }
        try:
            commands[name](rest)
            say("told", line=line.strip())
        except (KeyError, ValueError):
            say("not understood", line=line.strip())

    def _drift(self, words: str) -> None:
        self.wheels.slip = float(words) / 1_000

    def _push(self, words: str) -> None:
        x, y = map(float, words.split())
        self.wheels.pushed_to = (x, y)

    def close(self) -> None:
        """Stand, and listen no more."""
        self._base.close()

    def sensed(self, ros: RosMap) -> Snapshot:
        """Return what its sensors say beside its place: nobody is near, and what it holds."""
        values: dict[str, int | Identifier] = {
            "battery_permille": BATTERY_PERMILLE,
            "holding": Identifier("package-p1" if self.holds else "nothing"),
            "human_distance_mm": 5_000,
        }
        label = Label.TRUSTED_SENSOR
        readings = {
            VariableId(name): Reading(value=value, label=label, age_ms=0)
            for name, value in values.items()
        }
        return Snapshot(robot=ros.robot, epoch=0, seq=0, readings=readings)


async def sense(path: Path, look: Callable[[], Snapshot]) -> None:
    """Serve the sensors until the process ends."""
    server = SensorServer(path, look, clock=mono_ms)
    await server.open()
    while True:
        server.look()
        await asyncio.sleep(LOOK_MS / 1_000)


def read_lines(into: queue.SimpleQueue[str]) -> None:
    """Take lines of standard input until its end."""
    for line in sys.stdin:
        into.put(line)


def main() -> int:
    """Be the robot until SIGTERM: `MAP RUN X Y`."""
    path, run, x, y = sys.argv[1:]
    ros = read_map(Path(path))
    if ros.position is None:
        return 2
    over = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: over.set())
    lines: queue.SimpleQueue[str] = queue.SimpleQueue()
    threading.Thread(target=read_lines, args=(lines,), daemon=True).start()
    with made_node("base", ros, "/robot/base") as node:
        courier = Courier(node, ros, ros.position, (float(x), float(y)))
        sensing = sense(Path(run) / SENSORS, lambda: courier.sensed(ros))
        threading.Thread(target=asyncio.run, args=(sensing,), daemon=True).start()
        executor = SingleThreadedExecutor(context=node.context)
        executor.add_node(node)
        say("ready")
        while not over.is_set():
            executor.spin_once(timeout_sec=0.1)
            with suppress(queue.Empty):
                courier.obey(lines.get_nowait())
        courier.close()
        executor.shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
