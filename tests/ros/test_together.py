# SPDX-License-Identifier: Apache-2.0
"""Several goals at once: each its own, what may not run together is refused, and a stop ends all.

Real nodes, a real gate. Spec page: docs/spec/ros.md#several-at-once
"""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2 (tests/ros/make.sh makes an environment)")

from action_msgs.msg import GoalStatus
from geometry_msgs.msg import Twist
from std_srvs.srv import Trigger
from test_msgs.action import Fibonacci

from authguard_r.client import GateClient
from authguard_r.wire.messages import ClientRole
from fixtures.gate_process import RunningGate, until
from ros.graph import Arm, Goal, Graph, Stick
from ros.test_mediation import outcomes, twist

ABORTED, SUCCEEDED = GoalStatus.STATUS_ABORTED, GoalStatus.STATUS_SUCCEEDED


def chimes(graph: Graph) -> Arm:
    """Return a server of goals that may run beside others."""
    server = graph.robot.chimes
    server.each = lambda goal: (
        Fibonacci.Feedback(sequence=[goal.order]),
        Fibonacci.Result(sequence=[goal.order, goal.order]),
    )
    return server


def asked(graph: Graph, *orders: int) -> list[Goal]:
    """Ask for goals, all of them before any is answered."""
    planner = graph.planner()
    client = planner.client(Fibonacci, "/llm/chimes")
    return [Goal(planner, client, Fibonacci.Goal(order=order)) for order in orders]


def test_four_goals_run_at_once_each_with_its_own_feedback_and_result(
    graph: Graph, gate: RunningGate
) -> None:
    server = chimes(graph)
    goals = asked(graph, 1, 2, 3, 4)
    assert [goal.accepted for goal in goals] == [True] * 4
    for order, goal in enumerate(goals, 1):
        until(lambda goal=goal: goal.feedback, "its feedback")
        assert [list(one.sequence) for one in goal.feedback] == [[order]]
    server.end.set()
    for order, goal in enumerate(goals, 1):
        said = goal.result()
        assert (said.status, list(said.result.sequence)) == (SUCCEEDED, [order, order])
    assert sorted(one.order for one in server.goals) == [1, 2, 3, 4]
    assert outcomes(gate) == ["succeeded"] * 4


def test_a_fifth_goal_is_rejected_and_never_reaches_the_robot(
    graph: Graph, gate: RunningGate
) -> None:
    server = chimes(graph)
    goals = asked(graph, 1, 2, 3, 4)
    assert all(goal.accepted for goal in goals)
    (fifth,) = asked_again(graph, 5)
    assert not fifth.accepted
    assert "BUSY" in graph.said()
    server.end.set()
    assert all(goal.result().status == SUCCEEDED for goal in goals)
    assert 5 not in [one.order for one in server.goals]


def asked_again(graph: Graph, order: int) -> list[Goal]:
    """Ask as a planner of another name."""
    planner = graph.planner("another")
    goal = Fibonacci.Goal(order=order)
    return [Goal(planner, planner.client(Fibonacci, "/llm/chimes"), goal)]


def test_one_of_them_is_canceled_and_the_others_go_on(graph: Graph, gate: RunningGate) -> None:
    server = chimes(graph)
    first, second, third = asked(graph, 1, 2, 3)
    assert all(goal.accepted for goal in (first, second, third))
    assert second.cancel().goals_canceling
    assert second.result().status == GoalStatus.STATUS_CANCELED
    assert server.canceled == [True]
    server.end.set()
    assert [goal.result().status for goal in (first, third)] == [SUCCEEDED] * 2
    until(lambda: sorted(outcomes(gate)) == ["aborted", "succeeded", "succeeded"], "the outcomes")


def test_one_that_runs_alone_runs_beside_those_that_may_and_no_other_does(graph: Graph) -> None:
    server, arm = chimes(graph), graph.robot.arm
    (sound,) = asked(graph, 1)
    assert sound.accepted
    planner = graph.planner("mover")
    client = planner.client(Fibonacci, "/llm/fibonacci")
    wave, other = (Goal(planner, client, Fibonacci.Goal(order=order)) for order in (2, 3))
    assert sorted((wave.accepted, other.accepted)) == [False, True]
    assert len(arm.goals) == 1
    arm.end.set()
    server.end.set()
    assert sound.result().status == SUCCEEDED


def test_a_robot_is_steered_while_it_sounds_and_its_stream_ends_alone(
    graph: Graph, gate: RunningGate
) -> None:
    server, base = chimes(graph), graph.robot.base
    stick = Stick(graph.planner("driver"), Twist, "/llm/cmd_vel")
    until(lambda: base.heard, "the base is heard by")
    stick.message = twist(0.2)
    until(lambda: 0.2 in base.speeds, "the velocity")
    (sound,) = asked(graph, 1)
    assert sound.accepted
    assert graph.planner("caller").call(Trigger, "/llm/horn", Trigger.Request()).result(20).success
    stick.message = twist(0.1)
    until(lambda: base.speeds[-1] == 0.1, "another velocity")
    stick.message = None
    until(lambda: outcomes(gate) == ["succeeded", "succeeded"], "horn and stream")
    until(lambda: base.speeds[-1] == 0.0, "zero")
    assert server.canceled == []
    server.end.set()
    assert sound.result().status == SUCCEEDED


def test_a_stop_cancels_all_of_them_and_every_planner_is_told(
    graph: Graph, gate: RunningGate
) -> None:
    server = chimes(graph)
    goals = asked(graph, 1, 2, 3)
    assert all(goal.accepted for goal in goals)
    with GateClient.connect(gate.stop_socket, role=ClientRole.PLANNER) as lane:
        assert lane.stop()["stopped"] is True
    assert [goal.result().status for goal in goals] == [ABORTED] * 3
    assert server.canceled == [True] * 3
    assert outcomes(gate) == ["aborted"] * 3


def test_goals_are_taken_again_as_soon_as_there_is_room(graph: Graph) -> None:
    server = chimes(graph)
    goals = asked(graph, 1, 2, 3, 4)
    assert all(goal.accepted for goal in goals)
    goals[0].cancel()
    assert goals[0].result().status == GoalStatus.STATUS_CANCELED
    (another,) = asked_again(graph, 5)
    assert another.accepted
    server.end.set()
    assert another.result().status == SUCCEEDED
