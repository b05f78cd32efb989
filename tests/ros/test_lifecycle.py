# SPDX-License-Identifier: Apache-2.0
"""A node that ROS manages: checked first, then there, then served; locked, and ended in order.

Real nodes, a real gate. Source: issue 9, "Lifecycle". Spec page: docs/spec/ros.md#lifecycle
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2 (tests/ros/make.sh makes an environment)")

import yaml
from action_msgs.msg import GoalStatus
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.action import ActionClient
from rosgraph_msgs.msg import Clock
from test_msgs.action import Fibonacci

from authguard_r.core.errors import EnvironmentFault
from authguard_r.keys.trust import read_trust
from authguard_r.ros.map import parse_map
from authguard_r.ros.nodes import process
from authguard_r.ros.nodes.process import require_bench, ros_context
from authguard_r.wire.messages import ClientRole
from fixtures import scenarios
from fixtures.gate_process import RunningGate, until
from ros.graph import PATIENCE_S, Goal, Graph, Planner, graph_of
from ros.hospital import HERE
from unit.keys.chains import house

NODE = "/authguard/gate"


class Manager:
    """Whoever configures and activates nodes.

    Args:
        graph: where.
    """

    def __init__(self, graph: Graph) -> None:
        self._peer: Planner = graph.planner("manager")

    def state(self) -> int:
        said = self._peer.call(GetState, f"{NODE}/get_state", GetState.Request())
        number: int = said.result(PATIENCE_S).current_state.id
        return number

    def to(self, transition: int) -> bool:
        """Ask for a transition; return whether it was carried out."""
        request = ChangeState.Request(transition=Transition(id=transition))
        said = self._peer.call(ChangeState, f"{NODE}/change_state", request)
        done: bool = said.result(60).success
        return done

    def get(self, *names: str) -> list[str]:
        request = GetParameters.Request(names=list(names))
        said = self._peer.call(GetParameters, f"{NODE}/get_parameters", request)
        return [value.string_value for value in said.result(PATIENCE_S).values]

    def set(self, name: str, value: ParameterValue) -> Any:
        request = SetParameters.Request(parameters=[Parameter(name=name, value=value)])
        said = self._peer.call(SetParameters, f"{NODE}/set_parameters", request)
        return said.result(PATIENCE_S).results[0]


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


def test_nothing_is_served_before_it_is_configured_and_active(graph: Graph) -> None:
    graph.start(managed=True)
    manager, planner = Manager(graph), graph.planner()
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


def test_what_runs_is_canceled_when_it_is_configured(graph: Graph) -> None:
    """Somebody sent a goal past the node, before it was there."""
    stray = graph.planner("stray")
    client = stray.client(Fibonacci, "/fibonacci")
    running = Goal(stray, client, Fibonacci.Goal(order=9))
    assert running.accepted
    graph.start(managed=True)
    assert graph.robot.arm.canceled == []
    assert Manager(graph).to(Transition.TRANSITION_CONFIGURE)
    assert graph.robot.arm.canceled == [True]


def test_deactivating_stops_the_robot_and_tells_the_planner(graph: Graph) -> None:
    graph.start(managed=True)
    manager = Manager(graph)
    assert manager.to(Transition.TRANSITION_CONFIGURE)
    assert manager.to(Transition.TRANSITION_ACTIVATE)
    sent = goal(graph)
    assert sent.accepted
    result = graph.planners[-1].ask(sent.handle.get_result_async)
    assert manager.to(Transition.TRANSITION_DEACTIVATE)
    assert graph.robot.arm.canceled == [True]
    assert result.result(PATIENCE_S).status == GoalStatus.STATUS_ABORTED
    until(lambda: not is_served(graph.planner("looks")), "it is served no more")
    assert manager.to(Transition.TRANSITION_ACTIVATE)
    graph.robot.arm.end.set()
    assert goal(graph, name="again").accepted


def test_nothing_runs_on_when_it_is_deactivated_under_a_planner_that_never_stops_asking(
    graph: Graph,
) -> None:
    graph.start(managed=True)
    manager, arm = Manager(graph), graph.robot.arm
    assert manager.to(Transition.TRANSITION_CONFIGURE)
    assert manager.to(Transition.TRANSITION_ACTIVATE)
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


def test_it_is_cleaned_up_configured_anew_and_shut_down(graph: Graph) -> None:
    graph.start(managed=True)
    manager = Manager(graph)
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


def test_a_transition_that_its_state_has_not_changes_nothing(graph: Graph) -> None:
    graph.start(managed=True)
    manager = Manager(graph)
    assert not manager.to(Transition.TRANSITION_ACTIVATE)
    assert manager.state() == State.PRIMARY_STATE_UNCONFIGURED


def other_binding(graph: Graph) -> None:
    """Another `succeeds` than the gate's: a goal would count as done that the gate waits for."""
    plain = yaml.safe_load((HERE / "binding.yaml").read_text())
    plain["tools"]["call_service"][0]["succeeds"] = {"success": False}
    (graph.folder / "other.yaml").write_text(yaml.safe_dump(plain))


