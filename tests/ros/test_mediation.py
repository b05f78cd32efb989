# SPDX-License-Identifier: Apache-2.0
"""What a planner asks of a robot's ROS graph is decided first, and told as it was.

Real nodes, a real gate, and the node between them as a process. Source: issue 9, "Mediation".
Spec page: docs/spec/ros.md
"""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2 (tests/ros/make.sh makes an environment)")

from action_msgs.msg import GoalInfo, GoalStatus
from action_msgs.srv import CancelGoal
from geometry_msgs.msg import Twist
from std_msgs.msg import UInt8
from std_srvs.srv import Empty, Trigger
from test_msgs.action import Fibonacci

from authguard_r.client import GateClient
from authguard_r.enforcement.signed_orders import Verb
from authguard_r.integrations.ros.nodes import mediator
from authguard_r.integrations.ros.nodes.actions import GONE_S
from authguard_r.wire.messages import ClientRole
from fixtures.gate_process import RunningGate, order, until
from ros.graph import Goal, Graph, Peer, Robot, Stick


@pytest.mark.smoke
def test_an_allowed_goal_is_the_robots_own_from_its_answer_to_its_result(graph: Graph) -> None:
    arm = graph.robot.arm
    arm.feedback = [Fibonacci.Feedback(sequence=[0]), Fibonacci.Feedback(sequence=[0, 1])]
    arm.result = Fibonacci.Result(sequence=[0, 1, 1])
    planner = graph.planner()
    goal = Goal(planner, planner.client(Fibonacci, "/llm/fibonacci"), Fibonacci.Goal(order=3))
    assert goal.accepted
    assert [one.order for one in arm.goals] == [3]
    until(lambda: len(goal.feedback) == 2, "both feedbacks")
    assert goal.feedback == arm.feedback
    arm.end.set()
    said = goal.result()
    assert said.status == GoalStatus.STATUS_SUCCEEDED
    assert said.result == arm.result


def asked(graph: Graph, order: int, name: str = "planner") -> Goal:
    planner = graph.planner(name)
    return Goal(planner, planner.client(Fibonacci, "/llm/fibonacci"), Fibonacci.Goal(order=order))


def briefly(gate: RunningGate) -> GateClient:
    """Return a client that stops, and does not wait for long for a robot that does not stand."""
    return GateClient.connect(gate.stop_socket, role=ClientRole.PLANNER, timeout_ms=1_500)


def outcomes(gate: RunningGate) -> list[str]:
    return [one.decision for one in gate.news() if one.kind == "outcome"]


@pytest.mark.smoke
def test_a_goal_outside_its_grant_never_reaches_the_robot(graph: Graph, gate: RunningGate) -> None:
    arm = graph.robot.arm
    assert not asked(graph, 21).accepted
    assert arm.goals == []
    until(lambda: gate.refusals("PARAMETER_OUT_OF_BOUNDS"), "the refusal's record")


def test_a_goal_that_the_robots_own_server_rejects_is_rejected(
    graph: Graph, gate: RunningGate
) -> None:
    arm = graph.robot.arm
    arm.takes = False
    assert not asked(graph, 3).accepted
    assert len(arm.goals) == 1
    until(lambda: outcomes(gate) == ["not_started"], "the outcome")


@pytest.mark.smoke
def test_a_cancellation_is_forwarded_and_the_goal_ends_canceled(
    graph: Graph, gate: RunningGate
) -> None:
    arm = graph.robot.arm
    goal = asked(graph, 3)
    assert goal.accepted
    assert goal.cancel().goals_canceling
    assert goal.result().status == GoalStatus.STATUS_CANCELED
    assert arm.canceled == [True]
    until(lambda: outcomes(gate) == ["aborted"], "the outcome")


