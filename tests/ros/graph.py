# SPDX-License-Identifier: Apache-2.0
"""A ROS graph of a test: a robot, a planner, and the node between them, which is a process.

Robot and planner are nodes of `rclpy` with an executor of their own each; what is asked of ROS is
asked on its thread. Every wait is for a condition, with a deadline.
"""

from __future__ import annotations

import asyncio
import itertools
import json
import os
import signal
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

with warnings.catch_warnings():  # its parser's own
    warnings.simplefilter("ignore")
    import rosidl_generator_py  # noqa: F401

import rclpy
from geometry_msgs.msg import Twist
from rclpy.action import ActionClient, ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.context import Context
from rclpy.exceptions import InvalidHandle
from rclpy.executors import Executor, MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future as RosFuture
from std_msgs.msg import UInt8
from std_srvs.srv import Empty, Trigger
from test_msgs.action import Fibonacci

from authguard_r.access.files import read_binding
from authguard_r.client.link import ProcessLog
from authguard_r.integrations.ros.map import parse_map
from authguard_r.integrations.ros.names import TypePart
from authguard_r.integrations.ros.nodes.heartbeat import steady
from authguard_r.integrations.ros.nodes.mediator import Mediator, MediatorTarget, mediating
from authguard_r.integrations.ros.nodes.values import load_type
from authguard_r.keys.trust import read_trust
from authguard_r.site.source import read_site
from fixtures import scenarios
from fixtures.gate_process import RunningGate, environment, module, until
from fixtures.ros_processes import TRANSPORT
from ros.hospital import HERE

#: Bound against hanging, in seconds; nothing is measured against it.
PATIENCE_S = 20.0
NODE = tuple(module("authguard_r.integrations.ros.nodes.node"))
_domains = itertools.count(1 + os.getpid() % 90)
SHORT_LEASE = (
    "<discovery_config><leaseDuration><sec>2</sec></leaseDuration><leaseAnnouncement>"
    "<sec>0</sec><nanosec>500000000</nanosec></leaseAnnouncement></discovery_config>"
)


class Peer:
    """A node with a thread of its own.

    Args:
        name: the node's.
        domain: where.
        is_quick: none of its callbacks waits for another.
    """

    def __init__(self, name: str, domain: int, *, is_quick: bool = False) -> None:
        self._context = Context()
        rclpy.init(
            args=[],
            context=self._context,
            domain_id=domain,
            signal_handler_options=SignalHandlerOptions.NO,
        )
        self.group = ReentrantCallbackGroup()
        self.node = Node(
            name, context=self._context, start_parameter_services=False, enable_rosout=False
        )
        self._executor: Executor = (
            SingleThreadedExecutor(context=self._context)
            if is_quick
            else MultiThreadedExecutor(4, context=self._context)
        )
        self._executor.add_node(self.node)
        self._is_closed = False
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except InvalidHandle:  # a callback that outlives the executor wakes what is gone
            if not self._is_closed:
                raise

    def ask(self, begin: Callable[[], Any]) -> Future[Any]:
        """Begin something of `rclpy` that has a future; return one of Python's."""
        found: Future[Any] = Future()

        def answered(future: Any) -> None:
            try:
                found.set_result(future.result())
            except Exception as error:  # noqa: BLE001
                found.set_exception(error)

        self._executor.create_task(lambda: begin().add_done_callback(answered))
        return found

    @property
    def is_alive(self) -> bool:
        """True while its thread spins."""
        return self._thread.is_alive()

    def close(self) -> None:
        """End it; a second time changes nothing."""
        if not self.is_alive:
            return
        self._is_closed = True
        self._executor.shutdown()
        self._thread.join(5)
        for action in tuple(self.node.waitables):  # the node would leave them there, and visible
            action.destroy()
        self.node.destroy_node()
        self._context.try_shutdown()


