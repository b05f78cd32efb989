# SPDX-License-Identifier: Apache-2.0
"""What planners are told is what was so, and who does not listen or asks twice harms nobody else.

Real nodes, a real gate. Spec page: docs/spec/ros.md#goals; lessons L1, L19
"""

from __future__ import annotations

import json
import os
import time
from pathlib import Path
from typing import Any

import pytest
import yaml

pytest.importorskip("rclpy", reason="needs ROS 2 (tests/ros/make.sh makes an environment)")

from action_msgs.msg import GoalStatus
from rclpy.action import GoalResponse
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_srvs.srv import Trigger
from test_msgs.action import Fibonacci
from unique_identifier_msgs.msg import UUID

from authguard_r.integrations.ros.nodes.actions import BIND_S, MOST_ASKERS, RESULT_S, _GoalServer
from fixtures.gate_process import until
from ros.graph import PATIENCE_S, Goal, Graph, Peer, Planner, graph_of, next_domain
from ros.hospital import HERE, hospital
from ros.test_mediation import asked, outcomes

SEND, RESULT = Fibonacci.Impl.SendGoalService, Fibonacci.Impl.GetResultService
#: Whoever wants answers so is asked for, and hears none: nobody offers them so.
DEAF = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Raw:
    """A planner that uses an action as the services that it is."""

    def __init__(self, peer: Planner, *, qos: QoSProfile | None = None) -> None:
        self._peer, hidden = peer, "/llm/fibonacci/_action"
        given = {} if qos is None else {"qos_profile": qos}
        make = peer.node.create_client
        self._send = make(SEND, f"{hidden}/send_goal", callback_group=peer.group, **given)
        self._ask = make(RESULT, f"{hidden}/get_result", callback_group=peer.group, **given)

    def seen(self) -> Raw:
        """Return it once its servers are there."""
        for client in (self._send, self._ask):
            until(client.service_is_ready, client.srv_name, seconds=PATIENCE_S)
        return self

    def goal(self, key: UUID, order: int = 3) -> Any:
        """Ask for a goal under an id of the planner's own choice."""
        request = SEND.Request(goal_id=key, goal=Fibonacci.Goal(order=order))
        return self._peer.ask(lambda: self._send.call_async(request))

    def result(self, key: UUID) -> Any:
        """Ask for its result."""
        return self._peer.ask(lambda: self._ask.call_async(RESULT.Request(goal_id=key)))

    def is_read(self) -> bool:
        """Ask for what nobody knows; `rclpy` loses an answer that comes while it still asks."""
        try:
            return bool(self.result(new_id()).result(1))
        except TimeoutError:
            return False


def new_id() -> UUID:
    return UUID(uuid=list(os.urandom(16)))


def test_of_two_goals_of_one_id_the_second_is_rejected_and_nobody_does_it(graph: Graph) -> None:
    """`rclpy` knows an id only once its goal was taken: the robot would do what was rejected."""
    arm = graph.robot.arm
    raw, key = Raw(graph.planner()).seen(), new_id()
    arm.answers.clear()
    first = raw.goal(key)
    until(lambda: arm.goals, "the first")
    assert not raw.goal(key, 4).result(PATIENCE_S).accepted
    arm.answers.set()
    assert first.result(PATIENCE_S).accepted
    assert not raw.goal(key, 5).result(PATIENCE_S).accepted
    arm.end.set()
    assert raw.result(key).result(PATIENCE_S).status == GoalStatus.STATUS_SUCCEEDED
    assert not raw.goal(key, 6).result(PATIENCE_S).accepted  # while its result is kept
    assert [one.order for one in arm.goals] == [3]
    over = time.monotonic() + RESULT_S + 1
    until(lambda: time.monotonic() > over, "its being forgotten")
    assert raw.goal(key, 7).result(PATIENCE_S).accepted


