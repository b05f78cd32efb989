# SPDX-License-Identifier: Apache-2.0
"""What tools say of themselves, read in every form, and compared leaf by leaf."""

from __future__ import annotations

import json
from typing import Any

import pytest

from authguard_r.authoring.binding.check import BindingReport
from authguard_r.core.errors import MalformedError
from authguard_r.normalize.interface import listed_interface, read_interface
from fixtures.cases import case
from unit.normalize.bound import (
    GO_BY_STOPS,
    GO_TO_POSE,
    NOTED,
    REFUSED,
    WAIT,
    Plain,
    faults,
    mapped,
    number,
    report,
)

SCHEMA: Plain = {
    "type": "object",
    "properties": {
        "place": {"type": "string"},
        "pose": {"type": "object", "properties": {"x": {"type": "number"}, "y": {}}},
        "stops": {
            "type": "array",
            "items": {"type": "object", "properties": {"name": {"type": "string"}}},
        },
        "goal": {"type": "object", "additionalProperties": True},
        "tags": {"type": "array", "items": {"type": "string"}},
        "odd": True,
    },
}
LEAVES = ("place", "pose.x", "pose.y", "stops.[].name", "goal", "tags", "odd")
#: The same interface in every form that is read.
FORMS: dict[str, str] = {
    "mcp": json.dumps({"tools": [{"name": "go", "inputSchema": SCHEMA}]}),
    "mcp answer": json.dumps({"result": {"tools": [{"name": "go", "inputSchema": SCHEMA}]}}),
    "openai": json.dumps([{"type": "function", "function": {"name": "go", "parameters": SCHEMA}}]),
    "anthropic": json.dumps([{"name": "go", "input_schema": SCHEMA}]),
    "one": json.dumps({"name": "go", "parameters": SCHEMA}),
    "lines": "\n".join([json.dumps({"name": "go", "parameters": SCHEMA})] * 2),
}


@pytest.mark.parametrize("text", FORMS.values(), ids=FORMS)
def test_every_form_of_an_interface_says_the_same(text: str) -> None:
    (surface,) = read_interface(text, name="tools.json")
    assert (surface.name, surface.message, surface.leaves) == ("go", False, LEAVES)
    assert surface.open == {"pose.y", "goal", "tags", "odd"}


def test_signatures_of_one_name_are_one_tool_with_the_fields_of_both() -> None:
    one = {"name": "go", "args": [{"name": "to", "type": "str"}]}
    two = {"name": "go", "args": [{"name": "names", "type": "List[str]"}, {"name": "x"}]}
    (surface,) = read_interface(json.dumps([one, two]), name="signatures.json")
    assert surface.leaves == ("to", "names", "x")
    assert surface.open == {"names", "x"}


def test_what_is_no_interface_is_malformed_in_its_place() -> None:
    for text, where in [
        ("", "x.json[0]"),
        ("1", "x.json"),
        ("{}", "x.json:tools[0]"),
        ('[{"name": 1}]', "x.json:tools[0]"),
        ("[1]", "x.json:tools[0]"),
        ('[{"name": "a"}]', "x.json:tools[0]"),
        ('[{"name": "a", "args": [1]}]', "x.json:tools[0]"),
        ('[{"name": "a", "args": [{}]}]', "x.json:tools[0]"),
        ('{"name": "a", "parameters": {}}\n{"name": 2}', "x.json:2"),
    ]:
        with case(text, where):
            with pytest.raises(MalformedError) as caught:
                read_interface(text, name="x.json")
            assert caught.value.where == where


def test_a_schema_without_fields_has_none() -> None:
    for schema in ({}, {"properties": {}}, {"properties": []}):
        (surface,) = read_interface(json.dumps({"name": "go", "parameters": schema}), name="x.json")
        assert surface.leaves == ()


ACTION = """# goal
uint8 FAST = 1
geometry_msgs/PoseStamped pose   # where to
nav_msgs/Goals goals
string[<=4] tags
float32 speed 0.5
my_msgs/Odd odd
Shape[] shapes

---
uint16 result
"""


def test_a_ros_definition_is_read_down_to_its_leaves() -> None:
    (surface,) = read_interface(ACTION, name="defs/GoThere.action")
    assert (surface.name, surface.message) == ("GoThere", True)
    assert surface.leaves[:4] == (
        "pose.header.stamp.sec",
        "pose.header.stamp.nanosec",
        "pose.header.frame_id",
        "pose.pose.position.x",
    )
    assert "goals.goals.[].pose.orientation.w" in surface.leaves
    assert surface.leaves[-4:] == ("tags", "speed", "odd", "shapes")
    assert surface.open == {"tags", "odd", "shapes"}
    with pytest.raises(MalformedError) as caught:
        read_interface("what?\n", name="x.msg")
    assert caught.value.where == "x.msg"


TOOL: Plain = {
    **GO_TO_POSE,
    "arguments": {
        "place": mapped("destination"),
        "pose": NOTED,
        "stops": REFUSED,
        "goal.speed": NOTED,
        "tags.0": NOTED,
        "odd": NOTED,
    },
}


def compared(tool: Plain, text: str = FORMS["mcp"], name: str = "tools.json") -> BindingReport:
    return report({"go": tool}, None, *read_interface(text, name=name))


def test_a_binding_that_meets_its_interface_has_nothing_unmapped() -> None:
    found = compared(TOOL)
    assert (found.faults, found.unmapped) == ((), ())


