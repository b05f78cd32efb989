# SPDX-License-Identifier: Apache-2.0
"""What the ROS node adds: goal acceptance, a service, a velocity, beside the same without it.

Run in an environment with rclpy (`tests/ros/make.sh`), in a network of its own:

    sh tests/ros/alone.sh ENVIRONMENT/bin/python benchmarks/ros_node.py --json out.json

Robot, node and planner are a process each, and robot and planner do nothing else; the same two are
asked both ways, in turns; medians, in milliseconds. What is added is net of bare fsyncs, those of
the gate's own file system in the same run: one for a goal's acceptance, two for a service, whose
outcome is durable before its answer. A relay that decides nothing, a process of `rclpy` as well, is
the third way of services and velocities: what it adds, nothing in between can be without. Under the
flood another process asks for goals that are refused, at a stated rate.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "src")]

import rclpy  # noqa: E402
from geometry_msgs.msg import Twist  # noqa: E402
from rclpy.action import ActionClient, ActionServer  # noqa: E402
from rclpy.callback_groups import ReentrantCallbackGroup  # noqa: E402
from rclpy.context import Context  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.node import Node  # noqa: E402
from std_msgs.msg import UInt8  # noqa: E402
from std_srvs.srv import Empty, Trigger  # noqa: E402
from test_msgs.action import Fibonacci  # noqa: E402

import machine  # noqa: E402
from fixtures.gate_process import RunningGate, until  # noqa: E402
from fixtures.packaged_robots import gate_of  # noqa: E402
from ros.graph import Graph, graph_of  # noqa: E402
from ros.hospital import BRAKES, BUDGETS, GRANTS, HERE, TOOLS  # noqa: E402

#: Of every grant of the tests' hospital there is enough.
MANY = {"repeat": 20_000, "starts": 20_000}
#: Added at most, net of fsyncs, in milliseconds; of a flood, how often longer.
TARGETS = {"goal acceptance": 3.0, "service": 0.5, "velocity": 0.2, "flood": 2.0}
LOST, SLOWEST = "no velocity lost", "slowest velocity"
#: No velocity comes later than this behind the slowest that went direct, in milliseconds.
LATE_MS = 20.0
FLOOD_HZ = 50
#: Times that a flood begins and ends.
FLOODS = 4
#: One lease holds for everything that is measured, the longest of the standard words: between
#: two of them nothing moves.
LEASE_S = 600


def main() -> None:
    """Measure, and print or write what was found."""
    asks = argparse.ArgumentParser()
    asks.add_argument("--trials", type=int, default=100)
    asks.add_argument("--seconds", type=float, default=5.0, help="of velocities, each way")
    asks.add_argument("--json", type=Path)
    asks.add_argument(
        "--require",
        action="append",
        default=[],
        choices=(*TARGETS, LOST, SLOWEST),
        help="exit 1 where it is missed",
    )
    asks.add_argument("--be", choices=("robot", "relay", "flood"), help="one of its own processes")
    asks.add_argument("--domain", type=int, default=1, help="of that one")
    given = asks.parse_args()
    if given.be is not None:
        {"robot": be_robot, "relay": be_relay, "flood": be_flood}[given.be](given.domain)
        return
    folder = Path(mkdtemp(prefix="ag-ros-", dir="/tmp"))
    grants = [{**grant, **MANY, **({"max": "1 s"} if "max" in grant else {})} for grant in GRANTS]
    creep = grants[-1]
    creep["limits"] = {**creep["limits"], "duration_ms": ["1 s", f"{LEASE_S} s"]}
    creep["max"] = f"{LEASE_S} s"
    binding = folder / "binding.yaml"
    text = (HERE / "binding.yaml").read_text()
    binding.write_text(text.replace("duration_ms: 10000", f"duration_ms: {LEASE_S * 1000}"))
    with (
        gate_of(
            folder,
            binding,
            tools=TOOLS,
            grants=grants,
            profile=BRAKES,
            changes={"budgets": {**BUDGETS, "actions": 100_000, "motion": "20 h"}},
        ) as gate,
        graph_of(folder, gate) as graph,
    ):
        graph.robot.close()
        with process_of("robot", graph.domain) as robot, process_of("relay", graph.domain):
            graph.start()
            found = measured(gate, graph, robot, given)
    told = {
        "schema": "authguard-r/ros-node/1",
        **machine.describe(Path(__file__).parent),
        "trials": given.trials,
        "seconds": given.seconds,
        "load": [round(load, 1) for load in os.getloadavg()],  # what else the machine had to do
        **found,
        "targets": judged(found),
    }
    text = json.dumps(told, indent=1)
    if given.json is not None:
        given.json.write_text(text + "\n")
    print(text)
    missed = [name for name in given.require if not told["targets"][name]["met"]]
    if missed:
        sys.exit(f"missed: {', '.join(missed)}")


def measured(
    gate: RunningGate, graph: Graph, robot: Process, given: argparse.Namespace
) -> dict[str, Any]:
    """Return everything that is measured."""
    planner = Peer("planner", graph.domain)
    bare = middle(fsyncs(gate.folder, given.trials))
    return {
        "bare fsync": {"ms": bare},
        "goal acceptance": net(goals(planner, given.trials), bare),
        "service": net(services(planner, given.trials), 2 * bare),
        "flood": flooded(graph, planner, given.trials),
        # the last, for its lease outlasts it
        "velocity": velocities(robot, planner, given.seconds),
    }


class Peer:
    """A node that is spun while it waits, and by nobody else.

    Args:
        name: its name.
        domain: where.
    """

    def __init__(self, name: str, domain: int) -> None:
        context = Context()
        rclpy.init(args=[], context=context, domain_id=domain)
        self.node = Node(name, context=context, start_parameter_services=False, enable_rosout=False)
        self.executor = SingleThreadedExecutor(context=context)
        self.executor.add_node(self.node)

    def answer(self, future: Any) -> Any:
        """Return what a future brings."""
        self.executor.spin_until_future_complete(future, timeout_sec=20)
        return future.result()


class Process:
    """The robot or the relay, as whoever measures it sees it."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        assert process.stdin is not None
        assert process.stdout is not None
        self._process, self._asks, self._tells = process, process.stdin, process.stdout
        self._tells.readline()

    def heard(self, topic: str) -> dict[int, float]:
        """Return which velocities it heard, and when on the machine's monotonic clock."""
        self._asks.write(topic + "\n")
        self._asks.flush()
        return {int(number): at for number, at in json.loads(self._tells.readline()).items()}


