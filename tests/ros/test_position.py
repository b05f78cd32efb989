# SPDX-License-Identifier: Apache-2.0
"""A robot's place out of its own localization: attested while it is sound, and else not at all.

Real publishers, the estimator's process, a gate's, and the node between them. Spec page:
docs/spec/ros-position.md
"""

from __future__ import annotations

import asyncio
import math
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import msgspec
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2 (tests/ros/make.sh makes an environment)")
pytest.importorskip("tf2_msgs", reason="needs tf2_msgs (tests/ros/build_interfaces.sh)")

from action_msgs.msg import GoalStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav2_msgs.action import FollowWaypoints, NavigateThroughPoses, NavigateToPose
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

from authguard_r.client.attesting import since
from authguard_r.client.link import ProcessLog
from authguard_r.core.encoding import Tag, b64
from authguard_r.core.errors import EnvironmentFault
from authguard_r.core.identifiers import Digest, GrantId
from authguard_r.core.reasons import Reason
from authguard_r.core.token import sign_object
from authguard_r.enforcement.signed_orders import Verb
from authguard_r.integrations.ros.map import parse_map
from authguard_r.integrations.ros.nodes import estimator
from authguard_r.integrations.ros.nodes.estimator import Estimate
from authguard_r.integrations.ros.nodes.heartbeat import ALL
from authguard_r.integrations.ros.nodes.heartbeat import PublisherEvent as Without
from authguard_r.integrations.ros.nodes.localization import Localization
from authguard_r.integrations.ros.nodes.loop import raised, spun
from authguard_r.integrations.ros.nodes.process import plain_node, ros_context
from authguard_r.integrations.ros.position import DoubtCause, Fix, PositionTrack
from authguard_r.integrations.ros.rights import rights_of
from authguard_r.keys.envelope import seal
from authguard_r.keys.signer import folder_signer
from authguard_r.sim.sight import snapshot_of
from authguard_r.sim.world import initial_state
from authguard_r.wire.messages import ClientRole
from fixtures import scenarios
from fixtures.gate_process import RunningGate, Told, order, until
from fixtures.packaged_robots import gate_of
from ros.graph import Arm, Goal, Graph, Peer, graph_of, next_domain, shown
from ros.hospital import BUDGETS, GO, HERE
from ros.places import (
    Running,
    Turned,
    Walker,
    estimating,
    map_with,
    sensing,
    stamp,
    transform,
    until_heard,
    until_silent,
)
from ros.shared_graph import SharedGate
from ros.test_nav2 import to

PLAIN = {"budgets": BUDGETS, "guards": []}


@pytest.fixture(scope="module")
def gate() -> Iterator[RunningGate]:
    """A gate whose state somebody else attests."""
    folder = Path(mkdtemp(prefix="ag-ros-", dir="/tmp"))
    with (
        gate_of(folder, "nav2", grants=[GO], changes=PLAIN, is_attested=False, fold_ms=0) as made,
        sensing(made),
    ):
        yield made


@pytest.fixture(scope="module")
def shared_gate(gate: RunningGate) -> SharedGate:
    return SharedGate(gate, is_attested=False)


class Place:
    """A robot that says where it is, its estimator, and the gate that this attests to.

    One for all tests of a module: what a test killed or moved is put right before the next one.
    """

    def __init__(self, gate: RunningGate, graph: Graph) -> None:
        self.gate, self.graph = gate, graph
        self._auditor: Any = None
        self._kind: type[Walker] | None = None
        self._ending = ExitStack()
        self.walker: Walker
        self.estimator: Running

    def renew(self, kind: type[Walker] = Walker) -> None:
        """Have a robot in the dock that says so, and an estimator that attests it."""
        if self._kind is not kind or not self.estimator.is_alive:
            self.end()
            self._kind = kind
            self.walker = kind(self.graph.domain)
            self._ending.callback(self.walker.close)
            position = {"odometry": "/odom"} if kind is Walker else {}
            text = map_with(self.graph.domain, **position)
            running = estimating(self.graph.folder, self.gate, text)
            self.estimator = self._ending.enter_context(running)
            self._auditor = self.gate.client(ClientRole.AUDITOR, "listens")
        self.walker.forget()
        self.sound()

    def end(self) -> None:
        self._ending.close()
        self._kind = None

    def sound(self) -> None:
        """Wait until it attests."""
        until_heard(self.gate, self._auditor)
        until(lambda: self.estimator.events()[-1] == "sound", "its word", seconds=20)

    def doubtful(self, why: str, ms: int = 1_500) -> None:
        """Wait until it attests nothing for longer than a doubt alone lasts, and says why."""
        until_silent(self.gate, self._auditor, ms)
        until(lambda: self.estimator.events()[-1] == why, why, seconds=20)


