# SPDX-License-Identifier: Apache-2.0
"""What a robot says of its own place: odometry, or transforms, as positions that are judged.

Nothing is published, and nothing is read of the clock of ROS: stamps are a publisher's own clock,
and only how they go on counts. Spec page: docs/spec/ros-position.md
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from authguard_r.client.link import ProcessLog
from authguard_r.integrations.ros.map import Position
from authguard_r.integrations.ros.names import TypePart
from authguard_r.integrations.ros.nodes.heartbeat import ALL, PublisherEvent, require_name, steady
from authguard_r.integrations.ros.nodes.values import load_type
from authguard_r.integrations.ros.position import (
    MS,
    DoubtCause,
    Fix,
    PositionSample,
    PositionTrack,
    Stamps,
    covariance_fault,
)
from authguard_r.integrations.ros.transforms import (
    MAX_FRAMES,
    Frames,
    Placed,
    Quaternion,
    Vector,
    fault_of,
)

ODOMETRY, TRANSFORMS = "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"
TF, TF_STATIC = "/tf", "/tf_static"
#: Between two looks at the clock, in seconds.
LOOK_S = 0.05
#: Between two looks at who publishes, in looks at the clock: several before anything is attested.
_TYPES = 5
#: What is doubtful is said so often at most, in milliseconds.
SAY_MS = 1_000
#: A child that samples of transforms are of has many publishers: each link is held to its own.
_TOGETHER = b"tf"


def _qos(*, lasting: bool = False) -> QoSProfile:
    """Return a profile that every publisher's fits: what was lost is silence, and noticed."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=MAX_FRAMES if lasting else 10,
        reliability=ReliabilityPolicy.RELIABLE if lasting else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if lasting else DurabilityPolicy.VOLATILE,
    )