class Arm:
    """A robot's action server: goals run until they are told to end, or are canceled.

    Args:
        peer: its node.
        kind: the action's class.
        name: the action's.
    """

    def __init__(self, peer: Peer, kind: Any, name: str) -> None:
        self._peer, self._kind = peer, kind
        self._running: set[bytes] = set()  # by the goals' ids
        self.answers = threading.Event()  # whether it takes a goal
        self.end = threading.Event()
        self.forget()
        ActionServer(
            peer.node,
            kind,
            name,
            self._run,
            goal_callback=self._asked,
            cancel_callback=self._cancel,
            callback_group=peer.group,
            result_timeout=2,
        )

    def forget(self) -> None:
        """Begin anew: nothing runs, and every goal is taken."""
        self.goals: list[Any] = []
        self.canceled: list[bool] = []
        self.canceled_s = 0.0
        self.takes = True
        self.yields = True  # to a cancellation
        self.asked_to_cancel = 0
        self.answers.set()
        self.end.clear()
        self.abort = False
        self.feedback: list[Any] = []
        self.result: Any = self._kind.Result()
        #: what it says of a goal, and its result, where that depends on the goal
        self.each: Callable[[Any], tuple[Any, Any]] | None = None

    def rest(self) -> None:
        """End every goal that runs."""
        self.yields = True
        self.answers.set()
        self.end.set()
        until(lambda: not self._running, "the end of a robot's goals", seconds=PATIENCE_S)

    def _cancel(self, _: Any) -> CancelResponse:
        self.asked_to_cancel += 1
        return CancelResponse.ACCEPT if self.yields else CancelResponse.REJECT

    def _asked(self, goal: Any) -> GoalResponse:
        self.goals.append(goal)
        self.answers.wait(PATIENCE_S)
        return GoalResponse.ACCEPT if self.takes else GoalResponse.REJECT

    async def _run(self, handle: Any) -> Any:
        key = bytes(handle.goal_id.uuid)
        self._running.add(key)
        try:
            return await self._carried(handle)
        finally:
            self._running.discard(key)

    async def _carried(self, handle: Any) -> Any:
        feedbacks, result = self.feedback, self.result
        if self.each is not None:
            first, result = self.each(handle.request)
            feedbacks = [first]
        for feedback in feedbacks:
            handle.publish_feedback(feedback)
        await self._until(lambda: self.end.is_set() or handle.is_cancel_requested)
        if handle.is_cancel_requested and not self.end.is_set():
            handle.canceled()
            self.canceled_s = time.monotonic()
            self.canceled.append(True)
        else:
            (handle.abort if self.abort else handle.succeed)()
        return result

    async def _until(self, holds: Callable[[], bool]) -> None:
        """Wait without a thread: many goals run at once."""
        over: Any = RosFuture()
        timer = self._peer.node.create_timer(
            0.01, lambda: holds() and over.set_result(None), self._peer.group, steady()
        )
        await over
        timer.cancel()
        self._peer.node.destroy_timer(timer)


class Base:
    """A robot's wheels: every velocity that it was told.

    Args:
        peer: its node.
        kind: the message's class.
        name: the topic.
    """

    def __init__(self, peer: Peer, kind: Any, name: str) -> None:
        #: when it was told something, on the monotonic clock, and what
        self.heard: list[tuple[float, Any]] = []
        peer.node.create_subscription(kind, name, self._hear, 10, callback_group=peer.group)

    def _hear(self, message: Any) -> None:
        self.heard.append((time.monotonic(), message))

    def forget(self) -> None:
        """Forget what it was told."""
        self.heard = []

    @property
    def last_s(self) -> float:
        """When it was told anything last, on the monotonic clock."""
        return self.heard[-1][0]

    @property
    def speeds(self) -> list[float]:
        """Return how fast it was told to go ahead."""
        return [message.linear.x for _, message in tuple(self.heard)]


