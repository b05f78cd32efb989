# SPDX-License-Identifier: Apache-2.0
"""Nodes of ROS 2: what stands between planners and a robot, and what stops it when that is gone.

Needs `rclpy`, which comes with ROS and is on no list of dependencies.
Spec pages: docs/spec/ros.md, docs/spec/ros-stopping.md, docs/spec/ros-position.md
"""