def test_a_goal_that_the_robot_does_not_cancel_is_told_of_as_it_ends(
    graph: Graph, gate: RunningGate
) -> None:
    """The planner is not refused a cancellation; whether the goal yields is the robot's word."""
    arm = graph.robot.arm
    arm.yields = False
    goal = asked(graph, 3)
    assert goal.accepted
    assert goal.cancel().goals_canceling
    until(lambda: arm.asked_to_cancel, "its being asked")
    assert outcomes(gate) == []
    arm.end.set()
    assert goal.result().status == GoalStatus.STATUS_SUCCEEDED
    assert arm.canceled == []


def test_a_goal_that_the_robot_aborts_is_aborted_with_its_result(
    graph: Graph, gate: RunningGate
) -> None:
    arm = graph.robot.arm
    arm.abort, arm.result = True, Fibonacci.Result(sequence=[7])
    goal = asked(graph, 3)
    assert goal.accepted
    arm.end.set()
    said = goal.result()
    assert (said.status, said.result) == (GoalStatus.STATUS_ABORTED, arm.result)
    assert outcomes(gate) == ["failed"]


def test_a_result_is_kept_for_a_bounded_time(graph: Graph) -> None:
    """What ended is not held for ever for a planner that may never ask."""
    arm = graph.robot.arm
    goal = asked(graph, 3)
    assert goal.accepted
    arm.end.set()
    assert goal.result().status == GoalStatus.STATUS_SUCCEEDED
    until(lambda: goal.result().status == GoalStatus.STATUS_UNKNOWN, "its being forgotten")


def test_a_second_goal_is_rejected_while_one_runs_and_taken_after_it(
    graph: Graph, gate: RunningGate
) -> None:
    """Two planners: the one that comes second is told the truth."""
    arm = graph.robot.arm
    first = asked(graph, 3, "one")
    assert first.accepted
    assert not asked(graph, 4, "two").accepted
    assert [one.order for one in arm.goals] == [3]
    arm.end.set()
    assert first.result().status == GoalStatus.STATUS_SUCCEEDED
    assert asked(graph, 5, "three").accepted


def test_a_goal_whose_planner_has_ended_is_called_off(graph: Graph, gate: RunningGate) -> None:
    arm = graph.robot.arm
    planner = graph.planner()
    goal = Goal(planner, planner.client(Fibonacci, "/llm/fibonacci"), Fibonacci.Goal(order=3))
    assert goal.accepted
    planner.close()
    until(lambda: arm.canceled == [True], "its end")
    until(lambda: outcomes(gate) == ["aborted"], "the outcome")
    assert '"abandoned"' in graph.said()
    assert asked(graph, 4, "another").accepted


def test_a_planner_that_is_killed_in_mid_goal_leaves_nothing_that_runs(
    graph: Graph, gate: RunningGate
) -> None:
    """It cannot say so itself: DDS takes it for gone once it was silent for longer than its lease.

    That is twenty seconds, and two in this test.
    """
    arm = graph.robot.arm
    planner = graph.planner_process(3)
    assert [one.order for one in arm.goals] == [3]
    planner.kill()
    until(lambda: arm.canceled == [True], "its end")
    until(lambda: outcomes(gate) == ["aborted"], "the outcome")


def test_a_goal_goes_on_while_its_planner_is_there_however_long_it_says_nothing(
    graph: Graph, gate: RunningGate
) -> None:
    arm = graph.robot.arm
    goal = asked(graph, 3)
    assert goal.accepted
    ends = time.monotonic() + GONE_S + 1
    until(lambda: time.monotonic() > ends, "longer than an abandoned one has")
    assert arm.canceled == []
    arm.end.set()
    assert goal.result().status == GoalStatus.STATUS_SUCCEEDED


@pytest.mark.smoke
def test_a_goal_that_comes_past_the_gate_is_stopped(graph: Graph) -> None:
    """Without DDS security anybody reaches the robot's own server: it is seen, and canceled."""
    arm = graph.robot.arm
    assert asked(graph, 3).accepted
    stray = graph.planner("stray")
    running = Goal(stray, stray.client(Fibonacci, "/fibonacci"), Fibonacci.Goal(order=9))
    assert running.accepted
    until(lambda: arm.canceled == [True, True], "the end of both: the robot is stopped")
    assert '"strange"' in graph.said()
    until(lambda: asked(graph, 4, "again").accepted, "it serves again")