class Robot(Peer):
    """The hospital's courier: an arm, a horn, a lamp, wheels, and something to clear."""

    def __init__(self, domain: int) -> None:
        super().__init__("robot", domain)
        #: hears fifty velocities a second, and nothing else looks up each time
        self.wheels = Peer("wheels", domain, is_quick=True)
        self.arm = Arm(self, Fibonacci, "/fibonacci")
        self.chimes = Arm(self, Fibonacci, "/chimes")
        self.base = Base(self.wheels, Twist, "/cmd_vel")
        self.forget()
        node, group = self.node, self.group
        for name in ("horn", "hold"):
            called = partial(self._told, name)
            node.create_service(Trigger, f"/{name}", called, callback_group=group)
        for name in ("clear", "quiet"):
            called = partial(self._called, name)
            node.create_service(Empty, f"/{name}", called, callback_group=group)
        node.create_subscription(
            UInt8, "/lamp", lambda m: self.lamps.append(m.data), 10, callback_group=group
        )

    def close(self) -> None:
        self.wheels.close()
        super().close()

    def forget(self) -> None:
        """Begin anew: it was told nothing."""
        self.arm.forget()
        self.chimes.forget()
        self.base.forget()
        self.calls: list[str] = []
        self.lamps: list[int] = []
        self.says = "done"

    def rest(self) -> None:
        """End what runs."""
        self.arm.rest()
        self.chimes.rest()

    def _told(self, name: str, _: object, answer: Any) -> Any:
        self.calls.append(name)
        answer.success, answer.message = True, f"{name} {self.says}"
        return answer

    def _called(self, name: str, _: object, answer: Any) -> Any:
        self.calls.append(name)
        return answer


class Stick:
    """A planner's velocities, published fifty times a second from its first one on."""

    def __init__(self, peer: Planner, kind: Any, name: str) -> None:
        self._publisher = peer.publisher(kind, name)
        self.message: Any = None
        self.sent = 0
        peer.node.create_timer(0.02, self._send, callback_group=peer.group)

    def _send(self) -> None:
        if self.message is not None:
            self._publisher.publish(self.message)
            self.sent += 1


class Goal:
    """A planner's goal: its answer, feedback and result."""

    def __init__(self, peer: Peer, client: Any, goal: Any) -> None:
        self._peer = peer
        self.feedback: list[Any] = []
        self._asked = peer.ask(
            lambda: client.send_goal_async(
                goal, feedback_callback=lambda message: self.feedback.append(message.feedback)
            )
        )

    @property
    def handle(self) -> Any:
        return self._asked.result(PATIENCE_S)

    @property
    def accepted(self) -> bool:
        accepted: bool = self.handle.accepted
        return accepted

    def result(self) -> Any:
        """Return status and result."""
        return self._peer.ask(self.handle.get_result_async).result(PATIENCE_S)

    def cancel(self) -> Any:
        return self._peer.ask(self.handle.cancel_goal_async).result(PATIENCE_S)


class Client(ActionClient):  # type: ignore[misc]
    """A client that another thread may spin before it is whole: `rclpy` gives it its lock last."""

    _lock = threading.Lock()


class Planner(Peer):
    """Whoever asks.

    What it makes is returned once the other side knows of it: DDS drops a request of a client that
    its server has not found yet, though the client has found the server.
    """

    def client(self, kind: Any, name: str) -> Any:
        made = Client(self.node, kind, name, callback_group=self.group)
        until(made.server_is_ready, name, seconds=PATIENCE_S)
        self._become_known(name)
        return made

    def call(self, kind: Any, name: str, request: Any) -> Future[Any]:
        made = self.node.create_client(kind, name, callback_group=self.group)
        until(made.service_is_ready, name, seconds=PATIENCE_S)
        self._become_known(name)
        return self.ask(lambda: made.call_async(request))

    def publisher(self, kind: Any, name: str, depth: int = 10) -> Any:
        made = self.node.create_publisher(kind, name, depth, callback_group=self.group)
        until(made.get_subscription_count, name, seconds=PATIENCE_S)
        self._become_known(name)
        return made

    def _become_known(self, name: str) -> None:
        """Wait until an action's server on the same side answers what is asked of no goal.

        A side finds what another has made in the order in which it was made, and this comes last.
        """
        side = "/llm/" if name.startswith("/llm/") else name
        for found, types in self.node.get_service_names_and_types():
            action, is_one, _ = found.rpartition("/_action/get_result")
            if is_one and action.startswith(side):
                kind = load_type(types[0].removesuffix("_GetResult"), TypePart.ACTION)
                return self._ask_of_nothing(kind.Impl.GetResultService, found)
        return None

    def _ask_of_nothing(self, kind: Any, name: str) -> None:
        client = self.node.create_client(kind, name, callback_group=self.group)

        def is_answered() -> bool:
            try:
                return self.ask(lambda: client.call_async(kind.Request())).result(0.5) is not None
            except TimeoutError:
                return False

        until(is_answered, f"an answer of `{name}`", seconds=PATIENCE_S)


