# SPDX-License-Identifier: Apache-2.0
"""A node that ROS manages: checked first, then there, then served; locked, and ended in order.

Real nodes, a real gate. Source: issue 9, "Lifecycle". Spec page: docs/spec/ros.md#lifecycle
"""

from __future__ import annotations

import asyncio
import gc
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2 (tests/ros/make.sh makes an environment)")

import msgspec
import yaml
from action_msgs.msg import GoalStatus
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.action import ActionClient
from rosgraph_msgs.msg import Clock
from test_msgs.action import Fibonacci

from authguard_r.client.link import ProcessLog
from authguard_r.core.errors import AuthGuardError, EnvironmentFault
from authguard_r.core.reasons import Reason
from authguard_r.integrations.ros.map import parse_map
from authguard_r.integrations.ros.nodes import node, process
from authguard_r.integrations.ros.nodes.mediator import MediatorTarget, mediating
from authguard_r.integrations.ros.nodes.process import require_bench, ros_context
from authguard_r.integrations.tools.endpoints import first_of
from authguard_r.keys.trust import read_trust
from authguard_r.wire.messages import ClientRole
from fixtures import scenarios
from fixtures.gate_process import RunningGate, until
from fixtures.ros_processes import TRANSPORT
from ros.graph import PATIENCE_S, Goal, Graph, Planner, graph_of
from ros.hospital import HERE, SHOWN, hospital
from ros.shared_graph import SharedGate, SharedGraph
from unit.keys.chains import house

NODE = "/authguard/gate"


class Manager:
    """Whoever configures and activates nodes.

    Args:
        graph: where.
    """

    def __init__(self, graph: Graph) -> None:
        self._peer: Planner = graph.add(Planner("manager", graph.domain))
        kinds = {
            "change_state": ChangeState,
            "get_parameters": GetParameters,
            "set_parameters": SetParameters,
            "get_state": GetState,
        }
        make = self._peer.node.create_client
        self._clients = {
            name: make(kind, f"{NODE}/{name}", callback_group=self._peer.group)
            for name, kind in kinds.items()
        }
        for name, client in self._clients.items():
            until(client.service_is_ready, name, seconds=PATIENCE_S)
        until(self._is_known, "an answer to the last of them", seconds=PATIENCE_S)

    def _ask(self, name: str, request: Any, *, within_s: float = PATIENCE_S) -> Any:
        return self._peer.ask(lambda: self._clients[name].call_async(request)).result(within_s)

    def _is_known(self) -> bool:
        """Return whether it is answered: DDS drops what comes before the node has found it."""
        try:
            return self._ask("get_state", GetState.Request(), within_s=1) is not None
        except TimeoutError:
            return False

    def state(self) -> int:
        number: int = self._ask("get_state", GetState.Request()).current_state.id
        return number

    def to(self, transition: int) -> bool:
        """Ask for a transition; return whether it was carried out."""
        request = ChangeState.Request(transition=Transition(id=transition))
        done: bool = self._ask("change_state", request, within_s=60).success
        return done

    def begin(self) -> None:
        """Have it configured and active."""
        assert self.to(Transition.TRANSITION_CONFIGURE)
        assert self.to(Transition.TRANSITION_ACTIVATE)

    def end(self) -> None:
        """Have it unconfigured, whatever it is."""
        if self.state() == State.PRIMARY_STATE_ACTIVE:
            assert self.to(Transition.TRANSITION_DEACTIVATE)
        if self.state() == State.PRIMARY_STATE_INACTIVE:
            assert self.to(Transition.TRANSITION_CLEANUP)

    def get(self, *names: str) -> list[str]:
        said = self._ask("get_parameters", GetParameters.Request(names=list(names)))
        return [value.string_value for value in said.values]

    def set(self, name: str, value: ParameterValue) -> Any:
        request = SetParameters.Request(parameters=[Parameter(name=name, value=value)])
        return self._ask("set_parameters", request).results[0]

    def close(self) -> None:
        self._peer.close()