@pytest.mark.parametrize("left_out", ["place", "pose", "stops", "goal.speed", "tags.0", "odd"])
def test_a_field_that_nobody_bound_is_named(left_out: str) -> None:
    arguments = {name: a for name, a in TOOL["arguments"].items() if name != left_out}
    if left_out == "place":
        arguments["pose"] = {**mapped("destination")}
    found = compared({**TOOL, "arguments": arguments})
    assert found.unmapped
    leaf = left_out.split(".", maxsplit=1)[0]
    assert any(f"`{leaf}" in fault.message for fault in found.faults)
    assert faults(found)[0] == "tools.go.arguments"


def test_a_field_that_is_bound_but_does_not_exist_is_named() -> None:
    arguments = {**TOOL["arguments"], "colour": NOTED, "place": mapped("destination")}
    found = compared({**TOOL, "arguments": arguments, "when": {"mode": 1}})
    assert faults(found) == ["tools.go.arguments.colour", "tools.go.arguments.mode"]
    assert found.unmapped == ()


def test_a_mapped_value_covers_no_fields_below_it() -> None:
    """What is carried is the leaf that was read, not whatever stands around it."""
    arguments = {**TOOL["arguments"], "pose": mapped("source")}
    tool = {**TOOL, "attested": [], "arguments": arguments}
    assert len(compared(tool).unmapped) == 2


def test_a_tool_that_is_missing_on_either_side_is_named() -> None:
    text = json.dumps({"tools": [{"name": "fly", "inputSchema": {}}]})
    found = compared(TOOL, text)
    assert faults(found) == ["fly", "tools.go"]
    assert len(found.unmapped) == 1


def test_a_message_is_found_by_its_type_and_compared_below_its_body() -> None:
    way = {
        **GO_TO_POSE,
        "message": "my_msgs/action/GoThere",
        "body": "goal",
        "arguments": {
            "name": NOTED,
            "goal.pose.header.frame_id": mapped("pose.map"),
            "goal.pose.pose.position.x": number("pose.x"),
            "goal.pose.pose.position.y": number("pose.y"),
        },
    }
    text = "geometry_msgs/PoseStamped pose\n---\n"
    found = compared(way, text, "GoThere.action")
    assert [fault.message.split("`")[1] for fault in found.faults] == [
        "pose.header.stamp.sec",
        "pose.header.stamp.nanosec",
        "pose.pose.position.z",
        *(f"pose.pose.orientation.{axis}" for axis in "xyzw"),
    ]
    top = {
        **WAIT,
        "message": "my_msgs/msg/Hold",
        "arguments": {"sec": mapped("params.duration_ms", per_unit="1000")},
    }
    assert compared(top, "int32 sec\n", "Hold.msg").faults == ()
    assert faults(compared(top, "int32 sec\n", "Halt.msg")) == ["Halt"]
    items = "geometry_msgs/PoseStamped[] poses\n"
    listed = {**GO_BY_STOPS, "message": "my_msgs/action/Follow"}
    found = compared(listed, items, "Follow.action")
    assert [fault.message.split("`")[1] for fault in found.faults] == [
        "poses.[].header.stamp.sec",
        "poses.[].header.stamp.nanosec",
        "poses.[].pose.orientation.x",
        "poses.[].pose.orientation.y",
    ]
    body = {**top, "body": "msg", "arguments": {"msg": REFUSED}, "type": "unheld"}
    assert compared(body, "int32 sec\n", "Hold.msg").faults == ()


# -- the short form --------------------------------------------------------------------------------


def test_a_listed_interface_says_what_its_definition_says() -> None:
    listing = {"tools": {"go": "goal.place items.[].x tags.*", "rest": ""}, "messages": {"Go": "b"}}
    go, rest, message = listed_interface(listing, where="listed")
    assert (go.name, go.message, go.leaves) == ("go", False, ("goal.place", "items.[].x", "tags"))
    assert go.open == frozenset({"tags"})
    assert (rest.leaves, rest.open) == ((), frozenset())
    assert (message,) == read_interface("int32 b\n", name="Go.msg")
    assert listed_interface({}, where="listed") == ()


@pytest.mark.parametrize(
    "bad",
    [[], None, {"tool": {}}, {"tools": []}, {"tools": {"go": ["a"]}}, {"tools": {"go": None}}],
)
def test_another_list_is_refused_with_its_place(bad: Any) -> None:
    with pytest.raises(MalformedError) as caught:
        listed_interface(bad, where="listed")
    assert caught.value.where.startswith("listed")


def test_a_field_is_bound_under_any_name_that_the_binding_gives_it() -> None:
    """A call by position is bound as `1`; the interface knows the argument by its name."""
    arguments = {"1": mapped("destination", also=["place"])}
    tool = {**GO_TO_POSE, "arguments": arguments}
    for name in ("place", "1"):
        surfaces = listed_interface({"tools": {"go": name}}, where="listed")
        assert report({"go": tool}, None, *surfaces).faults == ()
    surfaces = listed_interface({"tools": {"go": "spot"}}, where="listed")
    found = report({"go": tool}, None, *surfaces)
    assert faults(found) == ["tools.go.arguments", "tools.go.arguments.1"]
    assert found.unmapped == ("tools.go.arguments: expected the field `spot`",)