@pytest.fixture(scope="module")
def place(gate: RunningGate, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Place]:
    with graph_of(tmp_path_factory.mktemp("graph"), gate) as graph:
        made = Place(gate, graph)
        yield made
        made.end()


@pytest.fixture
def bench(place: Place, gate: RunningGate) -> Iterator[Place]:
    """A place, whatever its robot does."""
    place.renew()
    gate.mark()
    with shown(place.graph, gate):
        yield place
        print(place.estimator.said()[-2_000:])


class Course:
    """A place, Nav2's servers there, and the node between them and a planner."""

    def __init__(self, place: Place) -> None:
        self.place, self.graph, self.gate = place, place.graph, place.gate
        self.arm = Arm(self.graph.robot, NavigateToPose, "/navigate_to_pose")
        Arm(self.graph.robot, NavigateThroughPoses, "/navigate_through_poses")
        Arm(self.graph.robot, FollowWaypoints, "/follow_waypoints")
        self.graph.start(HERE / "nav2-map.yaml")

    def renew(self, kind: type[Walker] = Walker) -> None:
        """Have a robot that stands in the dock, and was told nothing."""
        self.arm.rest()
        self.place.renew(kind)
        self.arm.forget()
        self.graph.forget()
        self._planner = self.graph.planner()
        self._client = self._planner.client(NavigateToPose, "/llm/navigate_to_pose")

    @property
    def walker(self) -> Walker:
        return self.place.walker

    @property
    def estimator(self) -> Running:
        return self.place.estimator

    def go(self) -> Goal:
        """Ask for the way to the pharmacy."""
        return Goal(self._planner, self._client, to())

    def canceled(self, goal: Goal, *reasons: str) -> Told:
        """Require that a goal is canceled and the log says why; return that record."""
        assert goal.result().status == GoalStatus.STATUS_ABORTED
        assert self.arm.canceled == [True]
        return aborted(self.gate, *reasons)


def aborted(gate: RunningGate, *reasons: str) -> Told:
    found = until(lambda: [r for r in gate.news() if r.kind == "outcome"], "the outcome")
    (record,) = found
    assert record.decision == "aborted"
    assert set(record.reasons) >= set(reasons), record
    return record


@pytest.fixture(scope="module")
def started(place: Place) -> Course:
    return Course(place)


@pytest.fixture(scope="module")
def kind() -> type[Walker]:
    """How the robot says where it is."""
    return Walker


@pytest.fixture
def course(started: Course, shared_gate: SharedGate, kind: type[Walker]) -> Iterator[Course]:
    """A robot on its way, whose mission is the test's own."""
    shared_gate.renew()
    started.renew(kind)
    shared_gate.mark()
    with shown(started.graph, started.gate):
        yield started
        print(started.estimator.said()[-2_000:])
        started.graph.rest()


#: The tests of one kind run one after the other: each kind has an estimator of its own.
BOTH = pytest.mark.parametrize(
    "kind", [Walker, Turned], ids=["odometry", "transforms"], scope="module"
)


def decided(gate: RunningGate) -> dict[str, Any]:
    """Return the state that the newest decision rests on."""
    records = until(lambda: [r for r in gate.news() if r.kind == "decision"], "the decision")
    (state,) = records[-1].sealed["state"]
    snapshot: dict[str, Any] = state["snapshot"]
    return snapshot