@pytest.fixture(scope="module")
def files(gate: RunningGate, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """What the node reads anew each time that it is configured: the gate's own, in copies."""
    folder = tmp_path_factory.mktemp("files")
    made = {"site": folder / "site.yaml", "binding": folder / "binding.yaml"}
    shutil.copy(gate.site, made["site"])
    shutil.copy(gate.binding, made["binding"])
    return made


@pytest.fixture(scope="module")
def shared_graph(
    shared_gate: SharedGate, files: dict[str, Path], tmp_path_factory: pytest.TempPathFactory
) -> Iterator[SharedGraph]:
    """A graph whose node every test finds unconfigured."""

    def start(graph: Graph) -> None:
        graph.start(managed=True, **files)

    folder = tmp_path_factory.mktemp("graph")
    made = SharedGraph(shared_gate, folder, start, lambda _: True)
    yield made
    made.end()


@pytest.fixture
def manager(graph: Graph) -> Iterator[Manager]:
    made = Manager(graph)
    yield made
    if graph.is_alive:
        made.end()
    made.close()


def goal(graph: Graph, order: int = 3, name: str = "planner") -> Goal:
    planner = graph.planner(name)
    return Goal(planner, planner.client(Fibonacci, "/llm/fibonacci"), Fibonacci.Goal(order=order))


def is_served(planner: Planner) -> bool:
    """True while somebody serves the planners' action."""
    return any(name == "/llm/fibonacci/_action/status" for name, _ in topics(planner))


def topics(planner: Planner) -> list[tuple[str, list[str]]]:
    return [
        (name, kinds)
        for name, kinds in planner.node.get_topic_names_and_types()
        if planner.node.count_publishers(name)
    ]


@pytest.mark.smoke
def test_nothing_is_served_before_it_is_configured_and_active(
    graph: Graph, manager: Manager
) -> None:
    planner = graph.planner()
    assert manager.state() == State.PRIMARY_STATE_UNCONFIGURED
    assert not is_served(planner)
    assert manager.to(Transition.TRANSITION_CONFIGURE)
    assert manager.state() == State.PRIMARY_STATE_INACTIVE
    assert not is_served(planner)
    assert manager.to(Transition.TRANSITION_ACTIVATE)
    assert manager.state() == State.PRIMARY_STATE_ACTIVE
    sent = goal(graph, name="asks")
    assert sent.accepted
    graph.robot.arm.end.set()
    assert sent.result().status == GoalStatus.STATUS_SUCCEEDED


def test_what_runs_is_canceled_when_it_is_configured(graph: Graph, manager: Manager) -> None:
    """Somebody sent a goal past the node, before it was there."""
    stray = graph.planner("stray")
    client = stray.client(Fibonacci, "/fibonacci")
    running = Goal(stray, client, Fibonacci.Goal(order=9))
    assert running.accepted
    assert graph.robot.arm.canceled == []
    assert manager.to(Transition.TRANSITION_CONFIGURE)
    assert graph.robot.arm.canceled == [True]


def test_deactivating_stops_the_robot_and_tells_the_planner(graph: Graph, manager: Manager) -> None:
    manager.begin()
    sent = goal(graph)
    assert sent.accepted
    result = graph.planners[-1].ask(sent.handle.get_result_async)
    assert manager.to(Transition.TRANSITION_DEACTIVATE)
    assert graph.robot.arm.canceled == [True]
    assert result.result(PATIENCE_S).status == GoalStatus.STATUS_ABORTED
    looks = graph.planner("looks")
    until(lambda: not is_served(looks), "it is served no more")
    assert manager.to(Transition.TRANSITION_ACTIVATE)
    graph.robot.arm.end.set()
    assert goal(graph, name="again").accepted


def test_nothing_runs_on_when_it_is_deactivated_under_a_planner_that_never_stops_asking(
    graph: Graph, manager: Manager
) -> None:
    arm = graph.robot.arm
    manager.begin()
    planner = graph.planner()
    client = planner.client(Fibonacci, "/llm/fibonacci")
    peer, asked = planner.node, []

    def ask() -> None:
        asked.append(client.send_goal_async(Fibonacci.Goal(order=3)))

    peer.create_timer(0.01, ask, callback_group=planner.group)
    until(lambda: arm.goals, "a goal runs")
    assert manager.to(Transition.TRANSITION_DEACTIVATE)
    taken = len(arm.goals)
    until(lambda: len(arm.canceled) == taken, "every goal that the robot took was canceled")
    more = len(asked) + 100
    until(lambda: len(asked) > more, "it goes on asking", seconds=PATIENCE_S)
    assert len(arm.goals) == taken


def test_a_transition_that_its_state_has_not_changes_nothing(manager: Manager) -> None:
    assert not manager.to(Transition.TRANSITION_ACTIVATE)
    assert manager.state() == State.PRIMARY_STATE_UNCONFIGURED


def test_an_action_client_of_before_finds_a_node_that_was_configured_anew(
    graph: Graph, manager: Manager
) -> None:
    planner = graph.planner()
    client = ActionClient(planner.node, Fibonacci, "/llm/fibonacci", callback_group=planner.group)
    manager.begin()
    until(client.server_is_ready, "the server", seconds=PATIENCE_S)
    manager.end()
    until(lambda: not client.server_is_ready(), "the server's end", seconds=PATIENCE_S)
    manager.begin()
    until(client.server_is_ready, "the next server", seconds=PATIENCE_S)
    graph.robot.arm.end.set()
    sent = Goal(planner, client, Fibonacci.Goal(order=3))
    assert sent.accepted
    assert sent.result().status == GoalStatus.STATUS_SUCCEEDED


def changed(text: str, *path: str, to: Any) -> str:
    """Return a file in YAML with another value somewhere."""
    plain = yaml.safe_load(text)
    *parents, last = path
    at: Any = plain
    for name in parents:
        at = at[int(name) if isinstance(at, list) else name]
    at[int(last) if isinstance(at, list) else last] = to
    return yaml.safe_dump(plain)


def with_siren(text: str, kind: str, type_: str) -> str:
    """Return a map with a name that no way of the binding means."""
    where = {"public": "/llm/siren", "private": "/siren", "by": "/robot"}
    return changed(text, "mediated", f"{kind}-siren", to={"kind": kind, "type": type_, **where})


def another_robots(text: str) -> str:
    """Return the map of another robot of the site; the gate's certificate names the courier."""
    horn = {"horn": yaml.safe_load(text)["mediated"]["horn"]}
    return changed(changed(text, "mediated", to=horn), "robot", to=scenarios.OTHER)


CUP = {"kind": "part", "home": "dock", "mass_g": 2, "names": ["cup"]}
#: What is changed of which file, and what the node says of it.
WRONG: dict[str, tuple[str, Callable[[str], str], tuple[str, ...]]] = {
    # a goal would count as done that the gate waits for
    "another `succeeds` than the gate's binding": (
        "binding",
        lambda t: changed(t, "tools", "call_service", "0", "succeeds", to={"success": False}),
        ("SITE_MISMATCH", "welcome.binding"),
    ),
    # a zone with another bound, say: what the node rebuilds is held to the gate's
    "another site than the gate's": (
        "site",
        lambda t: changed(t, "objects", "cup", to=CUP),
        ("SITE_MISMATCH",),
    ),
    "another robot's map": ("map", another_robots, ("ROBOT_MISMATCH",)),
    # what is mediated and cannot be decided would be a way that nobody signed for
    "a service of no way (L16)": (
        "map",
        lambda t: with_siren(t, "service", "std_srvs/srv/Trigger"),
        ("mediated.service-siren",),
    ),
    "an action of no way (L16)": (
        "map",
        lambda t: with_siren(t, "action", "test_msgs/action/Fibonacci"),
        ("mediated.action-siren",),
    ),
    "a stream of no way (L16)": (
        "map",
        lambda t: with_siren(t, "stream", "geometry_msgs/msg/Twist"),
        ("mediated.stream-siren",),
    ),
    "a channel that the site does not have": (
        "map",
        lambda t: t + SHOWN.replace("channel: ocr", "channel: rumor"),
        ("map.shown.sign.channel",),
    ),
}


@pytest.mark.smoke
def test_l16_what_does_not_fit_the_gate_is_not_configured_and_is_said(
    graph: Graph, manager: Manager, files: dict[str, Path]
) -> None:
    paths = {**files, "map": graph.folder / "map.yaml"}
    for what, (name, change, words) in WRONG.items():
        right = paths[name].read_text()
        before = len(graph.said())
        paths[name].write_text(change(right))
        try:
            assert not manager.to(Transition.TRANSITION_CONFIGURE), what
        finally:
            paths[name].write_text(right)
        assert manager.state() == State.PRIMARY_STATE_UNCONFIGURED, what
        said = graph.said()[before:]
        assert all(word in said for word in words), (what, said)
    # mended, without a new process
    assert manager.to(Transition.TRANSITION_CONFIGURE)


def test_parameters_tell_and_nobody_sets_one(manager: Manager) -> None:
    manager.begin()
    assert manager.get("robot", "security") == ["courier-1", "none"]
    truth = ParameterValue(type=ParameterType.PARAMETER_BOOL, bool_value=True)
    text = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value="other")
    for name, value in (("use_sim_time", truth), ("robot", text), ("security", text)):
        said = manager.set(name, value)
        assert not said.successful, name
        assert said.reason, name