def test_a_binding_that_is_not_the_gates_is_not_configured_and_says_so(graph: Graph) -> None:
    other_binding(graph)
    graph.start(managed=True, binding=graph.folder / "other.yaml")
    manager = Manager(graph)
    assert not manager.to(Transition.TRANSITION_CONFIGURE)
    assert manager.state() == State.PRIMARY_STATE_UNCONFIGURED
    assert "SITE_MISMATCH" in graph.said()
    assert "welcome.binding" in graph.said()
    # mended, without a new process
    (graph.folder / "other.yaml").write_text((HERE / "binding.yaml").read_text())
    assert manager.to(Transition.TRANSITION_CONFIGURE)


def test_by_itself_it_ends_when_it_cannot_be_configured(graph: Graph) -> None:
    other_binding(graph)
    graph.launch(binding=graph.folder / "other.yaml")
    assert graph.ended() == 1
    assert "SITE_MISMATCH" in graph.said()


def test_a_gate_whose_store_was_put_back_is_no_configuration(
    tmp_path: Path, mortal: RunningGate
) -> None:
    counter, copy = mortal.folder / "other" / "counter", mortal.folder / "copy.db"
    counter.parent.mkdir()

    def started() -> None:
        assert mortal.stop_process("gate") == 0
        mortal.start_gate("--counter", str(counter))

    started()
    shutil.copy(mortal.store, copy)
    with mortal.client(ClientRole.PLANNER) as planner:
        planner.propose(b"this is no plan")
    started()  # its note has the refusal
    assert mortal.stop_process("gate") == 0
    shutil.copy(copy, mortal.store)
    mortal.start_gate("--counter", str(counter))
    with graph_of(tmp_path, mortal) as graph:
        graph.launch()
        assert graph.ended() == 1
        assert "ROLLED_BACK" in graph.said()


def test_another_robots_gate_is_no_configuration(graph: Graph) -> None:
    """Its certificate names the courier, the map another robot of the same site."""
    plain = yaml.safe_load((HERE / "map.yaml").read_text())
    horn = {"horn": plain["mediated"]["horn"]}
    other = graph.folder / "other.yaml"
    other.write_text(yaml.safe_dump({**plain, "robot": scenarios.OTHER, "mediated": horn}))
    graph.launch(source=other)
    assert graph.ended() == 1
    assert "ROBOT_MISMATCH" in graph.said()


def test_another_site_than_the_gates_is_no_configuration(graph: Graph, gate: RunningGate) -> None:
    """A zone with another bound, say: what the node rebuilds is held to the gate's."""
    plain = yaml.safe_load(gate.site.read_text())
    plain["objects"]["cup"] = {"kind": "part", "home": "dock", "mass_g": 2, "names": ["cup"]}
    other = graph.folder / "site.yaml"
    other.write_text(yaml.safe_dump(plain))
    graph.launch(site=other)
    assert graph.ended() == 1
    assert "SITE_MISMATCH" in graph.said()


@pytest.mark.parametrize(
    ("kind", "type_"),
    [
        ("service", "std_srvs/srv/Trigger"),
        ("action", "test_msgs/action/Fibonacci"),
        ("stream", "geometry_msgs/msg/Twist"),
    ],
)
def test_l16_an_actuation_name_that_no_way_of_the_binding_means_is_no_configuration(
    graph: Graph, kind: str, type_: str
) -> None:
    """What is mediated and cannot be decided would be a way that nobody signed for."""
    plain = yaml.safe_load((HERE / "map.yaml").read_text())
    where = {"public": "/llm/siren", "private": "/siren", "by": "/robot"}
    plain["mediated"]["siren"] = {"kind": kind, "type": type_, **where}
    other = graph.folder / "other.yaml"
    other.write_text(yaml.safe_dump(plain))
    graph.launch(source=other)
    assert graph.ended() == 1
    assert "siren" in graph.said()