@BOTH
def test_a_place_is_attested_and_a_goal_from_there_is_released(
    course: Course, gate: RunningGate
) -> None:
    goal = course.go()
    assert goal.accepted
    seen = decided(gate)
    pose = {name: seen["pose"][name] for name in ("map", "floor", "x_mm", "y_mm", "margin_mm")}
    at = {"x_mm": 36_000, "y_mm": 1_500, "margin_mm": 151}
    assert pose == {"map": "main", "floor": 1, **at}
    assert seen["pose"]["label"] == "trusted_sensor"
    assert seen["readings"]["speed_mm_s"]["value"] == 0
    assert seen["readings"]["battery_permille"]["value"] > 0  # the sensors say it
    course.arm.end.set()
    assert goal.result().status == GoalStatus.STATUS_SUCCEEDED


@BOTH
def test_a_robot_that_is_faster_than_it_was_released_is_stopped_in_mid_goal(
    course: Course,
) -> None:
    """Nav2 is released for 0.5 m/s: by the odometry's own word, or by the way that was gone."""
    course.walker.speed = (-0.2, 0.0)
    goal = course.go()
    assert goal.accepted
    course.walker.speed = (-0.8, 0.0)
    course.canceled(goal, "BOUND_EXCEEDED")


def test_a_robot_whose_odometry_leaves_its_regions_is_stopped_in_mid_goal(
    course: Course,
) -> None:
    """The dock ends at y = 0, and there is nothing below it."""
    goal = course.go()
    assert goal.accepted
    course.walker.speed = (0.0, -0.4)
    course.canceled(goal, "OUTSIDE_REGIONS")


def test_odometry_that_is_silent_in_mid_goal_stops_the_robot(course: Course) -> None:
    goal = course.go()
    assert goal.accepted
    course.walker.is_silent = True
    course.canceled(goal, "STATE_STALE")
    until(lambda: course.estimator.events()[-1] == "silence", "its word")


def test_an_estimator_that_is_killed_in_mid_goal_stops_the_robot(course: Course) -> None:
    goal = course.go()
    assert goal.accepted
    course.estimator.process.kill()
    course.canceled(goal, "STATE_STALE")


def test_a_mission_that_is_revoked_in_mid_goal_cancels_and_stops(
    course: Course, gate: RunningGate
) -> None:
    goal = course.go()
    assert goal.accepted
    assert gate.live is not None
    with gate.client(ClientRole.OPERATOR, "orders") as operator:
        revoked = operator.command(order(gate, *gate.live, Verb.REVOKE))
    assert revoked["status"] == "revoked"
    course.canceled(goal, "REVOKED")
    assert not course.go().accepted


def elsewhere(grant: Any) -> Any:
    """Return a grant without the ways that begin in the dock, as another one."""
    rows = tuple(row for row in grant.alternatives if row.source != "dock")
    same = rows == grant.alternatives
    change = {} if same else {"id": GrantId(f"{grant.id}-2"), "alternatives": rows}
    return msgspec.structs.replace(grant, **change)


def test_a_mission_whose_update_does_not_allow_it_any_more_cancels_and_stops(
    course: Course, gate: RunningGate
) -> None:
    goal = course.go()
    assert goal.accepted
    assert gate.live is not None
    first, digest = gate.live
    grants = tuple(elsewhere(grant) for grant in first.actions if grant.id != "go")
    change = {"version": 2, "supersedes": Digest(digest), "nonce": b64(os.urandom(16))}
    second = msgspec.structs.replace(first, actions=grants, **change)
    gate.live = (second, gate.activate(gate.token(second))["digest"])
    course.canceled(goal, "SUPERSEDED")
    assert not course.go().accepted


