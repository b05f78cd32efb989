# SPDX-License-Identifier: Apache-2.0
"""The robot's side of a stream: one publisher of velocities, which says zero when nothing runs.

It publishes all the time: a watchdog of the robot stops on its silence. A velocity goes out
only while the gate's ends are alive, and the thread of ROS turns, which hears how the robot is.
Spec page: docs/spec/ros.md#streams
"""

from __future__ import annotations

import asyncio
import threading
from typing import Any

from authguard_r.client.link import mono_ms
from authguard_r.core.errors import ControllerError
from authguard_r.core.standing import Outcome
from authguard_r.integrations.ros.nodes.heartbeat import PERIOD_MS, TURN_MS, actuation_qos, steady
from authguard_r.integrations.ros.nodes.proxies import STOP_S, DispatchOrder, RobotProxy
from authguard_r.site.model import Profile, stopping_mm

#: After its time a stream that was sampled is ended here, if the gate does not.
_SLACK_MS = 500
_LOOK_S = 0.01


class StreamClientProxy:
    """Publishes velocities.

    Args:
        robot: the node.
        kind: the message's class.
        name: the topic that the base hears.
        profile: says how the robot brakes.
    """

    def __init__(self, robot: RobotProxy, kind: Any, name: str, profile: Profile) -> None:
        self.kind = kind
        self._robot = robot
        self._profile = profile
        self._zero = kind()
        self._message = self._zero
        self._speed_mm_s = 0  # the highest since it stood
        self._order: DispatchOrder | None = None
        self._ends_ms = 0
        self._is_sampled = self._is_closing = self._is_silent = False
        self._turn = threading.Lock()  # what was said before is not said again after zero
        self._turned_ms = 0  # when the thread of ROS came by last
        self._stood_ms = mono_ms()
        node = robot.spinner.node
        qos = actuation_qos()
        self._publisher = node.create_publisher(kind, name, qos, callback_group=robot.group)
        node.create_timer(PERIOD_MS / 1_000, self._repeat, robot.group, steady())

    @property
    def stands(self) -> bool:
        """True once a subscriber heard zero for as long as it needs to brake."""
        return self._message is self._zero and mono_ms() >= self._stood_ms

    @property
    def is_there(self) -> bool:
        """True while a subscriber hears it."""
        return bool(self._publisher.get_subscription_count() > 0)

    def begin(self, order: DispatchOrder) -> None:
        """Take the order; `steer` says its first velocity."""
        self._order, self._is_sampled, self._is_closing = order, False, False
        self._ends_ms = mono_ms() + order.duration_ms
        order.release.take()

    def steer(self, message: Any, speed_mm_s: int) -> None:
        """Go on with a velocity, at once.

        Args:
            message: rebuilt from what was authorized.
            speed_mm_s: how fast that is; 0: it stands.
        """
        if not speed_mm_s or self._is_closing:
            self.rest()
            return
        if mono_ms() - self._turned_ms >= TURN_MS:
            return  # the heartbeat is silent too: no planner drives without a watch
        self._speed_mm_s = max(self._speed_mm_s, speed_mm_s)
        self._say(message)

    def sampled(self) -> None:
        """Note that it is steered: from now on it does not end by itself in time."""
        self._is_sampled = True

    def close(self) -> None:
        """Say zero; what was ordered has succeeded once it stands."""
        self._is_closing = True
        self.pass_time()

    def rest(self) -> None:
        """Say zero at once; it stands after the time that it needs to brake."""
        if self._message is not self._zero:
            self._stood_ms = mono_ms() + braking_ms(self._profile, self._speed_mm_s)
        self._say(self._zero)

    async def stop(self) -> bool:
        """Say zero, and wait until it stands."""
        self.rest()
        try:
            async with asyncio.timeout(STOP_S + braking_ms(self._profile, self._speed_mm_s) / 1e3):
                while not self._heard() or not self.stands:
                    await asyncio.sleep(_LOOK_S)
        except TimeoutError:
            return False
        self._speed_mm_s, self._order = 0, None
        return True

    def pass_time(self) -> None:
        """Look at the clock: a stream that is over says zero, and ends once it stands."""
        now = mono_ms()
        order = self._order
        if order is None or not order.release.runs:
            return
        ends_ms = self._ends_ms + (_SLACK_MS if self._is_sampled else 0)
        if self._is_closing or now >= ends_ms:
            if self._message is not self._zero:
                self.rest()
            if self.stands:
                self._speed_mm_s, self._order = 0, None
                order.release.end(Outcome.SUCCEEDED)

    def _repeat(self) -> None:
        """Say it again, on the thread of ROS.

        When the ends do not look any more, zero is the last word: silence stops what is left.
        """
        self._turned_ms = mono_ms()
        with self._turn:
            if self._robot.is_alive():
                self._is_silent = False
                self._publisher.publish(self._message)
            elif not self._is_silent:
                self._is_silent = True
                self._publisher.publish(self._zero)

    def _say(self, message: Any) -> None:
        """Publish a message, which from now on is said again."""
        with self._turn:
            self._message = message
            self._publisher.publish(message)

    def _heard(self) -> bool:
        """True when a subscriber hears zero, or it never had to move."""
        return not self._speed_mm_s or self.is_there


def braking_ms(profile: Profile, speed_mm_s: int) -> int:
    """Return how long the robot needs at most until it stands."""
    if not speed_mm_s:
        return 0
    brake, reaction = profile.brake_mm_s2, profile.reaction_ms
    if brake is None or reaction is None or stopping_mm(profile, speed_mm_s) is None:
        raise ControllerError("the profile does not say how the robot brakes")
    return reaction + -(-speed_mm_s * 1_000 // brake)