@pytest.mark.smoke
def test_a_stop_cancels_the_goal_and_its_planner_is_told(graph: Graph, gate: RunningGate) -> None:
    arm = graph.robot.arm
    goal = asked(graph, 3)
    assert goal.accepted
    with GateClient.connect(gate.stop_socket, role=ClientRole.PLANNER) as lane:
        assert lane.stop()["stopped"] is True
    assert arm.canceled == [True]
    assert goal.result().status == GoalStatus.STATUS_ABORTED


@pytest.mark.smoke
def test_a_service_that_is_granted_is_answered_by_the_robot(graph: Graph) -> None:
    planner = graph.planner()
    said = planner.call(Trigger, "/llm/horn", Trigger.Request()).result(20)
    assert (said.success, said.message) == (True, "horn done")
    planner.call(Empty, "/llm/clear", Empty.Request()).result(20)  # the hospital's look-out
    assert graph.robot.calls == ["horn", "clear"]


@pytest.mark.smoke
def test_a_service_that_is_refused_says_why_where_it_has_a_word_for_no(graph: Graph) -> None:
    """And where it has none it is not answered: the robot never gave an answer."""
    planner = graph.planner()
    quiet = planner.call(Empty, "/llm/quiet", Empty.Request())
    said = planner.call(Trigger, "/llm/hold", Trigger.Request()).result(20)
    assert (said.success, said.message) == (False, "CAPABILITY_EXCEEDED")
    until(lambda: graph.said().count("CAPABILITY_EXCEEDED") == 2, "both refusals")
    assert planner.call(Trigger, "/llm/horn", Trigger.Request()).result(20).success
    assert not quiet.done()
    assert graph.robot.calls == ["horn"]


@pytest.mark.smoke
def test_a_message_is_published_when_it_is_granted(graph: Graph, gate: RunningGate) -> None:
    publisher = graph.planner().publisher(UInt8, "/llm/lamp")
    for number in (9, 3):
        publisher.publish(UInt8(data=number))
    until(lambda: graph.robot.lamps, "the message")
    until(lambda: len([r for r in gate.news() if r.kind == "decision"]) == 2, "both decisions")
    assert graph.robot.lamps == [3]


def twist(x: float, turn: float = 0.0) -> Twist:
    made = Twist()
    made.linear.x, made.angular.z = x, turn
    return made


@pytest.mark.smoke
def test_velocities_are_one_lease_and_each_is_held_to_it(graph: Graph, gate: RunningGate) -> None:
    base = graph.robot.base
    stick = Stick(graph.planner(), Twist, "/llm/cmd_vel")
    until(lambda: base.heard, "the base is heard by")
    stick.message = twist(0.2, 0.1)
    until(lambda: 0.2 in base.speeds, "the velocity")
    stick.message = twist(0.1)
    until(lambda: base.speeds[-1] == 0.1, "the next one")
    stick.message = twist(0.5)  # more than the grant
    until(lambda: base.speeds[-1] == 0.0, "zero in its place")
    stick.message = twist(0.1)
    until(lambda: base.speeds[-1] == 0.1, "the next one")
    stick.message = twist(float("nan"))
    until(lambda: base.speeds[-1] == 0.0, "zero in its place")
    assert set(base.speeds) == {0.0, 0.2, 0.1}
    stick.message = None
    until(lambda: outcomes(gate) == ["succeeded"], "the stream's end")
    assert len([r for r in gate.news() if r.kind == "decision"]) == 1


@pytest.mark.smoke
def test_a_planner_of_velocities_that_falls_silent_stops_the_robot(
    graph: Graph, gate: RunningGate
) -> None:
    base = graph.robot.base
    stick = Stick(graph.planner(), Twist, "/llm/cmd_vel")
    until(lambda: base.heard, "the base is heard by")
    stick.message = twist(0.2)
    until(lambda: 0.2 in base.speeds, "the velocity")
    stick.message = None
    until(lambda: base.speeds[-1] == 0.0, "zero")
    until(lambda: outcomes(gate) == ["succeeded"], "the stream's end")


