# SPDX-License-Identifier: Apache-2.0
"""What the ROS node adds: goal acceptance, a service, a velocity, beside the same without it.

Run in an environment with rclpy, in a network namespace of its own:

    unshare -rn sh -c 'ip link set lo up; python benchmarks/ros_node.py --json out.json'

The same robot, planner and process are asked both ways, in turns; medians, in milliseconds. The
bare fsync is that of the gate's own file system in the same run.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "src")]

from geometry_msgs.msg import Twist  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402
from test_msgs.action import Fibonacci  # noqa: E402

from gates import until  # noqa: E402
from robots import gate_of  # noqa: E402
from ros.graph import BUDGETS, HERE, Graph, Planner, graph_of  # noqa: E402

IN_DOCK = {"source": "dock", "regions": ["dock"]}
MANY = {"repeat": 5_000, "starts": 5_000}
GRANTS: tuple[dict[str, Any], ...] = (
    {
        "id": "wave",
        "type": "gesture",
        "tool": "arm",
        "rows": [IN_DOCK],
        "limits": {"gesture_no": [1, 20]},
        "max": "1 s",
        **MANY,
    },
    {"id": "honk", "type": "announce", "tool": "speaker", "rows": [{}], **MANY},
    {
        "id": "creep",
        "type": "drive",
        "tool": "base",
        "rows": [IN_DOCK],
        "limits": {
            "linear_mm_s": ["-0.3 m/s", "0.3 m/s"],
            "lateral_mm_s": ["0 m/s", "0 m/s"],
            "turn_urad_s": ["-1 rad/s", "1 rad/s"],
            "duration_ms": ["1 s", "10 s"],
        },
        **MANY,
    },
)
TOOLS = {"gesture": ["arm"], "lamp": ["lamps"], "drive": ["base"]}
BRAKES = {"brake_mm_s2": 1000, "reaction_ms": 20}


def main() -> None:
    """Measure, and print or write what was found."""
    asks = argparse.ArgumentParser()
    asks.add_argument("--trials", type=int, default=100)
    asks.add_argument("--seconds", type=float, default=5.0, help="of velocities, each way")
    asks.add_argument("--json", type=Path)
    given = asks.parse_args()
    folder = Path(mkdtemp(prefix="ag-ros-", dir="/tmp"))
    budgets = {**BUDGETS, "motion": "10 h"}
    with (
        gate_of(
            folder,
            HERE / "binding.yaml",
            tools=TOOLS,
            grants=GRANTS,
            profile=BRAKES,
            changes={"budgets": budgets},
        ) as gate,
        graph_of(folder, gate) as graph,
    ):
        graph.robot.arm.end.set()
        graph.start()
        planner = graph.planner()
        found = {
            "goal acceptance": goals(planner, given.trials),
            "service": services(planner, given.trials),
            "velocity": velocities(graph, planner, given.seconds),
            "bare fsync": {"ms": middle(fsyncs(gate.folder, given.trials))},
        }
    text = json.dumps(found, indent=1)
    if given.json is not None:
        given.json.write_text(text + "\n")
    print(text)


def goals(planner: Planner, trials: int) -> dict[str, float]:
    """Return how long a goal takes until it is accepted."""
    clients = {
        way: planner.client(Fibonacci, name)
        for way, name in (("direct", "/fibonacci"), ("gate", "/llm/fibonacci"))
    }

    def once(way: str) -> float:
        begun = time.perf_counter()
        client = clients[way]
        asked = planner.ask(lambda: client.send_goal_async(Fibonacci.Goal(order=3)))
        handle = asked.result(20)
        took = time.perf_counter() - begun
        assert handle.accepted, way
        planner.ask(handle.get_result_async).result(20)
        return took

    return compared(once, trials)


def services(planner: Planner, trials: int) -> dict[str, float]:
    """Return how long a service takes until it is answered."""
    clients = {}
    for way, name in (("direct", "/horn"), ("gate", "/llm/horn")):
        client = planner.node.create_client(Trigger, name, callback_group=planner.group)
        until(client.service_is_ready, name)
        clients[way] = client

    def once(way: str) -> float:
        begun = time.perf_counter()
        client = clients[way]
        answer = planner.ask(lambda: client.call_async(Trigger.Request())).result(20)
        took = time.perf_counter() - begun
        assert answer.success, answer.message
        return took

    return compared(once, trials)


def velocities(graph: Graph, planner: Planner, seconds: float) -> dict[str, float]:
    """Return how long a velocity takes to the base, fifty a second; and how many were lost."""
    heard: dict[str, dict[int, float]] = {"direct": {}, "gate": {}}
    robot = graph.robot
    for way, topic in (("direct", "/beside"), ("gate", "/cmd_vel")):
        robot.node.create_subscription(
            Twist,
            topic,
            lambda m, way=way: heard[way].setdefault(number_of(m), time.perf_counter()),
            10,
            callback_group=robot.group,
        )
    found: dict[str, float] = {}
    for way, topic in (("direct", "/beside"), ("gate", "/llm/cmd_vel")):
        publisher = planner.publisher(Twist, topic)
        sent = steered(publisher, heard[way], seconds)
        took = [heard[way][n] - at for n, at in sent.items() if n in heard[way]]
        found[way] = middle(took)
        found[f"{way}, slowest"] = round(1e3 * max(took), 3)
        found[f"{way}, lost"] = len(sent) - len(took)
    return {**found, "added": round(found["gate"] - found["direct"], 3)}


def steered(publisher: Any, heard: dict[int, float], seconds: float) -> dict[int, float]:
    """Publish a velocity every 20 ms, each another one; return when each was, once a lease runs."""
    message = Twist()
    message.linear.x = 0.1

    def publish(number: int) -> None:
        message.angular.z = number / 1e6
        publisher.publish(message)

    def begun() -> bool:
        publish(1)
        time.sleep(0.02)
        return 1 in heard

    until(begun, "the lease")
    sent: dict[int, float] = {}
    end = time.perf_counter() + seconds
    while (now := time.perf_counter()) < end:
        number = 2 + len(sent)
        sent[number] = now
        publish(number)
        time.sleep(max(0.0, 0.02 - (time.perf_counter() - now)))
    with suppress(AssertionError):  # it counts as lost
        until(lambda: number in heard, "the last one", seconds=2)
    return sent


def number_of(message: Twist) -> int:
    """Return which of them a velocity is: how fast it turns."""
    return round(message.angular.z * 1e6)


def fsyncs(folder: Path, trials: int) -> list[float]:
    """Return how long an append takes until it is on disk."""
    found = []
    with (folder / "fsync").open("ab") as file:
        for _ in range(trials):
            begun = time.perf_counter()
            file.write(b"x" * 4096)
            file.flush()
            os.fsync(file.fileno())
            found.append(time.perf_counter() - begun)
    return found


def compared(once: Callable[[str], float], trials: int) -> dict[str, float]:
    """Return the medians of both ways, asked in turns."""
    took: dict[str, list[float]] = {"direct": [], "gate": []}
    for number in range(trials + 5):
        for way, times in took.items():
            value = once(way)
            if number >= 5:
                times.append(value)
    found = {way: middle(times) for way, times in took.items()}
    return {**found, "added": round(found["gate"] - found["direct"], 3)}


def middle(times: list[float]) -> float:
    """Return a median in milliseconds."""
    return round(1e3 * statistics.median(times), 3)


if __name__ == "__main__":
    main()