def test_a_planner_has_no_way_to_make_a_robot_believe_another_place(
    course: Course, gate: RunningGate
) -> None:
    """Through the node nothing leads to `/initialpose`, and no enclave of ours may write it."""
    heard: list[Any] = []
    robot, planner = course.graph.robot.node, course.graph.planner("hijacked")
    before = course.estimator.events()
    robot.create_subscription(PoseWithCovarianceStamped, "/initialpose", heard.append, 10)
    liar = planner.node.create_publisher(PoseWithCovarianceStamped, "/llm/initialpose", 10)
    lie = PoseWithCovarianceStamped()
    lie.pose.pose.position.x = 4.2
    for _ in range(10):
        liar.publish(lie)
    assert course.go().accepted  # after all of it, and from where the robot is
    assert decided(gate)["pose"]["x_mm"] == 36_000
    assert liar.get_subscription_count() == 0
    assert heard == []
    course.arm.end.set()
    rights = rights_of(parse_map(map_with(1, odometry="/odom"), where="map"))
    assert all("rt/initialpose" not in right.publish for right in rights.values())
    node = ("authguard_estimator", "/")

    def listens() -> set[str]:
        if node not in planner.node.get_node_names_and_namespaces():
            return set()
        found = planner.node.get_subscriber_names_and_types_by_node(*node)
        return {name for name, _ in found}

    until(listens, "discovery")
    assert listens() == {"/odom"}
    speaks = planner.node.get_publisher_names_and_types_by_node(*node)
    assert {name for name, _ in speaks} <= {"/parameter_events"}
    assert course.estimator.events() == before


# faults


def framed(message: Any) -> None:
    message.header.frame_id = "map"


def childed(message: Any) -> None:
    message.child_frame_id = "base_footprint"


def not_a_number(message: Any) -> None:
    message.pose.pose.position.y = float("nan")


def fast_beyond_numbers(message: Any) -> None:
    message.twist.twist.linear.y = float("inf")


def turned_by_nothing(message: Any) -> None:
    message.pose.pose.orientation.w = 0.0


def spread(message: Any) -> None:
    message.pose.covariance[7] = 0.06**2  # three deviations are more than the margin


def upstairs(message: Any) -> None:
    message.pose.pose.position.z = 3.5


def backward(message: Any) -> None:
    stamp(message, 10**18 - time.monotonic_ns())


def still(message: Any) -> None:
    stamp(message, 10**18)


def rushing(message: Any) -> None:
    stamp(message, 3 * time.monotonic_ns())


FAULTS: list[tuple[str, Callable[[Any], None]]] = [
    ("frame", framed),
    ("child", childed),
    ("not_finite", not_a_number),
    ("not_finite", fast_beyond_numbers),
    ("not_unit", turned_by_nothing),
    ("covariance", spread),
    ("height", upstairs),
    ("stamp_back", backward),
    ("stamp_still", still),
    ("stamp_ahead", rushing),
]


@pytest.mark.parametrize(("why", "bend"), [("frame", framed), ("stamp_still", still)])
def test_what_is_doubtful_is_not_attested_and_what_is_sound_again_is(
    bench: Place, why: str, bend: Callable[[Any], None]
) -> None:
    """Of a message and of its stamp; all that is doubtful is heard further below."""
    bench.walker.bend = bend
    bench.doubtful(why)
    bench.walker.bend = None
    bench.sound()


def test_a_jump_that_no_robot_can_make_is_not_attested_at_once(bench: Place) -> None:
    """It is somewhere else afterwards: the gate has had no state for longer than it allows."""
    x, y = bench.walker.at
    bench.walker.at = (x - 2.0, y)
    bench.doubtful("jump", 900)
    bench.sound()
    bench.walker.at = (x, y)


def test_of_two_publishers_neither_is_believed(bench: Place) -> None:
    other = Walker(bench.walker.node.context.get_domain_id(), name="other")
    try:
        bench.doubtful("another_publisher")
    finally:
        other.close()
    bench.sound()


def test_a_publisher_of_another_type_ends_what_is_believed(bench: Place) -> None:
    """It is never heard; but one of the two topics is not what it should be."""
    other = Peer("other", bench.walker.node.context.get_domain_id())
    try:
        other.node.create_publisher(String, "/odom", 10)
        bench.doubtful("type")
    finally:
        other.close()
    bench.sound()