def test_a_clock_that_somebody_publishes_is_nobodys(graph: Graph, manager: Manager) -> None:
    """It jumps back and stands: leases go by the monotonic clock, and a goal runs to its end."""
    manager.begin()
    liar = graph.planner("liar")
    clock = liar.node.create_publisher(Clock, "/clock", 10)
    sent = goal(graph)
    assert sent.accepted
    for seconds in (2_000_000_000, 5, 5):
        message = Clock()
        message.clock.sec = seconds
        clock.publish(message)
    graph.robot.arm.end.set()
    assert sent.result().status == GoalStatus.STATUS_SUCCEEDED
    assert clock.get_subscription_count() == 0


def test_it_is_cleaned_up_configured_anew_and_shut_down(graph: Graph, manager: Manager) -> None:
    for transition in (
        Transition.TRANSITION_CONFIGURE,
        Transition.TRANSITION_CLEANUP,
        Transition.TRANSITION_CONFIGURE,
        Transition.TRANSITION_ACTIVATE,
    ):
        assert manager.to(transition)
    sent = goal(graph)
    assert sent.accepted
    assert manager.to(Transition.TRANSITION_ACTIVE_SHUTDOWN)
    assert graph.robot.arm.canceled == [True]
    assert graph.ended() == 0


def test_a_node_whose_own_thread_ends_is_over_with_everything_that_it_serves(
    graph: Graph, manager: Manager
) -> None:
    """`rclpy` ends it on a type of parameter that there is not."""
    manager.begin()
    sent = goal(graph)
    assert sent.accepted
    request = SetParameters.Request(
        parameters=[Parameter(name="robot", value=ParameterValue(type=200))]
    )
    graph.planner("odd").call(SetParameters, f"{NODE}/set_parameters", request)
    assert graph.ended() == 1
    assert "has stopped spinning" in graph.said()
    assert "Traceback" not in graph.said()
    assert graph.robot.arm.canceled == [True]


