# SPDX-License-Identifier: Apache-2.0
"""A ROS map: what is on the wrong side, there twice, or no name of ROS, is said with its place.

Source: lessons L1, L2; docs/spec/ros-map.md#map
"""

from __future__ import annotations

from copy import deepcopy
from typing import Any

import pytest

from authguard_r.core.errors import MalformedError
from authguard_r.integrations.ros.map import read_map
from authguard_r.integrations.ros.names import is_enclave, is_name, part_of
from fixtures.cases import case
from fixtures.ros_keystores import EXAMPLE, example, map_of, plain_map


def put(path: str, value: Any) -> dict[str, Any]:
    """Return the example's map with another value somewhere."""
    plain = deepcopy(plain_map())
    at: Any = plain
    *parents, last = path.split("|")
    for name in parents:
        at = at[name]
    at[last] = value
    return plain


def test_the_examples_map_is_one() -> None:
    assert read_map(EXAMPLE) == example()
    assert {item.private for item in example().mediated.values()} == {
        "/navigate_to_pose",
        "/cmd_vel",
        "/light",
        "/gripper",
    }


def test_a_map_with_a_fault_is_none_and_says_where() -> None:
    for path, value, place in [
        ("schema", "authguard-r/ros-map/2", "schema"),
        ("robot", "Courier 1", "robot"),
        ("robot", "", "robot"),
        ("domain", 102, "domain"),
        ("domain", -1, "domain"),
        ("mediated", {}, "mediated"),
        ("mediated|navigate|public", "/navigate", "mediated.navigate.public"),
        ("mediated|navigate|public", "/llmx/navigate", "mediated.navigate.public"),
        ("mediated|navigate|private", "/llm/other", "mediated.navigate.private"),
        ("mediated|navigate|private", "/cmd_vel", "mediated.navigate.private"),
        ("mediated|navigate|private", "navigate_to_pose", "mediated.navigate.private"),
        ("mediated|navigate|private", "/cmd_vel/", "mediated.navigate.private"),
        ("mediated|navigate|private", "~/goal", "mediated.navigate.private"),
        ("mediated|navigate|private", "/a__b", "mediated.navigate.private"),
        ("mediated|navigate|private", "/_action/x", "mediated.navigate.private"),
        ("mediated|navigate|private", "/cm\u0501_vel", "mediated.navigate.private"),
        ("mediated|navigate|private", "/" + "a" * 200, "mediated.navigate.private"),
        ("mediated|navigate|type", "nav2_msgs/msg/NavigateToPose", "mediated.navigate.type"),
        ("mediated|navigate|type", "os/action/system", "mediated.navigate.type"),
        ("mediated|navigate|type", "a.b/action/Name", "mediated.navigate.type"),
        ("mediated|drive|type", "geometry_msgs/srv/Twist", "mediated.drive.type"),
        ("mediated|drive|by", "/robot/nobody", "mediated.drive.by"),
        ("mediated|drive|by", "/llm/planner", "mediated.drive.by"),
        ("shown|sign|type", "std_msgs/srv/String", "shown.sign.type"),
        ("shown|sign|public", "/sign", "shown.sign.public"),
        ("shown|sign|by", "/nobody", "shown.sign.by"),
        ("shown", {"Big Sign": plain_map()["shown"]["sign"]}, "shown.Big Sign"),
        ("enclaves|deadman", "/authguard/gate", "enclaves.deadman"),
        ("enclaves|planner", "planner", "enclaves.planner"),
        ("enclaves|planner", "/llm/../authguard/gate", "enclaves.planner"),
        ("processes|/robot/base|nodes", ["base"], "processes./robot/base.nodes"),
        ("processes|/robot/base|publishes", ["/cmd_vel"], "processes./robot/base.publishes"),
        ("processes|/robot/camera|asks", ["/navigate_to_pose"], "processes./robot/camera.asks"),
        ("processes|/robot/camera|acts", ["/navigate_to_pose"], "processes./robot/camera.acts"),
        ("processes|/robot/camera|calls", ["/light"], "processes./robot/camera.calls"),
        ("processes|/robot/camera|publishes", ["/llm/sign"], "processes./robot/camera.publishes"),
        ("processes|/authguard/gate", {"nodes": ["/x"]}, "processes./authguard/gate"),
        ("processes|/robot/camera|publishes", ["/authguard/status"], "/robot/camera.publishes"),
        ("processes|/robot/camera|publishes", ["/authguard/heartbeat"], "/robot/camera.publishes"),
        ("processes|/robot/base|publishes", ["/odom", "/camera/text"], "/robot/base.publishes"),
        ("processes|/robot/camera|publishes", ["/fibonacci/_action/status"], "camera.publishes"),
        ("position|odometry", "odom", "position.odometry"),
        ("position|shared", ["/robot/base"], "position.shared"),
        ("heartbeat", "/llm/heartbeat", "heartbeat"),
        ("decisions", "/cmd_vel", "decisions"),
        ("status", "/authguard/decisions", "status"),
        ("proposals|ask", "/propose", "proposals.ask"),
        ("mediated|navigate|speed", 1, "mediated.navigate"),
        ("mediated|navigate|kind", "topic", "mediated.navigate.kind"),
    ]:
        with case(path, value, place):
            with pytest.raises(MalformedError) as failed:
                map_of(put(path, value))
            assert place in failed.value.where


