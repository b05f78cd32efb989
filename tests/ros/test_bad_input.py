# SPDX-License-Identifier: Apache-2.0
"""What no honest planner sends is a refusal with its reason, and the next planner is served.

Another robot's names, the robot's map and place, bytes of another version of a type, names that
are spoofed. Poses, frames, behavior trees and lists are in `test_nav2.py`, text in `test_words.py`,
clocks in `test_lifecycle.py`. Source: issue 9, "Bad input"; lessons L3, L16
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2 (tests/ros/make.sh makes an environment)")

from geometry_msgs.msg import Twist
from rclpy.serialization import serialize_message
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger
from test_msgs.action import Fibonacci, NestedMessage

from authguard_r.integrations.ros.nodes import mediator
from fixtures.gate_process import RunningGate, until
from ros.graph import Arm, Client, Goal, Graph, Peer, Planner, Stick
from ros.hospital import map_with_words
from ros.test_mediation import twist
from ros.test_words import HORN, Writer, plan

POSE = {"header": {"frame_id": "map"}, "pose": {"pose": {"position": {"x": 1.0, "y": 1.0}}}}


def call(service: str, kind: str = "std_srvs/srv/Trigger", **request: Any) -> dict[str, Any]:
    arguments = {"service": service, "type": kind}
    return {"tool": "call_service", "arguments": {**arguments, **request}}


def publish(topic: str, kind: str, message: dict[str, Any]) -> dict[str, Any]:
    return {"tool": "publish", "arguments": {"topic": topic, "type": kind, "msg": message}}


def goal(action: str) -> dict[str, Any]:
    arguments = {"action": action, "action_type": "test_msgs/action/Fibonacci"}
    return {"tool": "send_action_goal", "arguments": {**arguments, "args": {"order": 3}}}


VELOCITY = {"linear": {"x": 0.2}, "angular": {"z": 0}}
ELSEWHERE = {
    "another robot's service": call("/courier_2/horn"),
    "another robot's goal": goal("/courier_2/fibonacci"),
    "another robot's wheels": publish("/courier_2/cmd_vel", "geometry_msgs/msg/Twist", VELOCITY),
    "a way around the names": call("/courier_2/../horn"),
    "a name without its root": call("horn"),
    "the public name of itself": call("/llm/horn"),
    "another map": call("/map_server/load_map", "nav2_msgs/srv/LoadMap", map_url="/tmp/map.yaml"),
    "another place": publish("/initialpose", "geometry_msgs/msg/PoseWithCovarianceStamped", POSE),
    "another type": call("/horn", "std_srvs/srv/Empty"),
    "the gate's own life": call("/authguard/gate/change_state", "lifecycle_msgs/srv/ChangeState"),
    "the robot's clock": publish("/clock", "rosgraph_msgs/msg/Clock", {}),
    "a transform": publish("/tf", "tf2_msgs/msg/TFMessage", {}),
}


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return map_with_words(tmp_path_factory.mktemp("map"))


def test_a_plan_for_what_is_not_this_robots_own_is_refused(graph: Graph, gate: RunningGate) -> None:
    writer = Writer(graph.planner())
    for what, step in ELSEWHERE.items():
        text = json.dumps({"plan": [step]})
        writer.write(text)
        told = writer.over(text)
        assert not {"began", "ended"} & {one["news"] for one in told}, what
        print(what, told[0]["reasons"])
        assert told[0]["reasons"], what
    refused = until(
        lambda: [r for r in gate.news() if r.decision == "reject"][len(ELSEWHERE) - 1 :] and [1],
        "a record of each",
    )
    assert refused
    assert graph.robot.calls == []
    assert graph.robot.arm.goals == []
    assert set(graph.robot.base.speeds) <= {0.0}


def test_nobody_answers_for_another_robot_or_for_the_map(graph: Graph) -> None:
    """There is no way into the robot but the map's: whoever asks for one waits for ever."""
    planner = graph.planner()
    until(planner.client(Fibonacci, "/llm/fibonacci").server_is_ready, "the node")
    node = planner.node
    others = [Client(node, Fibonacci, name) for name in ("/courier_2/llm/fibonacci", "/llm/arm")]
    assert not any(other.server_is_ready() for other in others)
    names = ("/llm/load_map", "/courier_2/llm/horn", "/llm/change_state")
    assert not any(node.create_client(Trigger, name).service_is_ready() for name in names)
    topics = ("/llm/initialpose", "/courier_2/llm/cmd_vel", "/llm/tf", "/llm/clock")
    assert not any(
        node.create_publisher(Twist, name, 10).get_subscription_count() for name in topics
    )