def test_one_velocity_of_a_planner_that_then_dies_is_over_as_soon_as_any(graph: Graph) -> None:
    """The first of a stream counts as a sample, and so does the silence after it."""
    base = graph.robot.base
    publisher = graph.planner().publisher(Twist, "/llm/cmd_vel")
    until(lambda: base.heard, "the base is heard by")
    publisher.publish(twist(0.2))
    until(lambda: 0.2 in base.speeds, "the velocity")
    begun = time.monotonic()
    until(lambda: base.speeds[-1] == 0.0, "zero")
    # before the planner's silence closes the stream, after 0.5 s
    assert time.monotonic() - begun < 0.45


def test_velocities_beyond_the_grant_never_begin(graph: Graph, gate: RunningGate) -> None:
    base = graph.robot.base
    stick = Stick(graph.planner(), Twist, "/llm/cmd_vel")
    stick.message = twist(0.6)
    until(lambda: [r for r in gate.news() if r.kind == "decision"], "a decision")
    until(lambda: stick.sent > 20, "more velocities")
    assert set(base.speeds) == {0.0}
    assert len([r for r in gate.news() if r.kind == "decision"]) == 1  # not fifty a second


@pytest.mark.smoke
def test_l16_a_velocity_along_an_axis_that_nobody_granted_never_begins(
    graph: Graph, gate: RunningGate
) -> None:
    base = graph.robot.base
    stick = Stick(graph.planner(), Twist, "/llm/cmd_vel")
    for part, axis in (("linear", "z"), ("angular", "x"), ("angular", "y")):
        gate.mark()
        message = twist(0.1)
        setattr(getattr(message, part), axis, 0.1)
        stick.message = message
        until(lambda: gate.refusals("MALFORMED"), f"the refusal of {part}.{axis}")
        sent = stick.sent
        until(lambda sent=sent: stick.sent > sent + 20, "more velocities")
        assert set(base.speeds) == {0.0}, f"{part}.{axis}"


def revoked(gate: RunningGate) -> None:
    assert gate.live is not None
    with gate.client(ClientRole.OPERATOR, "orders") as operator:
        operator.command(order(gate, *gate.live, Verb.REVOKE))


def left(gate: RunningGate) -> None:
    assert gate.move is not None
    gate.move("public-corridor")


ENDS: dict[str, Callable[[RunningGate], None]] = {
    "its mission is revoked": revoked,
    "the robot leaves its regions": left,
    "the gate is killed": RunningGate.kill9,
    "the gate is stopped by the kernel": lambda gate: os.kill(gate.pid, signal.SIGSTOP),
}


@pytest.mark.parametrize("end", ENDS.values(), ids=ENDS)
def test_velocities_end_with_what_allowed_them_whatever_their_planner_says(
    graph: Graph, gate: RunningGate, end: Callable[[RunningGate], None]
) -> None:
    base = graph.robot.base
    stick = Stick(graph.planner(), Twist, "/llm/cmd_vel")
    until(lambda: base.heard, "the base is heard by")
    stick.message = twist(0.2)
    until(lambda: 0.2 in base.speeds, "the velocity")
    end(gate)
    try:
        until(lambda: base.speeds[-1] == 0.0, "zero")
        stood, sent = len(base.speeds), stick.sent
        until(lambda: stick.sent > sent + 100, "a hundred more")
        assert not any(base.speeds[stood:])
    finally:
        if gate.alive:
            os.kill(gate.pid, signal.SIGCONT)