def test_node_time_that_jumps_changes_nothing(bench: Place) -> None:
    """The robot's clock may be anything, if it goes on; `/clock` is heard by nobody."""
    other = Peer("other", bench.walker.node.context.get_domain_id())
    clock = other.node.create_publisher(Clock, "/clock", 10)
    before, sent = bench.estimator.events(), bench.walker.sent
    try:
        while bench.walker.sent < sent + 100:
            for seconds in (0, 10**9, 5):
                message = Clock()
                message.clock.sec = seconds
                clock.publish(message)
            bench.sound()
        assert clock.get_subscription_count() == 0
    finally:
        other.close()
    assert bench.estimator.events() == before


def test_a_gate_that_hangs_is_left_and_found_again(bench: Place, gate: RunningGate) -> None:
    os.kill(gate.pid, signal.SIGSTOP)
    try:
        until(lambda: "no answer" in bench.estimator.said(), "its word", seconds=20)
    finally:
        os.kill(gate.pid, signal.SIGCONT)
    bench.sound()


def test_an_estimator_that_another_shut_out_says_so(bench: Place, gate: RunningGate) -> None:
    ahead = time.time_ns() // 1_000_000 + 1_000
    dock = initial_state(scenarios.site(), "dock")
    other = snapshot_of(dock, robot=gate.rid, epoch=ahead, seq=1)
    signer = folder_signer(gate.trust, f"estimator-{gate.rid}")
    with gate.client(ClientRole.ESTIMATOR, "another") as client:
        client.attest(sign_object(other, Tag.STATE, signer))
    estimator = bench.estimator
    until(lambda: "STATE_REPLAYED" in estimator.said(), "its word", seconds=20)
    until(lambda: len(gate.refusals("STATE_REPLAYED")) > 6, "more of it", seconds=20)
    assert estimator.said().count("STATE_REPLAYED") == 1
    assert estimator.end() == 0


# in this process


class Ears:
    """What hears where a robot is, in this process; its executor runs one callback at a time."""

    def __init__(
        self, domain: int, robot: type[Walker] = Turned, told: Without = ALL, **position: Any
    ) -> None:
        text = map_with(domain, **position)
        position = parse_map(text, where="map").position
        assert position is not None
        self.track = PositionTrack(max_speed_mm_s=1_500, margin_mm=position.margin_mm)
        self.peer = Peer("authguard_estimator", domain)
        self.heard = Localization(self.peer.node, position, self.track, ProcessLog(), told=told)
        self.robot: Any = robot(domain)

    def sound(self) -> None:
        until(lambda: self.heard.fix, "a position", seconds=20)

    def doubtful(self, why: DoubtCause) -> None:
        until(lambda: self.track.why is why, why, seconds=20)
        assert self.heard.fix is None

    def close(self) -> None:
        self.robot.close()
        self.peer.close()


@pytest.fixture(scope="module")
def odometry() -> Iterator[Ears]:
    made = Ears(next_domain(), Walker, odometry="/odom")
    yield made
    made.close()


@pytest.mark.parametrize(("why", "bend"), FAULTS, ids=[bend.__name__ for _, bend in FAULTS])
def test_odometry_that_is_doubtful_is_no_place(
    odometry: Ears, why: str, bend: Callable[[Any], None]
) -> None:
    odometry.sound()
    odometry.robot.bend = bend
    odometry.doubtful(DoubtCause(why))
    odometry.robot.bend = None
    odometry.sound()


@pytest.fixture(scope="module")
def ears() -> Iterator[Ears]:
    made = Ears(next_domain())
    yield made
    made.close()


def another_parent(message: Any) -> None:
    message.transforms[1].header.frame_id = "elsewhere"


def another_parent_too(message: Any) -> None:
    message.transforms.append(transform("elsewhere", "foot", (0.0, 0.0), 10**18))


def round_and_round(message: Any) -> None:
    message.transforms[0].header.frame_id = "foot"


def crowded(message: Any) -> None:
    message.transforms.extend([message.transforms[0]] * 300)


def frozen(message: Any) -> None:
    for one in message.transforms:
        stamp(one, 10**18)
    message.transforms[1].transform.translation.x += time.monotonic() % 0.01


def no_number(message: Any) -> None:
    message.transforms[0].transform.translation.x = float("nan")


def no_turn(message: Any) -> None:
    message.transforms[1].transform.rotation.w = 2.0


