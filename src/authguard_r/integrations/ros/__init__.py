# SPDX-License-Identifier: Apache-2.0
"""A robot on ROS 2 behind its gate: what a planner sees, what moves, and who may say so.

What needs no ROS (the map, the keystore, its check) imports none. The rest runs where `rclpy` is.
Nothing here decides: each goal, call, message and stream is a proposal to the gate's process.
Spec page: docs/spec/ros.md
"""

from __future__ import annotations

from authguard_r import lazy

#: What a robot's own nodes use; each name is imported from its module when it is first used.
_HOMES = {
    "Actuator": "integrations.ros.nodes.actuator",
    "Identifier": "core.identifiers",
    "LOOK_MS": "sim.sensors",
    "Label": "core.provenance",
    "Position": "integrations.ros.map",
    "Reading": "core.state",
    "RobotId": "core.identifiers",
    "RosMap": "integrations.ros.map",
    "SENSORS": "client.sensing",
    "SensorServer": "sim.sensors",
    "Snapshot": "core.state",
    "VariableId": "core.identifiers",
    "call_of": "integrations.ros.calls",
    "ended_by": "integrations.ros.steps",
    "made_node": "integrations.ros.nodes.process",
    "mono_ms": "client.link",
    "plain_of": "integrations.ros.nodes.values",
    "read_map": "integrations.ros.map",
    "steady": "integrations.ros.nodes.heartbeat",
}
__all__ = list(_HOMES)
__getattr__ = lazy(__name__, _HOMES)
