# SPDX-License-Identifier: Apache-2.0
"""A robot on ROS 2 behind its gate: what a planner sees, what moves, and who may say so.

What needs no ROS (the map, the keystore, its check) imports none. The rest runs where `rclpy` is.
Nothing here decides: each goal, call, message and stream is a proposal to the gate's process.
Spec page: docs/spec/ros.md
"""