def test_of_a_crowd_that_asks_for_a_result_the_first_are_told() -> None:
    """Each of them would be kept until the goal ends, and more could come than there is memory."""
    domain = next_domain()
    robot, planner = Peer("serves", domain), Planner("asks", domain)
    handles: list[Any] = []

    def take(taken: Any) -> None:
        robot._executor.create_task(server.answer, taken, GoalResponse.ACCEPT)

    server = _GoalServer(
        robot.node,
        Fibonacci,
        "/llm/fibonacci",
        asked=take,
        bound=handles.append,
        callback_group=MutuallyExclusiveCallbackGroup(),  # the node has one thread for it
    )
    try:
        raw, key = Raw(planner).seen(), new_id()
        assert raw.goal(key).result(PATIENCE_S).accepted
        crowd = []
        for _ in range(2 * MOST_ASKERS):
            crowd.append(raw.result(key))
            until(raw.is_read, "its being read")  # DDS keeps ten that wait
        server.finish(handles[0], lambda handle: handle.succeed() or Fibonacci.Result())
        until(lambda: sum(one.done() for one in crowd) == MOST_ASKERS, "their answers")
        until(raw.is_read, "whatever else is said")
        assert sum(one.done() for one in crowd) == MOST_ASKERS
    finally:
        planner.close()
        robot.close()


def test_a_planner_that_cannot_take_answers_ends_nothing(graph: Graph) -> None:
    """DDS lets it ask, and waits a tenth of a second for it at each answer."""
    arm = graph.robot.arm
    peer = graph.planner("deaf")
    deaf = Raw(peer, qos=DEAF)
    horn = peer.node.create_client(
        Trigger, "/llm/horn", qos_profile=DEAF, callback_group=peer.group
    )
    known = peer.node.count_services
    until(lambda: known("/llm/horn") and known("/llm/fibonacci/_action/send_goal"), "its servers")
    until(lambda: arm.goals or deaf.goal(new_id()) is None, "a goal that arrives", every_s=0.5)
    arm.end.set()
    calls = [peer.ask(lambda: horn.call_async(Trigger.Request())) for _ in range(5)]
    results = [deaf.result(new_id()) for _ in range(5)]
    until(lambda: '"unheard"' in graph.said(), "an answer that nobody takes")
    # heartbeats were late meanwhile, so the robot may have been stopped
    listens, request = graph.planner("listens"), Trigger.Request()
    until(lambda: listens.call(Trigger, "/llm/horn", request).result(20).success, "a call")
    until(lambda: asked(graph, 4, "another").accepted, "a goal")
    assert "Traceback" not in graph.said()
    assert not any(one.done() for one in (*calls, *results))
    assert graph.process is not None
    assert graph.process.poll() is None


def test_an_answer_that_is_too_long_is_withheld_and_that_it_was_done_is_not(graph: Graph) -> None:
    graph.robot.says = "x" * 200_000
    said = graph.planner().call(Trigger, "/llm/horn", Trigger.Request()).result(20)
    assert (said.success, said.message) == (True, "INPUT_TOO_LARGE")
    assert graph.robot.calls == ["horn"]


def test_a_goal_whose_answer_comes_too_late_is_aborted_and_not_left_open(fresh: Graph) -> None:
    with fresh.inside():
        arm = fresh.robot.arm
        arm.answers.clear()
        planner = fresh.planner()
        goal = Goal(planner, planner.client(Fibonacci, "/llm/fibonacci"), Fibonacci.Goal(order=3))
        until(lambda: arm.goals, "the goal")
        # the planners' thread is at something else for longer than a goal waits for it
        fresh.mediator._servers[0]._spinner.run(time.sleep, BIND_S + 1)
        arm.answers.set()
        until(lambda: arm.canceled == [True], "its end")
        assert goal.accepted
        assert goal.result().status == GoalStatus.STATUS_ABORTED


def test_a_call_that_another_of_the_same_meaning_carries_out_is_answered_as_it_was(
    tmp_path: Path,
) -> None:
    """The binding's first way does it, whichever was called; its planner is not told no."""
    plain = yaml.safe_load((HERE / "binding.yaml").read_text())
    announce, hold = plain["tools"]["call_service"][:2]
    plain["tools"]["call_service"][1] = {**announce, "when": hold["when"]}
    binding = tmp_path / "binding.yaml"
    binding.write_text(json.dumps(plain))  # without aliases
    with hospital(binding) as gate, graph_of(tmp_path, gate) as graph:
        gate.mark()
        with graph.inside():
            said = graph.planner().call(Trigger, "/llm/hold", Trigger.Request()).result(20)
            assert (said.success, said.message) == (True, "horn done")
            assert graph.robot.calls == ["horn"]
            until(lambda: outcomes(gate) == ["succeeded"], "the outcome")