@pytest.mark.parametrize(
    ("position", "writers", "where"),
    [
        ({"odometry": "/odom"}, {"base": ["/odom"]}, ""),
        ({"odometry": "/odom"}, {"base": ["/odom"], "camera": ["/odom"]}, "position.odometry"),
        ({"odometry": "/odom"}, {"base": ["/tf"]}, "position.odometry"),
        ({}, {"base": ["/tf", "/tf_static"]}, ""),
        ({}, {"base": ["/odom"]}, "position"),
        ({}, {"base": ["/tf"], "camera": ["/tf_static"]}, "position"),
        ({"shared": ["base", "camera"]}, {"base": ["/tf"], "camera": ["/tf_static"]}, ""),
        ({"shared": ["base"]}, {"base": ["/tf"], "camera": ["/tf_static"]}, "position.shared"),
        ({"shared": ["base"]}, {"base": ["/tf"]}, "position.shared"),
        ({"shared": ["base", "camera"]}, {"base": ["/tf"]}, "position.shared"),
    ],
)  # fmt: skip
def test_where_the_robot_is_one_process_says_or_each_that_may_is_named(
    position: dict[str, Any], writers: dict[str, list[str]], where: str
) -> None:
    plain = deepcopy(plain_map())
    shared = {"shared": [f"/robot/{name}" for name in position.get("shared", ())]}
    plain["position"] = {"map": "main", "floor": 1, "margin_mm": 100, **position, **shared}
    for name in ("base", "camera"):
        plain["processes"][f"/robot/{name}"]["publishes"] = writers.get(name, [])
    if not where:
        assert map_of(plain).position is not None
        return
    with pytest.raises(MalformedError) as failed:
        map_of(plain)
    assert failed.value.where.rpartition(":")[2] == where


def test_l2_names_are_the_executors_own_and_never_patterns() -> None:
    for name in ("/cmd_vel", "/a/b_c/D9"):
        assert is_name(name)
    for wrong in ("", "/", "cmd_vel", "/cmd_vel/", "//cmd_vel", "/cmd-vel", "/9", "/a*", "/{ns}/x"):
        assert not is_name(wrong), wrong
    for wrong in ("", "/", "a", "/a/", "/a//b", "/a/..", "/.", "/a b"):
        assert not is_enclave(wrong), wrong
    assert part_of("std_msgs/msg/String") == "msg"
    for wrong in ("String", "std_msgs/String", "std_msgs/msg/string", "std_msgs/idl/String", ""):
        assert part_of(wrong) is None