class Graph:
    """All of it.

    Args:
        folder: for the map.
        gate: whose node it is.
        domain: where.
    """

    def __init__(self, folder: Path, gate: RunningGate, domain: int) -> None:
        self.domain = domain
        self.folder, self._gate = folder, gate
        self.planners: list[Planner] = []
        self._peers: list[Peer] = []
        self._others: list[subprocess.Popen[str]] = []
        self.process: subprocess.Popen[str] | None = None
        self._said_before = 0
        self.mediator: Mediator  # of a node `inside`
        self.robot: Robot = self.add(Robot(domain))

    def add(self, peer: Any) -> Any:
        self._peers.append(peer)
        return peer

    def planner(self, name: str = "planner") -> Planner:
        planner: Planner = self.add(Planner(name, self.domain))
        self.planners.append(planner)
        return planner

    def start(
        self,
        source: Path = HERE / "map.yaml",
        command: Sequence[str] = NODE,
        *,
        managed: bool = False,
        **files: Path,
    ) -> None:
        """Start the node, and wait for it; the robot's own side has to be there.

        Args:
            source: its map, in the domain 1.
            command: what starts it, without its words.
            managed: it waits for whoever configures it.
            files: by the node's own words, what is not the gate's.
        """
        more = ["--managed"] if managed else []
        self.launch(*more, source=source, command=command, **files)
        assert self.process is not None
        assert self.process.stdout is not None
        said = self.process.stdout.readline()
        assert "ready" in said, self.said()
        self.missing: list[str] = json.loads(said)["missing"]

    def launch(
        self,
        *more: str,
        source: Path = HERE / "map.yaml",
        command: Sequence[str] = NODE,
        **files: Path,
    ) -> None:
        """Start the node."""
        gate = self._gate
        path = self.folder / "map.yaml"
        path.write_text(self._map(source))
        given = {"map": path, "run": gate.run, "site": gate.site, "trust": gate.trust}
        given |= {"binding": gate.binding, **files}
        words = [str(word) for name, value in given.items() for word in (f"--{name}", value)]
        self._errors = (self.folder / "node.err").open("w")
        self._said_before = 0
        self.process = subprocess.Popen(
            [*command, "--demo", *words, *more],
            stdout=subprocess.PIPE,
            stderr=self._errors,
            text=True,
            env=environment(measured=command is not NODE),
            cwd=scenarios.ROOT,
        )

    def ended(self) -> int:
        """Wait until the node ended by itself; return its exit code."""
        assert self.process is not None
        return self.process.wait(PATIENCE_S)

    def place(self) -> MediatorTarget:
        """Return where a node of this process stands."""
        gate, site = self._gate, read_site(self._gate.site)
        return MediatorTarget(
            ros=parse_map(self._map(HERE / "map.yaml"), where="map"),
            run=gate.run,
            site=site,
            binding=read_binding(str(gate.binding), site),
            trust=lambda: read_trust(gate.trust),
        )

    @contextmanager
    def inside(self) -> Iterator[asyncio.AbstractEventLoop]:
        """Yield the event loop of a node in a thread of this process."""
        begun, over = Future[asyncio.AbstractEventLoop](), asyncio.Event()
        place = self.place()

        async def live() -> None:
            async with mediating(place, ProcessLog()) as self.mediator:
                begun.set_result(asyncio.get_running_loop())
                await over.wait()

        thread = threading.Thread(target=lambda: asyncio.run(live()), daemon=True)
        thread.start()
        loop = begun.result(PATIENCE_S)
        try:
            yield loop
        finally:
            loop.call_soon_threadsafe(over.set)
            thread.join(PATIENCE_S)

    def _map(self, source: Path) -> str:
        return source.read_text().replace("domain: 1", f"domain: {self.domain}")

    def robot_process(self) -> subprocess.Popen[str]:
        """Return a robot that is a process, in the place of the one that is none."""
        self.robot.close()
        return self._other()

    def planner_process(self, order: int) -> subprocess.Popen[str]:
        """Return a planner that is a process, once its goal runs."""
        return self._other(order)

    def _other(self, *order: int) -> subprocess.Popen[str]:
        """Start this module as a process, and wait until it is ready."""
        words = [sys.executable, "-m", "ros.graph", *map(str, (self.domain, *order))]
        env = {
            **environment(measured=False),
            "PYTHONPATH": os.pathsep.join(sys.path),
            "FASTDDS_DEFAULT_PROFILES_FILE": str(self._short_lease()),
        }
        process = subprocess.Popen(
            words, stdout=subprocess.PIPE, text=True, env=env, cwd=scenarios.ROOT
        )
        self._others.append(process)
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        return process

    def _short_lease(self) -> Path:
        """Return the deployed profile, but others take its process for gone after two seconds."""
        text = Path(TRANSPORT["FASTDDS_DEFAULT_PROFILES_FILE"]).read_text(encoding="utf-8")
        path = self.folder / "short-lease.xml"
        path.write_text(text.replace("<builtin>", f"<builtin>{SHORT_LEASE}", 1), encoding="utf-8")
        return path

    def terminate(self) -> int:
        """End the node as a service manager does; return its exit code."""
        assert self.process is not None
        self.process.terminate()
        return self.process.wait(PATIENCE_S)

    def signal(self, sign: signal.Signals) -> float:
        """Send the node a signal; return when, on the monotonic clock."""
        assert self.process is not None
        self.process.send_signal(sign)
        return time.monotonic()

    def kill(self) -> None:
        """Kill the node as a crash would."""
        assert self.process is not None
        assert self.process.stdout is not None
        self.process.kill()
        self.process.wait()
        self.process.stdout.close()
        self._errors.close()

    def said(self) -> str:
        """Return what the node wrote to standard error since `forget`."""
        return (self.folder / "node.err").read_text()[self._said_before :]

    @property
    def is_alive(self) -> bool:
        """True while the node runs as a process."""
        return self.process is not None and self.process.poll() is None

    def rest(self) -> None:
        """End what the robot does, and the planners."""
        self.robot.rest()
        for planner in self.planners:
            planner.close()
            self._peers.remove(planner)
        self.planners.clear()

    def forget(self) -> None:
        """Begin anew: nobody has said anything yet."""
        self.robot.forget()
        if self.process is not None:
            self._said_before += len(self.said())

    def end_node(self) -> None:
        """End the node, if it was started and runs still."""
        if self.process is None:
            return
        self.process.terminate()
        try:
            self.process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        if self.process.stdout is not None:
            self.process.stdout.close()
        self._errors.close()

    def end(self) -> None:
        """End everything that was started."""
        self.end_node()
        for other in self._others:
            other.kill()
            other.wait()
            if other.stdout is not None:
                other.stdout.close()
        for peer in reversed(self._peers):
            peer.close()


def next_domain() -> int:
    """Return a domain that no test before had."""
    return next(_domains) % 101 + 1


@contextmanager
def graph_of(folder: Path, gate: RunningGate) -> Iterator[Graph]:
    """Yield a graph with a robot in it; print at its end what its node and the gate said."""
    made = Graph(folder, gate, next_domain())
    with shown(made, gate):
        try:
            yield made
        finally:
            made.end()


@contextmanager
def shown(graph: Graph, gate: RunningGate) -> Iterator[None]:
    """Print at the end what a node and its gate said; pytest shows it when the test fails."""
    try:
        yield
    finally:
        if graph.process is not None:
            print(graph.said())
            if gate.alive:
                print([(one.kind, one.decision, one.reasons) for one in gate.news()[-20:]])


def main() -> None:
    """Be a robot, or a planner of one goal, until somebody kills it."""
    domain, *order = map(int, sys.argv[1:])
    if order:
        planner = Planner("planner", domain)
        client = planner.client(Fibonacci, "/llm/fibonacci")
        assert Goal(planner, client, Fibonacci.Goal(order=order[0])).accepted
    else:
        Robot(domain)
    print("ready", flush=True)
    threading.Event().wait()


if __name__ == "__main__":
    main()