def served(graph: Graph, planner: Planner) -> None:
    """Require that the next planner is served as ever."""
    before = graph.robot.calls.count("horn")
    assert planner.call(Trigger, "/llm/horn", Trigger.Request()).result(20).success
    assert graph.robot.calls.count("horn") == before + 1
    stick = Stick(planner, Twist, "/llm/cmd_vel")
    stick.message = twist(0.1)
    until(lambda: 0.1 in graph.robot.base.speeds, "a velocity")
    stick.message = None
    until(lambda: graph.robot.base.speeds[-1] == 0.0, "its end")


BYTES = {
    "nothing": b"",
    "a header": b"\0\1\0\0",
    "a version with fewer fields": b"\0\1\0\0" + b"\0" * 8,
    "a text": serialize_message(String(data="drive on")),
    "no number anywhere": b"\0\1\0\0" + b"\xff" * 48,
    "another byte order": b"\0\0\0\0" + b"\x3f\xf0" * 24,
    "a strange encapsulation": b"\xff\xff\xff\xff" + b"\0" * 48,
    "a length beyond all": b"\0\1\0\0" + b"\xff\xff\xff\x7f" * 12,
    "another layout": b"\0\1\0\0" + b"\x41" * 48,
}


def test_velocities_of_another_version_of_their_type_move_nothing(graph: Graph) -> None:
    """DDS matches types by their names alone, whatever a publisher was built with."""
    planner, another, base = graph.planner(), graph.planner("another"), graph.robot.base
    wheels = planner.publisher(Twist, "/llm/cmd_vel")
    until(lambda: base.heard, "the base is heard by")
    for name, data in BYTES.items():
        base.forget()
        until(lambda: base.heard, "the base is heard by")
        for _ in range(3):
            wheels.publish(data)
        served(graph, another)
        assert set(base.speeds) <= {0.0, 0.1}, name


def test_a_publisher_of_another_type_under_the_same_name_is_heard_by_nobody(graph: Graph) -> None:
    liar = graph.planner("liar")
    wheels = liar.node.create_publisher(String, "/llm/cmd_vel", 10)
    for _ in range(10):
        wheels.publish(String(data="drive on"))
    served(graph, graph.planner("another"))
    assert wheels.get_subscription_count() == 0


def test_a_planner_of_another_type_of_an_action_or_a_service_is_heard_by_nobody(
    graph: Graph,
) -> None:
    """It was built with other interfaces: what it sends is read as nothing else.

    A request with the same fields under another type's name is matched by DDS, and is the same.
    """
    liar = graph.planner("liar")
    goals = Client(liar.node, NestedMessage, "/llm/fibonacci", callback_group=liar.group)
    calls = liar.node.create_client(SetBool, "/llm/horn", callback_group=liar.group)
    asked = [
        liar.ask(lambda: goals.send_goal_async(NestedMessage.Goal())),
        liar.ask(lambda: calls.call_async(SetBool.Request(data=True))),
    ]
    served(graph, graph.planner("another"))
    assert not any(one.done() for one in asked)
    assert graph.robot.arm.goals == []
    assert graph.robot.calls == ["horn"]


def test_who_has_the_names_of_the_gates_nodes_is_a_planner_all_the_same(
    graph: Graph, gate: RunningGate
) -> None:
    """No decision rests on who somebody says that he is in the graph."""
    for name in ("gate", "gate_robot", "gate_planners", "robot"):
        spoofed = graph.planner(name)
        client = spoofed.client(Fibonacci, "/llm/fibonacci")
        asked = spoofed.ask(lambda c=client: c.send_goal_async(Fibonacci.Goal(order=21)))
        assert not asked.result(20).accepted
        until(lambda: gate.refusals("PARAMETER_OUT_OF_BOUNDS"), "the refusal's record")
        gate.mark()
    assert graph.robot.arm.goals == []
    served(graph, graph.planner("another"))


def test_a_plan_is_served_after_all_of_it(graph: Graph) -> None:
    writer = Writer(graph.planner())
    elsewhere = [json.dumps({"plan": [step]}) for step in ELSEWHERE.values()]
    writer.write(*elsewhere)
    for text in elsewhere:  # what waits is bounded: one more at once may be refused as too many
        writer.over(text)
    writer.write(plan(HORN))
    assert writer.over(plan(HORN))[-1]["news"] == "over"
    assert graph.robot.calls == ["horn"]


def test_a_robots_server_of_another_type_is_no_server(
    fresh: Graph, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mediator, "ROBOT_S", 2.0)  # nothing comes later
    fresh.robot.close()
    other = fresh.add(Peer("other", fresh.domain))
    arm = Arm(other, NestedMessage, "/fibonacci")
    with fresh.inside():
        assert "arm" in fresh.mediator.body.missing
        planner = fresh.planner()
        client = planner.client(Fibonacci, "/llm/fibonacci")
        assert not Goal(planner, client, Fibonacci.Goal(order=3)).accepted
        assert arm.goals == []