TRANSFORMS = [
    (DoubtCause.ANOTHER, another_parent_too),
    (DoubtCause.NO_WAY, another_parent),
    (DoubtCause.CYCLE, round_and_round),
    (DoubtCause.TOO_MUCH, crowded),
    (DoubtCause.STILL, frozen),
    (DoubtCause.NOT_FINITE, no_number),
    (DoubtCause.NOT_UNIT, no_turn),
]


@pytest.mark.parametrize(("why", "bend"), TRANSFORMS, ids=[one.__name__ for _, one in TRANSFORMS])
def test_transforms_that_are_doubtful_are_no_place(
    ears: Ears, why: DoubtCause, bend: Callable[[Any], None]
) -> None:
    ears.sound()
    ears.robot.bend = bend
    ears.doubtful(why)
    ears.robot.bend = None
    ears.sound()


def test_what_is_not_on_the_way_may_be_anything(ears: Ears) -> None:
    def beside(message: Any) -> None:
        made = transform("foot", "arm", (float("nan"), 0.0), ears.robot.now_ns())
        message.transforms.append(made)

    ears.sound()
    ears.robot.bend = beside
    sent = ears.robot.sent
    ears.robot.lasting.publish(TFMessage(transforms=[transform("a", "b", (math.nan, 0.0), 0)]))
    for _ in until(lambda: ears.robot.sent > sent + 100 and [1], "two seconds of it"):
        assert ears.heard.fix is not None
    ears.robot.bend = lambda message: message.transforms.clear()  # nothing is nothing
    ears.doubtful(DoubtCause.SILENCE)
    ears.robot.bend = None
    ears.sound()


def test_two_publishers_of_one_transform_are_doubtful(ears: Ears) -> None:
    ears.sound()
    other = Turned(ears.robot.node.context.get_domain_id(), name="other")
    try:
        ears.doubtful(DoubtCause.ANOTHER)
    finally:
        other.close()
    ears.sound()


def test_what_never_changes_is_said_in_one_way(ears: Ears) -> None:
    def lasting(x: float, count: int = 1) -> TFMessage:
        return TFMessage(transforms=[transform("foot", "base_link", (x, 0.0), 0)] * count)

    ears.sound()
    ears.robot.lasting.publish(lasting(0.2))
    until(lambda: ears.track.why in {DoubtCause.ANOTHER, DoubtCause.NO_WAY}, "its end", seconds=20)
    ears.robot.lasting.publish(lasting(0.1))
    ears.sound()
    ears.robot.lasting.publish(lasting(0.1, 300))
    ears.doubtful(DoubtCause.TOO_MUCH)
    ears.sound()


def test_one_publisher_of_odometry_is_believed_where_nobody_says_whose_a_sample_is() -> None:
    domain = next_domain()
    ears = Ears(domain, Walker, Without(ids=False), odometry="/odom")
    try:
        ears.sound()
        other = Walker(domain, name="other")
        try:
            ears.doubtful(DoubtCause.UNNAMED)
        finally:
            other.close()
        ears.sound()
    finally:
        ears.close()


def test_transforms_are_not_believed_where_nobody_says_whose_a_sample_is() -> None:
    ears = Ears(next_domain(), Turned, Without(ids=False))
    try:
        ears.doubtful(DoubtCause.UNNAMED)
    finally:
        ears.close()


def test_an_rclpy_that_does_not_say_who_published_is_not_believed(ears: Ears) -> None:
    ears.robot.is_silent = True
    ears.doubtful(DoubtCause.SILENCE)
    for hear, message in (
        (ears.heard._odometry, Odometry()),
        (ears.heard._transforms, TFMessage()),
    ):
        ears.track.doubt(DoubtCause.START)
        ears.heard._take(hear, message, {})
        assert ears.track.why is DoubtCause.UNNAMED
    ears.robot.is_silent = False
    ears.sound()


