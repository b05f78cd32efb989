# SPDX-License-Identifier: Apache-2.0
"""What is said all the time while the gate's node lives, and how it is listened to.

A topic that moves the robot is its own heartbeat: it is published at 50 Hz, standing included. A
heartbeat beside it serves actions, which have none. Both are silent as soon as their owner's loop
does not turn: who only has a thread that still runs is not alive.
Spec page: docs/spec/ros-stopping.md#heartbeats
"""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable, Mapping
from typing import Any

from msgspec import Struct
from rclpy.callback_groups import CallbackGroup, MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks, UnsupportedEventTypeError
from rclpy.node import Node
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)
from rclpy.subscription import Subscription
from std_msgs.msg import UInt64

from authguard_r.core.errors import EnvironmentFault
from authguard_r.core.reasons import Reason
from authguard_r.integrations.ros.latch import MS, Latch, LatchCause

#: Between two samples, in milliseconds: 50 Hz.
PERIOD_MS = 20
#: DDS misses a sample after so long: four may be late or lost, and at 0.8 m/s a robot goes 8 cm.
DEADLINE_MS = 100
#: DDS takes a publisher for dead after so long: three deadlines, for what a deadline cannot see.
LIVELINESS_MS = 300
#: The own watch of who listens: one sample after DDS, so that a log names DDS where DDS works.
SILENCE_MS = DEADLINE_MS + PERIOD_MS
#: Only standing is heard for so long before anything goes again: two deadlines, ten samples.
SETTLE_MS = 2 * DEADLINE_MS
#: A loop that has not turned for so long is stuck; less than a deadline, so that both fit in 200.
TURN_MS = 80
_LIVES = 1 << 64


def actuation_qos() -> QoSProfile:
    """Return the profile of heartbeats and of topics that move the robot.

    A publisher of any other profile that promises less, the default one too, is not matched. That
    keeps mistakes away, not attackers: only SROS2 does.
    """
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=1,  # an old velocity is worth nothing
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.VOLATILE,  # who comes late hears of no velocity before it came
        deadline=Duration(nanoseconds=DEADLINE_MS * MS),
        liveliness=LivelinessPolicy.MANUAL_BY_TOPIC,  # a process that only exists asserts nothing
        liveliness_lease_duration=Duration(nanoseconds=LIVELINESS_MS * MS),
    )


def steady() -> Clock:
    """Return a clock that cannot be set: timers never follow `/clock`."""
    return Clock(clock_type=ClockType.STEADY_TIME)


def new_latch() -> Latch:
    """Return a latch with this module's figures."""
    return Latch(silence_ms=SILENCE_MS, settle_ms=SETTLE_MS)


class PublisherEvent(Struct, frozen=True, kw_only=True):
    """What the middleware knows of publishers, and what a listener has to do without.

    Args:
        events: that one came, is late or is gone; False leaves the own watch alone.
        ids: whose each sample is; an older rclpy does not say it.
    """

    events: bool = True
    ids: bool = True


ALL = PublisherEvent()


class Heartbeat:
    """Publishes every `PERIOD_MS` while its owner lives.

    It is driven by a timer of the owner's executor: where that stands still, nothing is said. An
    executor with several threads needs the callback group of what mediates, for another thread
    would go on; and what runs beside it, such as a loop of asyncio, `still_alive` has to ask.

    Args:
        node: its owner.
        topic: its whole name.
        kind: of its messages.
        message: returns what is said now.
        still_alive: says whether the owner does its work; False is silence.
        lapsed: called before the first message after a silence that listeners took for death:
            drop every lease, and say nothing but standing until there is a fresh one.
        group: of the timer; None takes the node's default, which is one callback at a time.

    Raises:
        EnvironmentFault: the name is remapped.
    """

    def __init__(
        self,
        node: Node,
        topic: str,
        kind: type[Any],
        message: Callable[[], Any],
        *,
        still_alive: Callable[[], bool],
        lapsed: Callable[[], None],
        group: CallbackGroup | None = None,
    ) -> None:
        require_name(node, topic)
        self._message = message
        self._still_alive = still_alive
        self._lapsed = lapsed
        self._said_ns: int | None = None
        self._node = node
        self._publisher = node.create_publisher(kind, topic, actuation_qos())
        self._timer = node.create_timer(PERIOD_MS / 1_000, self.beat, group, steady())

    def beat(self) -> None:
        """Say it now, if the owner lives; call it for what should not wait for the timer.

        Not from another thread than the executor's.
        """
        if not self._still_alive():
            return
        now_ns = time.monotonic_ns()
        if self._said_ns is not None and now_ns - self._said_ns >= DEADLINE_MS * MS:
            self._lapsed()
        self._publisher.publish(self._message())
        self._said_ns = now_ns

    def close(self) -> None:
        """Say nothing any more."""
        self._node.destroy_timer(self._timer)
        self._node.destroy_publisher(self._publisher)