# processes of a test's own


def test_by_itself_it_ends_when_it_cannot_be_configured(fresh: Graph) -> None:
    name, change, _ = WRONG["another `succeeds` than the gate's binding"]
    assert name == "binding"
    other = fresh.folder / "other.yaml"
    other.write_text(change((HERE / "binding.yaml").read_text()))
    fresh.launch(binding=other)
    assert fresh.ended() == 1
    assert "SITE_MISMATCH" in fresh.said()


def test_a_node_that_is_still_being_configured_ends_when_it_is_told_to(
    fresh: Graph, tmp_path: Path
) -> None:
    (tmp_path / "nobody").mkdir()
    fresh.launch(run=tmp_path / "nobody")
    names = fresh.planner("looks").node.get_node_names
    until(lambda: "gate_robot" in names(), "the robot's side")
    assert fresh.terminate() == 0
    assert "Traceback" not in fresh.said()


# without a process


def refused(place: MediatorTarget) -> AuthGuardError:
    """Return why a node of this process is not configured."""

    async def serve() -> None:
        async with mediating(place, ProcessLog()):
            pass

    with pytest.raises((AuthGuardError, BaseExceptionGroup)) as failed:
        asyncio.run(serve())
    gc.collect()  # a connection that is still open is a warning, and so an error, of this test
    error = failed.value
    found = error if isinstance(error, AuthGuardError) else first_of(error)
    assert isinstance(found, AuthGuardError)
    return found


