# SPDX-License-Identifier: Apache-2.0
"""After zero nothing is said that was said before it, whichever thread says it again (L19)."""

from __future__ import annotations

import threading
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2 (tests/ros/make.sh makes an environment)")

from geometry_msgs.msg import Twist

from authguard_r.integrations.ros.nodes.velocity import StreamClientProxy
from authguard_r.site.model import Profile
from fixtures.gate_process import until
from ros.graph import Peer, next_domain


class Slow:
    """A publisher that takes its time with what moves."""

    def __init__(self) -> None:
        self.said: list[float] = []
        self.begun, self.goes_on = threading.Event(), threading.Event()

    def publish(self, message: Any) -> None:
        if message.linear.x:
            self.begun.set()
            assert self.goes_on.wait(20)
        self.said.append(message.linear.x)


def test_a_velocity_that_is_being_repeated_goes_out_before_the_zero_that_ends_it() -> None:
    peer = Peer("gate", next_domain())
    robot: Any = SimpleNamespace(spinner=peer, group=peer.group, is_alive=lambda: False)
    profile = Profile(
        tools={},
        max_speed_mm_s=1_000,
        max_force_mn=0,
        max_payload_g=0,
        brake_mm_s2=1_000,
        reaction_ms=20,
    )
    outlet = StreamClientProxy(robot, Twist, "/cmd_vel", profile)
    moving = Twist()
    moving.linear.x = 0.2
    until(lambda: outlet._turned_ms, "the thread of ROS")
    outlet.steer(moving, 200)
    slow = Slow()
    outlet._publisher = slow  # type: ignore[assignment]
    outlet._robot = SimpleNamespace(is_alive=lambda: True)  # type: ignore[assignment]
    peer.close()  # nobody repeats it but this test
    again, rests = threading.Thread(target=outlet._repeat), threading.Thread(target=outlet.rest)
    again.start()
    assert slow.begun.wait(20)
    rests.start()
    rests.join(0.2)
    assert slow.said == []  # it waits for its turn
    slow.goes_on.set()
    again.join(20)
    rests.join(20)
    assert slow.said == [0.2, 0.0]
    assert outlet._message.linear.x == 0.0
