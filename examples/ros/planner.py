# SPDX-License-Identifier: Apache-2.0
"""A planner that does what the last sign says: it reads `/llm/sign` and has no will of its own.

    python planner.py MAP

It stands for a language model that was hijacked. On standard input it is told `go PLACE` (what its
user wants; a sign that names a place counts for more), `light`, `take` and `give`; what it read,
asked and was answered is told as lines of JSON. It knows no name outside `/llm`.
How-to: docs/howto/ros-story.md
"""

from __future__ import annotations

import json
import queue
import signal
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from action_msgs.msg import GoalStatus
from geometry_msgs.msg import PoseStamped
from nav2_msgs.action import NavigateToPose
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import String
from std_srvs.srv import SetBool

from authguard_r.integrations.ros import RosMap, made_node, read_map

#: Where it believes that places are, in meters on the map `main`.
PLACES = {
    "pharmacy": (4.2, 5.3),
    "station 101": (13.0, 5.0),
    "isolation room": (21.0, -3.0),
    "dock": (36.0, 1.5),
}
STATUS = {
    GoalStatus.STATUS_SUCCEEDED: "succeeded",
    GoalStatus.STATUS_CANCELED: "canceled",
    GoalStatus.STATUS_ABORTED: "aborted",
}


def say(event: str, **more: Any) -> None:
    """Tell one thing that happened, as a line of JSON."""
    sys.stdout.write(json.dumps({"event": event, "ns": time.monotonic_ns(), **more}) + "\n")
    sys.stdout.flush()


def goal_to(place: str) -> NavigateToPose.Goal:
    """Return Nav2's goal to a place by its name."""
    made = PoseStamped()
    made.header.frame_id = "main"
    made.pose.position.x, made.pose.position.y = PLACES[place]
    made.pose.orientation.w = 1.0
    return NavigateToPose.Goal(pose=made)


class Planner:
    """Asks for what it was told last, by whomever.

    Args:
        node: its own.
        ros: the robot's map, for the public names.
    """

    def __init__(self, node: Node, ros: RosMap) -> None:
        public = {name: item.public for name, item in ros.mediated.items()}
        self._sign = ""
        self._navigate = ActionClient(node, NavigateToPose, public["navigate"])
        self._light = node.create_client(SetBool, public["light"])
        self._gripper = node.create_client(SetBool, public["grip"])
        self._are_there = False
        node.create_subscription(String, ros.shown["sign"].public, self._read, 10)

    def _read(self, sign: String) -> None:
        self._sign = sign.data
        say("read", sign=sign.data)

    def look(self) -> None:
        """Say once that everything that it needs is there."""
        if not self._are_there:
            parts = (self._light, self._gripper)
            found = self._navigate.server_is_ready() and all(p.service_is_ready() for p in parts)
            if found:
                self._are_there = True
                say("ready")

    def obey(self, line: str) -> None:
        """Carry out one line of its user's."""
        name, _, place = line.strip().partition(" ")
        if name == "go":
            self._go(place)
        elif name in {"light", "take", "give"}:
            client = self._light if name == "light" else self._gripper
            asked = client.call_async(SetBool.Request(data=name != "give"))
            asked.add_done_callback(
                lambda done: say("answered", to=name, success=done.result().success)
            )
        else:
            say("not understood", line=line.strip())

    def _go(self, wanted: str) -> None:
        """Ask for the place that the last sign names; without one, for the one that was wanted."""
        sign = self._sign.lower()
        named = [place for place in PLACES if place in sign]
        place = max(named, key=sign.rfind) if named else wanted
        say("asks", place=place, because=self._sign if named else "its user")
        sent = self._navigate.send_goal_async(goal_to(place))
        sent.add_done_callback(lambda answer: self._answered(place, answer.result()))

    def _answered(self, place: str, goal: Any) -> None:
        say("goal", place=place, accepted=goal.accepted)
        if goal.accepted:
            goal.get_result_async().add_done_callback(
                lambda done: say("result", place=place, status=STATUS[done.result().status])
            )


def read_lines(into: queue.SimpleQueue[str]) -> None:
    """Take lines of standard input until its end."""
    for line in sys.stdin:
        into.put(line)


def main() -> int:
    """Plan until SIGTERM: `MAP`."""
    (path,) = sys.argv[1:]
    ros = read_map(Path(path))
    over = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: over.set())
    lines: queue.SimpleQueue[str] = queue.SimpleQueue()
    threading.Thread(target=read_lines, args=(lines,), daemon=True).start()
    with made_node("planner", ros, ros.enclaves.planner) as node:
        planner = Planner(node, ros)
        executor = SingleThreadedExecutor(context=node.context)
        executor.add_node(node)
        while not over.is_set():
            executor.spin_once(timeout_sec=0.05)
            planner.look()
            with suppress(queue.Empty):
                planner.obey(lines.get_nowait())
        executor.shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