def test_a_gate_that_does_not_come_is_no_configuration(graph: Graph, tmp_path: Path) -> None:
    (tmp_path / "nobody").mkdir()
    graph.start(managed=True, run=tmp_path / "nobody" / "there")
    assert not Manager(graph).to(Transition.TRANSITION_CONFIGURE)


def test_parameters_tell_and_nobody_sets_one(graph: Graph) -> None:
    graph.start()
    manager = Manager(graph)
    assert manager.get("robot", "security") == ["courier-1", "none"]
    truth = ParameterValue(type=ParameterType.PARAMETER_BOOL, bool_value=True)
    text = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value="other")
    for name, value in (("use_sim_time", truth), ("robot", text), ("security", text)):
        said = manager.set(name, value)
        assert not said.successful
        assert said.reason


def test_a_node_whose_own_thread_ends_is_over_with_everything_that_it_serves(
    graph: Graph,
) -> None:
    """`rclpy` ends it on a type of parameter that there is not."""
    graph.start()
    sent = goal(graph)
    assert sent.accepted
    request = SetParameters.Request(
        parameters=[Parameter(name="robot", value=ParameterValue(type=200))]
    )
    graph.planner("odd").call(SetParameters, f"{NODE}/set_parameters", request)
    assert graph.ended() == 1
    assert "does not spin" in graph.said()
    assert "Traceback" not in graph.said()
    assert graph.robot.arm.canceled == [True]


def test_a_node_that_is_still_being_configured_ends_when_it_is_told_to(
    graph: Graph, tmp_path: Path
) -> None:
    (tmp_path / "nobody").mkdir()
    graph.launch(run=tmp_path / "nobody")
    names = graph.planner("looks").node.get_node_names
    until(lambda: "gate_robot" in names(), "the robot's side")
    assert graph.terminate() == 0
    assert "Traceback" not in graph.said()


def test_a_middleware_that_keeps_to_no_keystore_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Where no variable names one, ROS takes what is installed."""
    ros = parse_map((HERE / "map.yaml").read_text(), where="map")
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    monkeypatch.setattr(process, "get_rmw_implementation_identifier", lambda: "rmw_zenoh_cpp")
    with pytest.raises(EnvironmentFault, match="rmw_zenoh_cpp"), ros_context(ros, "/x"):
        pass


def test_a_clock_that_somebody_publishes_is_nobodys(graph: Graph) -> None:
    """It jumps back and stands: leases go by the monotonic clock, and a goal runs to its end."""
    graph.start()
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


@pytest.mark.parametrize(
    "words",
    [
        ("--ros-args", "-p", "use_sim_time:=true"),
        ("--ros-args", "-r", "/fibonacci:=/elsewhere"),
        ("use_sim_time:=true",),
    ],
)
def test_words_of_ros_are_none_of_its_own(graph: Graph, words: tuple[str, ...]) -> None:
    graph.launch(*words)
    assert graph.ended() == 2
    assert "unrecognized arguments" in graph.said()


def test_an_action_client_of_before_finds_a_node_that_was_configured_anew(graph: Graph) -> None:
    graph.start(managed=True)
    manager, planner = Manager(graph), graph.planner()
    client = ActionClient(planner.node, Fibonacci, "/llm/fibonacci", callback_group=planner.group)
    for transition in (
        Transition.TRANSITION_CONFIGURE,
        Transition.TRANSITION_ACTIVATE,
        Transition.TRANSITION_DEACTIVATE,
        Transition.TRANSITION_CLEANUP,
        Transition.TRANSITION_CONFIGURE,
        Transition.TRANSITION_ACTIVATE,
    ):
        assert manager.to(transition)
    until(client.server_is_ready, "the server", seconds=PATIENCE_S)
    graph.robot.arm.end.set()
    sent = Goal(planner, client, Fibonacci.Goal(order=3))
    assert sent.accepted
    assert sent.result().status == GoalStatus.STATUS_SUCCEEDED