def test_a_planner_that_floods_velocities_keeps_nobody_from_stopping_the_robot(
    graph: Graph, gate: RunningGate
) -> None:
    """Two thousand a second: what waits is bounded, and the node never counts as dead."""
    base, over = graph.robot.base, threading.Event()
    publisher = graph.planner().publisher(Twist, "/llm/cmd_vel")

    def flood() -> None:
        while not over.is_set():
            for _ in range(20):
                publisher.publish(twist(0.2))
            time.sleep(0.01)

    flooding = threading.Thread(target=flood, daemon=True)
    flooding.start()
    try:
        until(lambda: 0.2 in base.speeds, "the velocity")
        time.sleep(1)  # so that a queue without a bound would be long
        with GateClient.connect(gate.stop_socket, role=ClientRole.PLANNER) as lane:
            begun = time.monotonic()
            assert lane.stop()["stopped"] is True
        until(lambda: base.speeds[-1] == 0.0 and base.last_s > begun, "zero", seconds=2)
    finally:
        over.set()
        flooding.join()
    assert "lapsed" not in graph.said()


def test_of_two_planners_of_velocities_one_steers(graph: Graph, gate: RunningGate) -> None:
    base = graph.robot.base
    one = Stick(graph.planner("one"), Twist, "/llm/cmd_vel")
    two = Stick(graph.planner("two"), Twist, "/llm/cmd_vel")
    until(lambda: base.heard, "the base is heard by")
    one.message = twist(0.2)
    until(lambda: 0.2 in base.speeds, "the velocity")
    two.message = twist(0.1)
    until(lambda: two.sent > 10, "ten of the other's")
    one.message = twist(-0.2)
    until(lambda: -0.2 in base.speeds, "the first one's next")
    assert set(base.speeds) == {0.0, 0.2, -0.2}
    one.message = None
    until(lambda: 0.1 in base.speeds, "the other's turn")


def test_a_node_that_was_killed_cancels_what_runs_before_it_serves_again(
    graph: Graph, gate: RunningGate
) -> None:
    """Nobody knows what became of its goal: a person has to say, before anything begins."""
    arm = graph.robot.arm
    assert asked(graph, 3).accepted
    graph.kill()
    graph.start()
    assert arm.canceled == [True]
    assert not asked(graph, 4, "another").accepted
    until(lambda: gate.refusals("MISSION_SUSPENDED"), "the refusal")


def test_a_robot_that_leaves_its_regions_is_stopped_in_mid_goal(
    graph: Graph, gate: RunningGate
) -> None:
    arm = graph.robot.arm
    goal = asked(graph, 3)
    assert goal.accepted
    assert gate.move is not None
    gate.move("public-corridor")
    assert goal.result().status == GoalStatus.STATUS_ABORTED
    assert arm.canceled == [True]
    until(lambda: outcomes(gate) == ["aborted"], "the outcome")


@pytest.mark.smoke
def test_a_gate_that_is_killed_leaves_a_robot_whose_goal_is_canceled(
    graph: Graph, gate: RunningGate
) -> None:
    """The controller's end is its dead man; and no word is told that nobody noted."""
    arm = graph.robot.arm
    goal = asked(graph, 3)
    assert goal.accepted
    arm.result = Fibonacci.Result(sequence=[7])
    gate.kill9()
    said = goal.result()
    assert (said.status, said.result) == (GoalStatus.STATUS_ABORTED, Fibonacci.Result())
    assert arm.canceled == [True]
    assert not asked(graph, 4, "another").accepted


def test_a_node_that_is_ended_cancels_what_runs(graph: Graph, gate: RunningGate) -> None:
    arm = graph.robot.arm
    assert asked(graph, 3).accepted
    assert graph.terminate() == 0
    assert arm.canceled == [True]
    until(lambda: outcomes(gate) == ["aborted"], "the outcome")


def test_a_robot_that_refuses_to_cancel_does_not_stand_and_is_asked_until_it_yields(
    graph: Graph, gate: RunningGate
) -> None:
    arm = graph.robot.arm
    arm.yields = False
    goal = asked(graph, 3)
    assert goal.accepted
    with briefly(gate) as lane:
        assert lane.stop()["stopped"] is False
        until(lambda: outcomes(gate) == ["unknown"], "the outcome")
        assert goal.result().status == GoalStatus.STATUS_ABORTED
        assert not asked(graph, 4, "another").accepted
        asked_before = arm.asked_to_cancel
        until(lambda: arm.asked_to_cancel > asked_before, "its being asked again")
        assert arm.canceled == []
        arm.yields = True
        until(lambda: lane.stop()["stopped"], "its word")
    assert arm.canceled == [True]
    assert [one.order for one in arm.goals] == [3]