class Localization:
    """Hears where the robot is, and says `fix` while nothing about it is doubtful.

    Args:
        node: its owner; its executor has one thread.
        position: where to hear it.
        track: judges it.
        log: says why nothing is attested, and when something is again.
        told: what is asked of the middleware.

    Raises:
        EnvironmentFault: the type is not installed, or a name is remapped.
    """

    def __init__(
        self,
        node: Node,
        position: Position,
        track: PositionTrack,
        log: ProcessLog,
        *,
        told: PublisherEvent = ALL,
    ) -> None:
        self._node = node
        self._told = told
        #: the one publisher of odometry, where `rclpy` does not name who says what; empty: several
        self._only = b""
        self._position = position
        self._track = track
        self._log = log
        self._frames = Frames()
        self._stamps = Stamps()
        self._topics: dict[str, str] = {}
        self._looks = self._said_ns = 0
        if position.odometry:
            self._listen(position.odometry, ODOMETRY, self._odometry)
        else:
            self._listen(TF, TRANSFORMS, self._transforms)
            self._listen(TF_STATIC, TRANSFORMS, self._transforms_for_ever, lasting=True)
        node.create_timer(LOOK_S, self._look, None, steady())

    @property
    def fix(self) -> Fix | None:
        """What may be attested now; any thread may ask."""
        return self._track.fix

    def _listen(
        self,
        topic: str,
        kind: str,
        hear: Callable[[Any, bytes, int], DoubtCause | None],
        *,
        lasting: bool = False,
    ) -> None:
        require_name(self._node, topic)
        self._topics[topic] = kind
        take = partial(self._take, hear)
        loaded = load_type(kind, TypePart.MESSAGE)

        # rclpy looks at how many arguments a callback has
        def heard(message: Any, origin: Mapping[str, Any]) -> None:
            take(message, origin)

        events = SubscriptionEventCallbacks(matched=self._matched) if kind == ODOMETRY else None
        self._node.create_subscription(
            loaded, topic, heard, _qos(lasting=lasting), event_callbacks=events
        )

    def _matched(self, event: Any) -> None:
        """Name the one publisher of odometry by when it was found: another one is another."""
        is_only = event.current_count == 1
        self._only = b"only %d" % event.total_count if is_only else b""

    def _take(
        self,
        hear: Callable[[Any, bytes, int], DoubtCause | None],
        message: Any,
        origin: Mapping[str, Any],
    ) -> None:
        """Take a message; the clock is read first, so that what waited counts as late."""
        arrived_ns = time.monotonic_ns()
        named = origin.get("publisher_gid") if self._told.ids else None
        who = self._only if named is None else bytes(named["data"])
        why = hear(message, who, arrived_ns)
        if why is not None:
            self._doubt(why)

    def _doubt(self, why: DoubtCause) -> None:
        self._track.doubt(why)
        self._stamps = Stamps()

    # odometry

    def _odometry(self, message: Any, who: bytes, arrived_ns: int) -> DoubtCause | None:
        """Judge a message of odometry; return why it is not even a position."""
        wanted, stranger = self._position, self._track.stranger(who)
        if stranger is not None:  # before its stamps are taken for the other one's
            return stranger
        if message.header.frame_id != wanted.frame:
            return DoubtCause.FRAME
        if message.child_frame_id != wanted.child:
            return DoubtCause.CHILD
        placed = _placed(message.pose.pose.position, message.pose.pose.orientation)
        fault = fault_of(placed) or covariance_fault(message.pose.covariance, wanted.margin_mm)
        if fault is not None:
            return fault
        measured = self._stamps.take(_stamp_ns(message.header), arrived_ns)
        if isinstance(measured, DoubtCause):
            return measured
        speed = message.twist.twist.linear
        self._judge(
            PositionSample(
                x=placed.at.x,
                y=placed.at.y,
                z=placed.at.z,
                who=who,
                newest_ns=measured,
                oldest_ns=measured,
                speed=math.hypot(speed.x, speed.y, speed.z),
            )
        )
        return None

    def _judge(self, sample: PositionSample) -> None:
        self._track.take(sample)
        if self._track.is_lost:
            self._stamps = Stamps()

    # transforms

    def _transforms(self, message: Any, who: bytes, arrived_ns: int) -> DoubtCause | None:
        """Take transforms, and judge where they lead if any of them is on the way."""
        if len(message.transforms) > MAX_FRAMES:
            return DoubtCause.TOO_MUCH
        if not who:
            return DoubtCause.UNNAMED
        wanted, frames = self._position, self._frames
        on_way, faults = set[str](), dict[str, DoubtCause]()
        on_way |= frames.on_way(wanted.frame, wanted.child)
        for one in message.transforms:
            fault = frames.put(
                one.child_frame_id,
                one.header.frame_id,
                _placed(one.transform.translation, one.transform.rotation),
                who=who,
                stamp_ns=_stamp_ns(one.header),
                arrived_ns=arrived_ns,
            )
            if fault is not None:
                faults[one.child_frame_id] = fault
        on_way |= frames.on_way(wanted.frame, wanted.child)
        for child, why in faults.items():
            if child in on_way or why is DoubtCause.TOO_MUCH:
                return why
        if any(one.child_frame_id in on_way for one in message.transforms):
            return self._go()
        return None

    def _transforms_for_ever(self, message: Any, *_: object) -> DoubtCause | None:
        """Take transforms that never change."""
        if len(message.transforms) > MAX_FRAMES:
            return DoubtCause.TOO_MUCH
        frames = self._frames
        on_way = frames.on_way(self._position.frame, self._position.child)
        for one in message.transforms:
            placed = _placed(one.transform.translation, one.transform.rotation)
            why = frames.put_static(one.child_frame_id, one.header.frame_id, placed)
            if why is not None and (one.child_frame_id in on_way or why is DoubtCause.TOO_MUCH):
                return why
        return None

    def _go(self) -> DoubtCause | None:
        """Judge where the transforms lead now."""
        way = self._frames.way(self._position.frame, self._position.child)
        if isinstance(way, DoubtCause):
            return way
        at = way.at
        self._judge(
            PositionSample(
                x=at.x,
                y=at.y,
                z=at.z,
                who=_TOGETHER,
                newest_ns=way.newest_ns,
                oldest_ns=way.oldest_ns,
            )
        )
        return None

    # the clock

    def _look(self) -> None:
        now_ns = time.monotonic_ns()
        self._track.look(now_ns)
        self._looks += 1
        if self._looks % _TYPES == 0 and not all(map(self._is_of_type, self._topics)):
            self._doubt(DoubtCause.TYPE)
        if now_ns - self._said_ns >= SAY_MS * MS:
            self._say(now_ns)

    def _is_of_type(self, topic: str) -> bool:
        """Return False when a publisher uses another type, or another version of it.

        Any publisher may say so of itself, and that never adds trust: it only ends it.
        """
        mine = {
            (one.topic_type, str(one.topic_type_hash))
            for one in self._node.get_subscriptions_info_by_topic(topic)
            if one.node_name == self._node.get_name()
        }
        theirs = {
            (one.topic_type, str(one.topic_type_hash))
            for one in self._node.get_publishers_info_by_topic(topic)
        }
        return theirs <= mine

    def _say(self, now_ns: int) -> None:
        why = self._track.why
        if why is None:
            self._log.say("sound", "position")
        else:
            self._log.say("doubtful", "position", why=why)
        self._said_ns = now_ns


def _placed(at: Any, turned: Any) -> Placed:
    return Placed(Vector(at.x, at.y, at.z), Quaternion(turned.x, turned.y, turned.z, turned.w))


def _stamp_ns(header: Any) -> int:
    return int(header.stamp.sec) * 1_000 * MS + int(header.stamp.nanosec)
