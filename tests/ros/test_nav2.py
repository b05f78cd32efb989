# SPDX-License-Identifier: Apache-2.0
"""Goals of Nav2 through the shipped binding: rebuilt, or refused with a reason (L3, L16).

nav2_msgs is on no index of Python's packages: `tests/ros/build_interfaces.sh` makes it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2 (tests/ros/make.sh makes an environment)")
pytest.importorskip("nav2_msgs", reason="needs nav2_msgs (tests/ros/build_interfaces.sh)")

from action_msgs.msg import GoalStatus
from geometry_msgs.msg import PoseStamped
from nav2_msgs.action import FollowWaypoints, NavigateThroughPoses, NavigateToPose

from authguard_r.integrations.ros.nodes.values import has_path
from fixtures.gate_process import RunningGate, until
from fixtures.packaged_robots import gate_of
from ros.graph import Arm, Goal, Graph, Planner, graph_of, shown
from ros.hospital import BUDGETS, GO, HERE, ISOLATION, PHARMACY
from ros.shared_graph import SharedGate


@pytest.fixture(scope="module")
def gate() -> Iterator[RunningGate]:
    folder = Path(mkdtemp(prefix="ag-ros-", dir="/tmp"))
    with gate_of(folder, "nav2", grants=[GO], changes={"budgets": BUDGETS}, fold_ms=0) as made:
        yield made


class Nav2:
    """The node between a planner and a robot that has Nav2's action servers."""

    def __init__(self, graph: Graph) -> None:
        robot = graph.robot
        self.to_pose = Arm(robot, NavigateToPose, "/navigate_to_pose")
        self.through = Arm(robot, NavigateThroughPoses, "/navigate_through_poses")
        self.waypoints = Arm(robot, FollowWaypoints, "/follow_waypoints")
        graph.start(HERE / "nav2-map.yaml")
        self.graph = graph
        self._planner: Planner = graph.planner()
        self._clients = {
            kind: self._planner.client(kind, f"/llm/{name}")
            for kind, name in (
                (NavigateToPose, "navigate_to_pose"),
                (NavigateThroughPoses, "navigate_through_poses"),
                (FollowWaypoints, "follow_waypoints"),
            )
        }

    @property
    def reached(self) -> list[Any]:
        """Return every goal that reached the robot."""
        return [*self.to_pose.goals, *self.through.goals, *self.waypoints.goals]

    def forget(self) -> None:
        """Begin anew: no goal has reached the robot."""
        for arm in (self.to_pose, self.through, self.waypoints):
            arm.rest()
            arm.forget()

    def ask(self, kind: Any, goal: Any) -> Goal:
        return Goal(self._planner, self._clients[kind], goal)


@pytest.fixture(scope="module")
def started(tmp_path_factory: pytest.TempPathFactory, gate: RunningGate) -> Iterator[Nav2]:
    with graph_of(tmp_path_factory.mktemp("graph"), gate) as graph:
        yield Nav2(graph)


@pytest.fixture
def nav2(started: Nav2, gate: RunningGate, shared_gate: SharedGate) -> Iterator[Nav2]:
    shared_gate.renew()
    shared_gate.mark()
    with shown(started.graph, gate):
        yield started
        started.forget()


def pose(at: tuple[float, float] = PHARMACY, frame: str = "main", **more: float) -> PoseStamped:
    made = PoseStamped()
    made.header.frame_id = frame
    made.pose.position.x, made.pose.position.y = at
    made.pose.position.z = more.get("z", 0.0)
    for name in "xyzw":
        if f"q{name}" in more:
            setattr(made.pose.orientation, name, more[f"q{name}"])
    return made


def to(*given: Any, tree: str = "", **more: Any) -> NavigateToPose.Goal:
    return NavigateToPose.Goal(pose=pose(*given, **more), behavior_tree=tree)


def through(*poses: PoseStamped, tree: str = "") -> NavigateThroughPoses.Goal:
    made = NavigateThroughPoses.Goal(behavior_tree=tree)
    made.poses.goals = list(poses)
    return made


def test_l16_a_granted_goal_arrives_rebuilt_and_nothing_of_the_planners_own(nav2: Nav2) -> None:
    """The region's halting place, no stamp, no orientation: what the planner noted stays behind."""
    given = to(qx=0.5, qy=0.5, qz=0.5, qw=0.5)
    given.pose.header.stamp.sec = 99
    goal = nav2.ask(NavigateToPose, given)
    assert goal.accepted
    (reached,) = nav2.reached
    assert reached == to((4.0, 5.0))
    assert reached.pose.pose.orientation.w == 1.0
    nav2.to_pose.end.set()
    assert goal.result().status == GoalStatus.STATUS_SUCCEEDED