def gate_heartbeat(
    node: Node,
    topic: str,
    *,
    still_alive: Callable[[], bool],
    lapsed: Callable[[], None],
    group: CallbackGroup | None = None,
) -> Heartbeat:
    """Return the heartbeat that the dead-man hears: a number, another one for each life.

    Arguments and errors as `Heartbeat`'s.
    """
    life = UInt64(data=secrets.randbelow(_LIVES))

    def new_life() -> None:
        life.data = secrets.randbelow(_LIVES)
        lapsed()

    return Heartbeat(
        node,
        topic,
        UInt64,
        lambda: life,
        still_alive=still_alive,
        lapsed=new_life,
        group=group,
    )


def listen(
    node: Node,
    topic: str,
    kind: type[Any],
    *,
    heard: Callable[[Any, bytes], None],
    lost: Callable[[LatchCause], None],
    told: PublisherEvent = ALL,
) -> Subscription[Any]:
    """Return a subscription with the profile of heartbeats and all that DDS says of it.

    Args:
        node: its owner.
        topic: its whole name.
        kind: of its messages.
        heard: takes a message and the name of its publisher.
        lost: takes what DDS found; again for each time that DDS says it.
        told: what is asked of the middleware.

    Raises:
        EnvironmentFault: the name is remapped, or this DDS says nothing of its publishers.
    """
    require_name(node, topic)
    about = _Publishers(lost)

    def take(message: Any, origin: Mapping[str, Any]) -> None:
        named = origin.get("publisher_gid") if told.ids else None
        if named is None and about.are_several:
            lost(LatchCause.ANOTHER)  # its owner is unknown
        else:
            heard(message, b"" if named is None else bytes(named["data"]))

    try:
        return node.create_subscription(
            kind,
            topic,
            take,
            actuation_qos(),
            callback_group=MutuallyExclusiveCallbackGroup(),
            event_callbacks=about.events() if told.events else None,
        )
    except UnsupportedEventTypeError as error:  # pragma: no cover - Fast DDS has all of them
        raise EnvironmentFault(
            "this middleware does not say when a publisher is gone",
            reason=Reason.CONTROLLER_FAILED,
            where=topic,
        ) from error


def require_name(node: Node, topic: str) -> None:
    """Require that a name means itself in this node.

    Raises:
        EnvironmentFault: its name is remapped, or it is not whole.
    """
    resolved = node.resolve_topic_name(topic)
    if resolved != topic:
        raise EnvironmentFault(
            f"expected `{topic}` itself, got `{resolved}`",
            reason=Reason.CONTROLLER_FAILED,
            where=topic,
        )


class _Publishers:
    """What DDS's events mean.

    How many are matched says nothing of how many live: who was killed stays matched for up to
    twenty seconds. So a match that is new counts, and the end of the last one.
    """

    def __init__(self, lost: Callable[[LatchCause], None]) -> None:
        self.are_several = False
        self._lost = lost

    def events(self) -> SubscriptionEventCallbacks:
        return SubscriptionEventCallbacks(
            deadline=lambda _: self._lost(LatchCause.DEADLINE),
            liveliness=self._changed,
            matched=self._matched,
        )

    def _changed(self, event: Any) -> None:
        self.are_several = event.alive_count > 1
        if event.alive_count != 1:
            self._lost(LatchCause.ANOTHER if self.are_several else LatchCause.LIVELINESS)

    def _matched(self, event: Any) -> None:
        if event.total_count_change > 0:
            self._lost(LatchCause.ANOTHER)
        elif event.current_count == 0:
            self._lost(LatchCause.GONE)
