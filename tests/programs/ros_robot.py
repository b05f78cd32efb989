# SPDX-License-Identifier: Apache-2.0
"""A robot on ROS 2: what reaches it is a line of a file. Run in an environment with rclpy.

python tests/programs/ros_robot.py FILE
"""

from __future__ import annotations

import json
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import rclpy
from geometry_msgs.msg import Twist
from rclpy.executors import ExternalShutdownException
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_srvs.srv import Trigger


def main() -> None:
    """Say `ready` and listen until it is ended."""
    arrived = Path(sys.argv[1])

    def note(line: dict[str, Any]) -> None:
        with arrived.open("a") as file:
            file.write(json.dumps(line) + "\n")

    def drive(message: Twist) -> None:
        note({"topic": "/cmd_vel", "x": message.linear.x, "turn": message.angular.z})

    def unlock(_: Trigger.Request, answer: Trigger.Response) -> Trigger.Response:
        note({"service": "/unlock"})
        answer.success = True
        return answer

    rclpy.init()
    node = rclpy.create_node("robot")
    # whoever publishes before it is matched is heard too
    profile = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    node.create_subscription(Twist, "/cmd_vel", drive, profile)
    node.create_service(Trigger, "/unlock", unlock)
    print("ready", flush=True)
    with suppress(ExternalShutdownException):
        rclpy.spin(node)


if __name__ == "__main__":
    main()
