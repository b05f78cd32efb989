# SPDX-License-Identifier: Apache-2.0
"""Faults seen where planners' words enter: names, code, and the fields that nobody looked at.

One test for one lesson, named after it; the bindings are the shipped ones.
"""

from __future__ import annotations

import copy
import json
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from authguard_r.authoring.binding.samples import probe_site
from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.normalize import Binder, Dialect, read_plan
from authguard_r.normalize.binding import Binding
from authguard_r.normalize.shipped import binding_source
from authguard_r.site.source import convert
from authguard_r.site.words import standard_words
from fixtures.cases import case

TWIST: dict[str, Any] = {
    "tool": "publish",
    "arguments": {
        "topic": "/cmd_vel",
        "type": "geometry_msgs/msg/Twist",
        "msg": {"linear": {"x": 0.1, "y": 0, "z": 0}, "angular": {"x": 0, "y": 0, "z": 0}},
    },
}
GOAL: dict[str, Any] = {
    "tool": "send_action_goal",
    "arguments": {
        "action": "/navigate_to_pose",
        "action_type": "nav2_msgs/action/NavigateToPose",
        "args": {
            "behavior_tree": "",
            "pose": {
                "header": {"frame_id": "map"},
                "pose": {"position": {"x": 1.0, "y": 1.0, "z": 0}},
            },
        },
    },
}


@cache
def binder(name: str) -> Binder:
    binding = convert(binding_source(name), Binding, where=name)
    return Binder(probe_site(binding, standard_words()), binding)


def changed(call: dict[str, Any], path: str, value: Any) -> bytes:
    """Return the call's text with one field, by its path, given another value."""
    call = copy.deepcopy(call)
    *parents, last = path.split(".")
    node = call["arguments"]
    for parent in parents:
        node = node.setdefault(parent, {})
    node[last] = value
    return json.dumps(call).encode()


def refusal(text: bytes, name: str, dialect: Dialect = Dialect.JSON) -> MalformedError:
    with pytest.raises(MalformedError) as caught:
        read_plan(text, binder=binder(name), dialect=dialect)
    assert caught.value.where
    return caught.value


def test_l2_a_topic_spelled_otherwise_is_another_topic() -> None:
    for topic in [
        *("cmd_vel", "/cmd_vel/", "//cmd_vel", "/CMD_VEL", " /cmd_vel", "/cmd_vel ", "/cmd_vel\n"),
        *("/\u0441md_vel", "/cmd\u200b_vel", "/robot/cmd_vel", "/cmd_vel_raw", "~/cmd_vel", "*"),
    ]:
        with case(topic):
            assert read_plan(json.dumps(TWIST).encode(), binder=binder("cmd-vel")).steps
            assert refusal(changed(TWIST, "topic", topic), "cmd-vel").reason is Reason.TOOL_UNKNOWN


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os').system('touch {there}')",
        "publish(topic=open('{there}', 'w'))",
        "publish(topic=[x for x in [open('{there}', 'w')]])",
        "exec(\"open('{there}', 'w')\")",
        "(lambda: open('{there}', 'w'))()",
        "import os",
        "x = 1",
        "publish(topic=f'{there}')",
    ],
)
def test_l12_plan_code_is_parsed_and_never_evaluated(text: str, tmp_path: Path) -> None:
    there = tmp_path / "evaluated"
    for dialect in (Dialect.PYTHON, Dialect.CALLS, Dialect.GO2, Dialect.AUTO):
        refusal(text.replace("{there}", str(there)).encode(), "cmd-vel", dialect)
    assert not there.exists()


@pytest.mark.parametrize(
    "text",
    [
        "Sure! {plan}",
        "```json\n{plan}",
        "{plan} // done",
        "{plan},",
        "# first\n{plan}",
        "{plan}\n{plan}",
    ],
)
def test_l12_prose_comments_and_half_a_fence_around_a_plan_refuse_it(text: str) -> None:
    broken = text.replace("{plan}", json.dumps(GOAL)).encode()
    for dialect in (Dialect.JSON, Dialect.AUTO):
        refusal(broken, "nav2", dialect)


def test_l12_python_literals_are_not_json() -> None:
    refusal(str(GOAL).encode(), "nav2")


def test_l16_a_goal_with_a_behavior_tree_is_refused_with_its_place() -> None:
    assert read_plan(json.dumps(GOAL).encode(), binder=binder("nav2")).steps
    found = refusal(changed(GOAL, "args.behavior_tree", "go_round_the_gate.xml"), "nav2")
    assert found.reason is Reason.FIELD_REFUSED
    assert found.where.endswith("args.behavior_tree")


@pytest.mark.parametrize("frame", ["odom", "base_link", "/map", "MAP", ""])
def test_l16_a_pose_in_another_frame_is_another_pose(frame: str) -> None:
    found = refusal(changed(GOAL, "args.pose.header.frame_id", frame), "nav2")
    assert found.where.endswith("frame_id")


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("args.speed_limit", 9.0),
        ("args.pose.pose.position.w", 0),
        ("args.pose.header.child_frame_id", "map"),
        ("priority", 1),
    ],
)
def test_l16_a_field_that_no_definition_has_refuses_the_goal(path: str, value: Any) -> None:
    found = refusal(changed(GOAL, path, value), "nav2")
    assert found.reason is Reason.FIELD_UNKNOWN
    assert found.where.endswith(path)


def test_l16_every_pose_of_a_goal_is_judged_not_the_first_alone() -> None:
    poses = [GOAL["arguments"]["args"]["pose"]]
    far = copy.deepcopy(poses[0])
    far["pose"]["position"]["x"] = 900.0
    call = {
        "tool": "send_action_goal",
        "arguments": {
            "action": "/follow_waypoints",
            "action_type": "nav2_msgs/action/FollowWaypoints",
            "args": {"goal_index": 0, "number_of_loops": 0, "poses": poses},
        },
    }
    assert read_plan(json.dumps(call).encode(), binder=binder("nav2")).steps
    found = refusal(changed(call, "args.poses", [*poses, far]), "nav2")
    assert found.reason is Reason.NAME_UNKNOWN