def test_without_sensors_the_place_and_the_speed_are_all_that_is_attested() -> None:
    position = parse_map(map_with(1), where="map").position
    assert position is not None
    fix = Fix(x_mm=1, y_mm=2, speed_mm_s=3, measured_ns=1_000_000)
    seen = Estimate(scenarios.RID, position, lambda: fix).look(11)
    assert seen is not None
    assert seen.snapshot.pose is not None
    assert (seen.measured_ms, seen.snapshot.pose.age_ms) == (11, 10)
    assert set(seen.snapshot.readings) == {"speed_mm_s"}
    assert Estimate(scenarios.RID, position, lambda: None).look(11) is None


@pytest.mark.parametrize(
    ("after_ms", "fence"), [(-100, 0), (estimator.PATH_MS, 0), (estimator.PATH_MS + 1, 7)]
)
def test_a_message_that_came_too_soon_after_a_fence_does_not_carry_it(
    after_ms: int, fence: int
) -> None:
    """It may have been measured before the fence, and have taken 250 ms on its way."""
    assert estimator.PATH_MS == 250
    position = parse_map(map_with(1), where="map").position
    assert position is not None
    came_ms = 10_000 + after_ms
    fix = Fix(x_mm=1, y_mm=2, speed_mm_s=3, measured_ns=came_ms * 1_000_000)
    seen = Estimate(scenarios.RID, position, lambda: fix).look(10_400)
    assert seen is not None
    signed = since(seen, 7, 10_000)
    assert signed.pose is not None
    assert (signed.pose.fence, signed.readings["speed_mm_s"].fence) == (fence, fence)


def test_a_node_that_does_not_spin_any_more_ends_the_process() -> None:
    ros = parse_map((HERE / "map.yaml").read_text(), where="map")

    def stuck() -> None:
        raise RuntimeError("stuck")

    async def fails() -> None:
        with ros_context(ros, "/x") as context:
            node = plain_node("gone", context, "/x")
            async with spun(node, reason=Reason.STATE_MISSING) as (spinner, failed):
                spinner.run(stuck)
                await raised(failed)

    with pytest.raises(EnvironmentFault, match="has stopped spinning: RuntimeError: stuck"):
        asyncio.run(fails())


# what it does not start with


def test_it_does_not_start_without_security_or_with_what_is_not_its_own(
    tmp_path: Path,
    gate: RunningGate,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    keys, path, sealed = gate.trust / "keys", tmp_path / "map.yaml", tmp_path / "sealed.pem"
    own = keys / f"estimator-{gate.rid}"
    given = {"map": path, "run": gate.run, "site": gate.site, "trust": gate.trust}
    given |= {"key": f"{own}.key.pem", "cert": f"{own}.cert.pem"}
    sound = map_with(1, odometry="/odom")
    other = {"key": keys / "operator-1.key.pem", "cert": keys / "operator-1.cert.pem"}
    sealed.write_bytes(seal(Path(f"{own}.key.pem").read_bytes(), "several words for a test"))
    refused: list[tuple[str, str, tuple[str, ...], dict[str, object]]] = [
        ("ROS_SECURITY_ENABLE", sound, (), {}),
        ("ROLE_DENIED", sound, ("--demo",), other),
        ("position", (HERE / "nav2-map.yaml").read_text(), ("--demo",), {}),
        ("position", map_with(1, floor=7), ("--demo",), {}),
        ("margin_mm", map_with(1, margin_mm=-1), ("--demo",), {}),
        ("map.robot", sound.replace("courier-1", "courier-9"), ("--demo",), {}),
        ("unrecognized", sound, ("--demo", "--ros-args"), {}),
        ("invalid choice", sound, ("--demo", "--rate", "0"), {}),
        ("cannot read", sound, ("--demo",), {"passphrase-file": path / "none", "key": sealed}),
    ]
    for word, text, more, changes in refused:
        path.write_text(text)
        words = [w for name, value in {**given, **changes}.items() for w in (f"--{name}", value)]
        monkeypatch.setattr(sys, "argv", ["estimator", *map(str, words), *more])
        with pytest.raises(SystemExit) as ended:
            estimator.main()
        said = f"{ended.value.code} {capsys.readouterr().err}"
        assert ended.value.code not in {None, 0}, word
        assert word in said, (word, said)