def test_a_robot_that_does_not_say_whether_it_takes_a_goal_is_stopped(
    graph: Graph, gate: RunningGate
) -> None:
    """Its planner is told no, the log that nobody knows; a yes that comes too late is canceled."""
    arm = graph.robot.arm
    arm.answers.clear()
    assert not asked(graph, 3).accepted
    until(lambda: outcomes(gate) == ["unknown"], "the outcome")
    arm.answers.set()
    until(lambda: arm.canceled == [True], "the cancellation")


# with a robot or an event loop of the test's own


def test_a_loop_that_is_stuck_says_zero_once_and_then_nothing(fresh: Graph) -> None:
    """The thread of ROS spins on: it must not repeat a velocity that nobody holds any more."""
    with fresh.inside() as loop:
        base, stuck = fresh.robot.base, threading.Event()
        stick = Stick(fresh.planner(), Twist, "/llm/cmd_vel")
        until(lambda: base.heard, "the base is heard by")
        stick.message = twist(0.2)
        until(lambda: 0.2 in base.speeds, "the velocity")
        loop.call_soon_threadsafe(stuck.wait, 20)
        until(lambda: base.speeds[-1] == 0.0, "zero")
        until(lambda: time.monotonic() - base.last_s > 0.5, "silence")
        assert base.speeds[-2:] == [0.2, 0.0]
        stuck.set()


def test_a_server_that_the_graph_hides_is_told_to_cancel_all_the_same(
    fresh: Graph, gate: RunningGate
) -> None:
    """Whoever may write to the graph can claim half of a server, and it counts as away."""
    with fresh.inside():
        arm = fresh.robot.arm
        assert asked(fresh, 3).accepted
        outlet: Any = fresh.mediator.body.proxies["arm"]
        outlet._canceler.service_is_ready = lambda: False  # what the graph says from now on
        with GateClient.connect(gate.stop_socket, role=ClientRole.PLANNER) as lane:
            assert lane.stop()["stopped"] is True
        assert arm.canceled == [True]
        assert "arm" in fresh.mediator.body.missing  # nothing begins there


def test_a_robot_that_is_gone_in_mid_goal_counts_as_standing_only_when_it_says_so(
    fresh: Graph, gate: RunningGate
) -> None:
    robot = fresh.robot_process()
    with fresh.inside():
        goal = asked(fresh, 3)
        assert goal.accepted
        robot.kill()
        robot.wait()
        with briefly(gate) as lane:
            assert lane.stop()["stopped"] is False
            assert goal.result().status == GoalStatus.STATUS_ABORTED
            until(lambda: outcomes(gate) == ["unknown"], "the outcome")
            fresh.add(Robot(fresh.domain))
            until(lambda: lane.stop()["stopped"], "its word")


def test_a_server_that_comes_or_comes_back_is_told_to_cancel_whatever_it_runs(
    fresh: Graph, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody knows what it was given while it was not seen: by a node of before, or by anybody."""
    monkeypatch.setattr(mediator, "ROBOT_S", 0.5)  # nothing comes later
    fresh.robot.close()
    with fresh.inside():
        assert "arm" in fresh.mediator.body.missing
        asked: list[Any] = []

        def cancels(request: Any, answer: Any) -> Any:
            asked.append(request.goal_info)
            return answer

        outlet: Any = fresh.mediator.body.proxies["arm"]
        for life in ("one", "another"):
            until(lambda: not outlet._is_settled, "the node knows that no server is there")
            robot = fresh.add(Peer(life, fresh.domain))
            robot.node.create_service(
                CancelGoal, "/fibonacci/_action/cancel_goal", cancels, callback_group=robot.group
            )
            until(lambda: asked, "the cancellation")
            robot.close()
            assert asked == [GoalInfo()] * len(asked)  # no goal and no time: every goal there is
            asked.clear()
