# SPDX-License-Identifier: Apache-2.0
"""ROS 2 goals, messages and service requests: every field reaches the binding, or refuses."""

from __future__ import annotations

import json
from typing import Any

import pytest

from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.normalize.dialects import Call, Dialect, read_plan
from fixtures.cases import case

POSE = {"pose": {"header": {"frame_id": "map"}, "pose": {"position": {"x": 1}}}}
GOAL = {"op": "send_action_goal", "action": "/go", "action_type": "m/action/Go", "args": POSE}
MESSAGE = {"op": "publish", "topic": "/cmd_vel", "msg": {"linear": {"x": 0}}}
REQUEST = {"op": "call_service", "service": "/dock"}


def refused(plan: Any, where: str, reason: Reason = Reason.MALFORMED) -> None:
    with pytest.raises(MalformedError) as caught:
        read_plan(json.dumps(plan), Dialect.ROS2)
    assert (caught.value.reason, caught.value.where) == (reason, where)


def test_the_operation_is_the_tool_and_all_the_rest_its_arguments() -> None:
    """L16: nothing of a goal is left out of what the binding sees."""
    for dialect in [Dialect.ROS2, Dialect.AUTO]:
        for operation in [
            GOAL,
            {**MESSAGE, "type": "geometry_msgs/msg/Twist"},
            MESSAGE,
            REQUEST,
            {**REQUEST, "type": "std_srvs/srv/Trigger", "args": {"data": True}},
            {**REQUEST, "args": {}},
        ]:
            with case(dialect, operation):
                rest = {name: value for name, value in operation.items() if name != "op"}
                expected = Call(operation["op"], rest, "input")
                assert read_plan(json.dumps(operation), dialect) == (expected,)
                assert read_plan(json.dumps({"id": "goal:1", **operation}), dialect) == (expected,)
                assert read_plan(json.dumps([operation, MESSAGE]), dialect)[1].where == "input[1]"


def test_another_operation_is_refused() -> None:
    for name in [
        "subscribe",
        "advertise",
        "unsubscribe",
        "cancel_action_goal",
        "set_level",
        "call_services",
        "Publish",
        "publish ",
        "",
    ]:
        with case(name):
            refused({**MESSAGE, "op": name}, "input.op", Reason.TOOL_UNKNOWN)


def test_another_field_is_refused() -> None:
    for plan, where in [
        ({**GOAL, "feedbacks": True}, "input.feedbacks"),
        ({**GOAL, "type": "m/action/Go"}, "input.type"),
        ({**GOAL, "goal": {}}, "input.goal"),
        ({**REQUEST, "latch": False}, "input.latch"),
        ({**MESSAGE, "args": {}}, "input.args"),
        ({**REQUEST, "timeout": 1}, "input.timeout"),
        ({**REQUEST, "compression": "png"}, "input.compression"),
        ({**REQUEST, "request": {}}, "input.request"),
        ([MESSAGE, {**MESSAGE, "to": "/cmd_vel"}], "input[1].to"),
    ]:
        with case(plan, where):
            refused(plan, where, Reason.FIELD_UNKNOWN)


def lacking(operation: dict[str, Any], name: str) -> dict[str, Any]:
    return {field: value for field, value in operation.items() if field != name}


def test_a_field_that_is_absent_or_of_another_kind_is_refused() -> None:
    """Arguments without names would be matched to a message's fields by position: a guess."""
    for plan, where in [
        ("publish", "input"),
        ([["publish"]], "input[0]"),
        ({"topic": "/cmd_vel", "msg": {}}, "input.op"),
        ({**MESSAGE, "op": None}, "input.op"),
        ({**MESSAGE, "id": 1}, "input.id"),
        (lacking(GOAL, "action"), "input.action"),
        (lacking(GOAL, "action_type"), "input.action_type"),
        (lacking(GOAL, "args"), "input.args"),
        ({**GOAL, "args": None}, "input.args"),
        ({**GOAL, "args": [POSE]}, "input.args"),
        ({**GOAL, "action": ["/go"]}, "input.action"),
        (lacking(MESSAGE, "topic"), "input.topic"),
        (lacking(MESSAGE, "msg"), "input.msg"),
        ({**MESSAGE, "msg": []}, "input.msg"),
        ({**MESSAGE, "msg": "{}"}, "input.msg"),
        ({**MESSAGE, "type": None}, "input.type"),
        (lacking(REQUEST, "service"), "input.service"),
        ({**REQUEST, "args": []}, "input.args"),
        ({**REQUEST, "args": None}, "input.args"),
    ]:
        with case(plan, where):
            refused(plan, where)