def test_a_gate_that_does_not_come_is_no_configuration(fresh: Graph, tmp_path: Path) -> None:
    (tmp_path / "nobody").mkdir()
    place = msgspec.structs.replace(fresh.place(), run=tmp_path / "nobody" / "there")
    assert isinstance(refused(place), EnvironmentFault)


def test_a_gate_whose_store_was_put_back_is_no_configuration(tmp_path: Path) -> None:
    with hospital() as gate:
        counter, copy = gate.folder / "other" / "counter", gate.folder / "copy.db"
        counter.parent.mkdir()

        def started() -> None:
            assert gate.stop_process("gate") == 0
            gate.start_gate("--counter", str(counter))

        started()
        shutil.copy(gate.store, copy)
        with gate.client(ClientRole.PLANNER) as planner:
            planner.propose(b"this is no plan")
        started()  # its note has the refusal
        assert gate.stop_process("gate") == 0
        shutil.copy(copy, gate.store)
        gate.start_gate("--counter", str(counter))
        with graph_of(tmp_path, gate) as graph:
            assert refused(graph.place()).reason is Reason.ROLLED_BACK


def test_words_of_ros_are_none_of_its_own(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    right = ["--demo", *(f"--{name}=x" for name in ("map", "run", "site", "trust", "binding"))]
    for words in (
        ("--ros-args", "-p", "use_sim_time:=true"),
        ("--ros-args", "-r", "/fibonacci:=/elsewhere"),
        ("use_sim_time:=true",),
    ):
        monkeypatch.setattr(sys, "argv", ["node", *right, *words])
        with pytest.raises(SystemExit) as ended:
            node.main()
        assert ended.value.code == 2, words
        assert "unrecognized arguments" in capsys.readouterr().err, words


def test_a_bench_is_no_place_for_a_root_in_earnest() -> None:
    require_bench(read_trust(scenarios.trust_folder()), demo=True)
    require_bench(house().trust(), demo=False)
    with pytest.raises(EnvironmentFault, match="--demo"):
        require_bench(house().trust(), demo=True)


def test_a_bench_is_no_place_where_dds_security_is_spoken_of(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A node without it would stand beside a dead-man that cannot start."""
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "false")
    with pytest.raises(EnvironmentFault, match="ROS_SECURITY_ENABLE"):
        require_bench(read_trust(scenarios.trust_folder()), demo=True)
    require_bench(read_trust(scenarios.trust_folder()), demo=False)


def test_a_middleware_that_keeps_to_no_keystore_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Where no variable names one, ROS takes what is installed."""
    ros = parse_map((HERE / "map.yaml").read_text(), where="map")
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    monkeypatch.setattr(process, "get_rmw_implementation_identifier", lambda: "rmw_zenoh_cpp")
    with pytest.raises(EnvironmentFault, match="rmw_zenoh_cpp"), ros_context(ros, "/x"):
        pass


def test_a_robots_processes_share_no_memory_with_the_profile_that_is_deployed() -> None:
    """A node that is killed while it holds a lock there would stop the robot seconds late."""
    program = (
        "import sys; from pathlib import Path;"
        "from authguard_r.integrations.ros import made_node, read_map\n"
        "with made_node('alone', read_map(Path(sys.argv[1])), '/x'):\n"
        "    print('/dev/shm/fastdds_' in Path('/proc/self/maps').read_text())"
    )
    without = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    # the range wins: this setting is not enough
    builtin = without | {"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"}
    told: list[str] = []
    for more in (TRANSPORT, without, builtin):
        env = {k: v for k, v in os.environ.items() if not k.startswith("FASTDDS_")} | more
        words = [sys.executable, "-c", program, str(HERE / "map.yaml")]
        done = subprocess.run(words, capture_output=True, text=True, env=env, check=True)
        told.append(done.stdout.strip())
    assert told == ["False", "True", "True"]