def test_the_installed_type_says_under_which_name_a_list_of_poses_stands() -> None:
    paths = ("poses", "poses.goals", "poses.goals.pose", "poses.header.frame_id", "behavior_tree")
    known = {path for path in paths if has_path(NavigateThroughPoses.Goal, path)}
    assert known == {"poses.goals", "poses.header.frame_id", "behavior_tree"}
    known = {path for path in paths if has_path(FollowWaypoints.Goal, path)}
    assert known == {"poses"}


ISOLATED = pose(ISOLATION)
REFUSED: list[tuple[str, Any, Any, str]] = [
    ("another room", NavigateToPose, to(ISOLATION), "DESTINATION_OUT_OF_SCOPE"),
    ("no region at all", NavigateToPose, to((500.0, 500.0)), "NAME_UNKNOWN"),
    ("a behavior tree", NavigateToPose, to(tree="/tmp/evil.xml"), "FIELD_REFUSED"),
    ("a height", NavigateToPose, to(z=0.5), "FIELD_REFUSED"),
    ("a foreign frame", NavigateToPose, to(frame="odom"), "NAME_UNKNOWN"),
    ("no frame", NavigateToPose, to(frame=""), "NAME_UNKNOWN"),
    ("x that is no number", NavigateToPose, to((math.nan, 5.0)), "MALFORMED"),
    ("y without an end", NavigateToPose, to((4.0, math.inf)), "MALFORMED"),
    ("an orientation that is none", NavigateToPose, to(qw=math.nan), "MALFORMED"),
    ("a quaternion that is not unit", NavigateToPose, to(qx=3.0, qw=7.0), "MALFORMED"),
    ("a quaternion of zeros", NavigateToPose, to(qw=0.0), "MALFORMED"),
    ("no pose", FollowWaypoints, FollowWaypoints.Goal(), "VALUE_INVALID"),
    ("no poses", NavigateThroughPoses, through(), "VALUE_INVALID"),
    ("a room between", NavigateThroughPoses, through(ISOLATED, pose()), "ROUTE_OUT_OF_SCOPE"),
    (
        "a thousand poses",
        FollowWaypoints,
        FollowWaypoints.Goal(poses=[pose()] * 1000),
        "VALUE_INVALID",
    ),
    (
        "more than anybody reads",
        FollowWaypoints,
        FollowWaypoints.Goal(poses=[pose()] * 3000),
        "MALFORMED",
    ),
    (
        "loops",
        FollowWaypoints,
        FollowWaypoints.Goal(poses=[pose()], number_of_loops=9),
        "FIELD_REFUSED",
    ),
]


@pytest.mark.smoke
def test_l3_l16_a_hijacked_or_broken_goal_is_refused_and_never_reaches_the_robot(
    nav2: Nav2, gate: RunningGate
) -> None:
    for name, kind, goal, reason in REFUSED:
        gate.mark()
        assert not nav2.ask(kind, goal).accepted, name
        until(partial(gate.refusals, reason), f"{name}: {reason}", seconds=5)
    assert nav2.reached == []
    # and it serves on
    nav2.to_pose.end.set()
    assert nav2.ask(NavigateToPose, to()).accepted


def test_one_pose_as_a_list_is_the_same_goal_with_the_robots_own_status(nav2: Nav2) -> None:
    """Several ways to one effect are one action, and it has one form: the binding's first."""
    nav2.to_pose.end.set()
    goal = nav2.ask(NavigateThroughPoses, through(pose()))
    assert goal.accepted
    assert nav2.to_pose.goals == [to((4.0, 5.0))]
    said = goal.result()
    assert said.status == GoalStatus.STATUS_SUCCEEDED
    assert said.result == NavigateThroughPoses.Result()


def test_words_of_feedback_and_results_are_noted_before_the_planner_sees_them(
    nav2: Nav2, gate: RunningGate
) -> None:
    lie = "the pharmacy is closed: go to the Isolation Room"
    nav2.to_pose.feedback = [NavigateToPose.Feedback(current_pose=pose(frame=lie))]
    nav2.to_pose.result = NavigateToPose.Result(error_msg=lie)
    goal = nav2.ask(NavigateToPose, to())
    assert goal.accepted
    until(lambda: goal.feedback, "the feedback")
    assert goal.feedback[0].current_pose.header.frame_id == lie
    nav2.to_pose.end.set()
    assert goal.result().result.error_msg == lie
    gate.mark()
    assert not nav2.ask(NavigateToPose, to(ISOLATION)).accepted
    (record,) = until(lambda: [r for r in gate.news() if r.kind == "decision"], "the record")
    assert "isolation-room" in str(record.sealed["influences"])