@contextmanager
def process_of(what: str, domain: int) -> Iterator[Process]:
    words = [sys.executable, __file__, "--be", what, "--domain", str(domain)]
    with subprocess.Popen(
        words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            yield Process(process)
        finally:
            process.kill()


def be_robot(domain: int) -> None:
    """Take every goal and call at once, and note when each velocity comes, until killed."""
    robot = Peer("robot", domain)
    heard: dict[str, dict[int, float]] = {"/beside": {}, "/relayed": {}, "/cmd_vel": {}}

    def run(handle: Any) -> Any:
        handle.succeed()
        return Fibonacci.Result()

    def called(_: object, answer: Any) -> Any:
        answer.success = True
        return answer

    for name in ("/fibonacci", "/chimes", "/beside"):
        ActionServer(robot.node, Fibonacci, name, run, result_timeout=2)
    for name in ("/horn", "/hold"):
        robot.node.create_service(Trigger, name, called)
    for name in ("/clear", "/quiet"):
        robot.node.create_service(Empty, name, lambda _, answer: answer)
    robot.node.create_subscription(UInt8, "/lamp", lambda _: None, 10)
    for topic, numbers in heard.items():
        robot.node.create_subscription(
            Twist,
            topic,
            lambda message, n=numbers: n.setdefault(number_of(message), time.monotonic()),
            10,
        )
    threading.Thread(target=robot.executor.spin, daemon=True).start()
    print("ready", flush=True)
    for line in sys.stdin:
        print(json.dumps(heard[line.strip()]), flush=True)


def net(found: dict[str, float], fsyncs_ms: float) -> dict[str, float]:
    """Return what was found with what the node adds net of its fsyncs."""
    return {**found, "net": round(found["added"] - fsyncs_ms, 3)}


def judged(found: dict[str, Any]) -> dict[str, Any]:
    """Return each target with what was reached."""
    velocity = found["velocity"]
    late = velocity["gate, slowest"] - velocity["direct, slowest"]
    reached = {
        "goal acceptance": found["goal acceptance"]["net"],
        "service": found["service"]["net"],
        "velocity": velocity["added"],
        "flood": found["flood"]["ratio"],
    }
    told = {
        name: {"target": most, "reached": reached[name], "met": reached[name] <= most}
        for name, most in TARGETS.items()
    }
    lost = velocity["gate, lost"]
    return {
        **told,
        LOST: {"target": 0, "reached": lost, "met": lost == 0},
        SLOWEST: {"target": LATE_MS, "reached": round(late, 3), "met": late <= LATE_MS},
    }


def be_relay(domain: int) -> None:
    """Hand on whatever comes, until killed."""
    relay = Peer("relay", domain)
    group = ReentrantCallbackGroup()
    wheels = relay.node.create_publisher(Twist, "/relayed", 10)
    horn = relay.node.create_client(Trigger, "/horn", callback_group=group)

    async def called(request: Any, _: object) -> Any:
        return await horn.call_async(request)

    relay.node.create_service(Trigger, "/relay/horn", called, callback_group=group)
    relay.node.create_subscription(Twist, "/relay/cmd_vel", wheels.publish, 10)
    print("ready", flush=True)
    relay.executor.spin()


def flooded(graph: Graph, planner: Peer, trials: int) -> dict[str, float]:
    """Return how much longer an allowed goal takes while another process asks for others.

    With and without it take turns, so that what the machine does meanwhile falls on both. One that
    is refused under the flood, though it is allowed, is counted and asked again.
    """
    once = acceptance(planner, "/llm/fibonacci")
    words = [sys.executable, __file__, "--be", "flood", "--domain", str(graph.domain)]
    quiet: list[float] = []
    loud: list[float] = []
    refused = 0
    for _ in range(FLOODS):
        quiet += [took for _ in range(trials // FLOODS) if (took := once()) is not None]
        with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
            try:
                assert process.stdout is not None
                process.stdout.readline()  # the first refusal
                wanted = len(loud) + trials // FLOODS
                while len(loud) < wanted:
                    took = once()
                    refused += took is None
                    loud += [took] if took is not None else []
            finally:
                process.kill()
    ratio = statistics.median(loud) / statistics.median(quiet)
    return {
        "refused a second": FLOOD_HZ,
        "quiet": middle(quiet),
        "flood": middle(loud),
        "allowed, and refused": refused,
        "ratio": round(ratio, 2),
    }


def be_flood(domain: int) -> None:
    """Ask for goals that are outside every grant, until somebody kills this process."""
    planner = Peer("flood", domain)
    client = ActionClient(planner.node, Fibonacci, "/llm/fibonacci")
    client.wait_for_server(20)
    first = planner.answer(client.send_goal_async(Fibonacci.Goal(order=21)))
    assert not first.accepted
    print("refused", flush=True)
    while True:
        began = time.monotonic()
        client.send_goal_async(Fibonacci.Goal(order=21))
        while time.monotonic() - began < 1 / FLOOD_HZ:
            planner.executor.spin_once(timeout_sec=1 / FLOOD_HZ)


def acceptance(planner: Peer, name: str) -> Callable[[], float | None]:
    """Return what measures once how long a goal takes until it is accepted; None: it is not."""
    client = ActionClient(planner.node, Fibonacci, name)
    assert client.wait_for_server(20), name

    def once() -> float | None:
        begun = time.perf_counter()
        handle = planner.answer(client.send_goal_async(Fibonacci.Goal(order=3)))
        took = time.perf_counter() - begun
        if not handle.accepted:
            return None
        planner.answer(handle.get_result_async())
        return took

    return once


def goals(planner: Peer, trials: int) -> dict[str, float]:
    """Return how long a goal takes until it is accepted."""
    ways = {
        way: acceptance(planner, name)
        # not the mediated one: a goal that comes past the gate stops the robot
        for way, name in (("direct", "/beside"), ("gate", "/llm/fibonacci"))
    }

    def once(way: str) -> float:
        took = ways[way]()
        assert took is not None, way
        return took

    return compared(once, trials, *ways)


def services(planner: Peer, trials: int) -> dict[str, float]:
    """Return how long a service takes until it is answered."""
    clients = {}
    for way, name in (("direct", "/horn"), ("relay", "/relay/horn"), ("gate", "/llm/horn")):
        clients[way] = planner.node.create_client(Trigger, name)
        assert clients[way].wait_for_service(20), name

    def once(way: str) -> float:
        begun = time.perf_counter()
        answer = planner.answer(clients[way].call_async(Trigger.Request()))
        took = time.perf_counter() - begun
        assert answer.success, answer.message
        return took

    return compared(once, trials, *clients)


def velocities(robot: Process, planner: Peer, seconds: float) -> dict[str, float]:
    """Return how long a velocity takes to the base, fifty a second; and how many were lost."""
    found: dict[str, float] = {}
    for way, asked, told in (
        ("direct", "/beside", "/beside"),
        ("relay", "/relay/cmd_vel", "/relayed"),
        ("gate", "/llm/cmd_vel", "/cmd_vel"),
    ):
        publisher = planner.node.create_publisher(Twist, asked, 10)
        until(publisher.get_subscription_count, asked)
        sent = steered(publisher, lambda told=told: robot.heard(told), seconds)
        heard = robot.heard(told)
        took = [heard[n] - at for n, at in sent.items() if n in heard]
        found[way] = middle(took)
        found[f"{way}, slowest"] = round(1e3 * max(took), 3)
        found[f"{way}, lost"] = len(sent) - len(took)
    return {**found, "added": round(found["gate"] - found["direct"], 3)}


def steered(
    publisher: Any, heard: Callable[[], dict[int, float]], seconds: float
) -> dict[int, float]:
    """Publish a velocity every 20 ms, each another one; return when each was, once a lease runs."""
    message = Twist()
    message.linear.x = 0.1

    def publish(number: int) -> float:
        message.angular.z = number / 1e6
        at = time.monotonic()
        publisher.publish(message)
        return at

    def begun() -> bool:
        publish(1)
        time.sleep(0.02)
        return 1 in heard()

    until(begun, "the lease")
    sent: dict[int, float] = {}
    begin = time.monotonic()
    while time.monotonic() - begin < seconds:
        sent[2 + len(sent)] = publish(2 + len(sent))
        time.sleep(max(0.0, begin + 0.02 * len(sent) - time.monotonic()))
    time.sleep(LATE_MS / 1e3)  # what comes later than that is late at least
    with suppress(AssertionError):  # it counts as lost
        until(lambda: 1 + len(sent) in heard(), "the last one", seconds=2)
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


def compared(once: Callable[[str], float], trials: int, *ways: str) -> dict[str, float]:
    """Return the medians of several ways, asked in turns."""
    took: dict[str, list[float]] = {way: [] for way in ways}
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
