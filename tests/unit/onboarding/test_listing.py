# SPDX-License-Identifier: Apache-2.0
"""Tool lists: what is read, and that nothing else is, each fault with its place."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from authguard_r.authoring.onboarding.graph import InterfaceKind, read_ros
from authguard_r.authoring.onboarding.listing import (
    MAX_FIELDS,
    MAX_LIST,
    MAX_TOOLS,
    list_text,
    read_mcp,
    read_openai,
)
from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason
from fixtures.amount import amount
from fixtures.cases import case
from fixtures.time_bounds import at_most

SCHEMA = {
    "type": "object",
    "properties": {
        "target": {
            "type": "object",
            "properties": {"x": {"type": "number"}, "frame": {"type": "string"}},
        },
        "stops": {"type": "array", "items": {"properties": {"room": {"type": "string"}}}},
        "extra": {"type": "object"},
    },
}
LEAVES = {"target.x": False, "target.frame": False, "stops.[].room": False, "extra": True}


def mcp(*tools: Any, **more: Any) -> str:
    return json.dumps({"tools": list(tools), **more})


def tool(name: str = "go", **schema: Any) -> dict[str, Any]:
    return {"name": name, "inputSchema": {"type": "object", **schema}}


@pytest.mark.parametrize("wrap", ["list", "tools", "answer"])
def test_an_mcp_list_is_read_in_every_wrapping(wrap: str) -> None:
    tools: Any = [{"name": "go", "inputSchema": SCHEMA}]
    value = {"list": tools, "tools": {"tools": tools}}.get(
        wrap, {"jsonrpc": "2.0", "id": 1, "result": {"tools": tools}}
    )
    (found,) = read_mcp(json.dumps(value), where="f")
    assert (found.name, found.fields) == ("go", LEAVES)


@pytest.mark.parametrize(
    ("tool", "place", "word"),
    [
        ({"name": "go", "inputSchema": {}}, "f:tools[0].inputSchema", "--from mcp"),
        ({"name": "go", "input_schema": {}}, "f:tools[0].input_schema", "parameters"),
        ({"type": "function", "function": {"name": "go"}, "x": 1}, "f:tools[0].x", "function"),
        (
            {"type": "function", "function": {"name": "go", "inputSchema": {}}},
            "f:tools[0].function.inputSchema",
            "--from mcp",
        ),
    ],
)
def test_an_openai_tool_with_a_key_that_is_not_read_is_refused(
    tool: dict[str, Any], place: str, word: str
) -> None:
    with pytest.raises(MalformedError, match=word) as fault:
        read_openai(json.dumps([tool]), where="f")
    assert fault.value.where == place


@pytest.mark.parametrize(
    "text",
    [
        json.dumps([{"type": "function", "function": {"name": "go", "parameters": SCHEMA}}]),
        json.dumps({"tools": [{"type": "function", "name": "go", "parameters": SCHEMA}]}),
        json.dumps([{"name": "go", "parameters": SCHEMA}]),
    ],
    ids=["chat completions", "responses", "bare"],
)
def test_an_openai_list_is_read_in_both_shapes(text: str) -> None:
    (found,) = read_openai(text, where="f")
    assert (found.name, found.fields) == ("go", LEAVES)


def test_functions_may_stand_one_a_line_and_may_have_no_arguments() -> None:
    text = "\n".join(json.dumps({"name": name}) for name in ("go", "halt"))
    assert [t.name for t in read_openai(text, where="f")] == ["go", "halt"]
    assert all(t.fields == {} for t in read_openai(text, where="f"))


def test_a_bad_list_is_refused_with_its_place() -> None:
    for text, where, told in [
        ("", "f", "got nothing"),
        ("{", "f[", "expect"),
        ("[1, 2", "f[", "expect"),
        ("17", "f", "list of tools"),
        ('{"a": 1, "a": 2}', "f", "duplicate"),
        ("[]", "f", "got none"),
        ("[1]", "f:tools[0]", "object"),
        ("[{}]", "f:tools[0].name", "name"),
        (json.dumps([{"name": "go"}]), "f:tools[0].inputSchema", "schema"),
        (mcp(tool("go"), tool("go")), "f:tools[1].name", "again"),
        (mcp(tool("go_to"), tool("Go-To")), "f:tools[1].name", "taken for"),
        (mcp(tool("room_l"), tool("room_1")), "f:tools[1].name", "taken for"),
        (mcp(tool("g\u043e")), "f:tools[0].name", "letters"),
        (mcp(tool("go now")), "f:tools[0].name", "letters"),
        (mcp(tool("")), "f:tools[0].name", "letters"),
        (mcp(tool("a" * 129)), "f:tools[0].name", "letters"),
        (mcp(tool(properties={"a.b": {}})), "of go: a.b", "letters"),
        (mcp(tool(properties={"0": {}})), "of go: 0", "letters"),
        (mcp(tool(properties={"x\n": {}})), "of go: x", "letters"),
        (mcp(tool(properties={"x": {}, "X": {}})), "of go: X", "in case"),
        (mcp(tool(), nextCursor="more"), "f:nextCursor", "whole list"),
        ("[" * 40 + "]" * 40, "f[", "levels"),
    ]:
        with case(text, where, told):
            with pytest.raises(MalformedError) as caught:
                read_mcp(list_text(text.encode(), where="f"), where="f")
            assert where in caught.value.where
            assert told in caught.value.message.lower()


def test_what_a_server_does_itself_passes_no_gate_so_it_is_not_listed() -> None:
    with pytest.raises(MalformedError) as caught:
        read_openai(json.dumps([{"name": "go"}, {"type": "web_search"}]), where="f")
    assert "f:tools[1]" in caught.value.where
    with pytest.raises(MalformedError, match="no gate sees"):
        read_openai(json.dumps([{"type": "computer_use", "name": "go"}]), where="f")


def test_a_list_that_nobody_can_look_through_is_refused_at_once() -> None:
    many = [tool(f"t{n}x") for n in range(10_000)]
    for text in (mcp(*many), mcp(*many[: MAX_TOOLS + 1])):
        with at_most(5), pytest.raises(MalformedError) as caught:
            read_mcp(list_text(text.encode(), where="f"), where="f")
        assert caught.value.reason is Reason.INPUT_TOO_LARGE
    wide = tool(properties={f"f{n}": {"type": "string"} for n in range(MAX_FIELDS + 1)})
    with pytest.raises(MalformedError) as caught:
        read_mcp(mcp(wide), where="f")
    assert caught.value.reason is Reason.INPUT_TOO_LARGE
    with pytest.raises(MalformedError) as caught:
        list_text(b" " * (MAX_LIST + 1), where="f")
    assert caught.value.reason is Reason.INPUT_TOO_LARGE
    with pytest.raises(MalformedError, match="UTF-8"):
        list_text(b"\xff", where="f")


GRAPH = """\
# what runs
/cmd_vel [geometry_msgs/msg/Twist]
/chatter [std_msgs/msg/String, std_msgs/msg/Empty]
/reset [std_srvs/srv/Empty]
/navigate [nav2_msgs/action/NavigateToPose]
"""
SHOWN = """\
#goal definition
geometry_msgs/PoseStamped pose
\tstd_msgs/Header header
\t\tbuiltin_interfaces/Time stamp
\t\t\tint32 sec
\t\tstring frame_id
\tPose pose  # where
geometry_msgs/PoseStamped[] via
\tstring frame_id
uint8 FAST=1
float64[<=3] weights
string<=10 tree "none"
---
int16 result
"""


def test_the_lines_of_a_graph_are_read_with_the_fields_that_ros_itself_defines() -> None:
    speed, chatter, reset, go = read_ros(GRAPH, where="f")
    assert (speed.kind, speed.name, speed.type) == (
        InterfaceKind.TOPIC,
        "/cmd_vel",
        "geometry_msgs/msg/Twist",
    )
    assert speed.fields is not None
    assert list(speed.fields)[:2] == ["linear.x", "linear.y"]
    assert (chatter.type, chatter.fields) == ("", None)
    assert (reset.kind, reset.fields, go.kind, go.fields) == (
        InterfaceKind.SERVICE,
        None,
        InterfaceKind.ACTION,
        None,
    )


def test_definitions_are_read_as_written_and_as_the_tool_prints_them() -> None:
    graph = {
        "topics": {"/a": ["std_msgs/msg/String"]},
        "services": {"/empty": "std_srvs/srv/Empty"},
        "actions": {"/go": "nav2_msgs/action/NavigateToPose", "/wait": "nav2_msgs/action/Wait"},
        "types": {
            "nav2_msgs/action/NavigateToPose": SHOWN,
            "nav2_msgs/action/Wait": "builtin_interfaces/Duration time\n---\nint32 left",
            "std_srvs/srv/Empty": "---\n",
        },
    }
    named = {item.name: item.fields for item in read_ros(json.dumps(graph), where="f")}
    assert named["/go"] == {
        "pose.header.stamp.sec": False,
        "pose.header.frame_id": False,
        "pose.pose": True,
        "via.[].frame_id": False,
        "weights": True,
        "tree": False,
    }
    assert named["/wait"] == {"time.sec": False, "time.nanosec": False}
    assert named["/empty"] == {}
    assert named["/a"] == {"data": False}


def test_a_bad_graph_is_refused_with_its_place() -> None:
    for text, where in [
        ("/a [std_msgs/msg/String]\n/b", "f:2"),
        ("/a [std_msgs/msg/String, std_srvs/srv/Empty]", "f:1"),
        ("/a [String]", "f:1"),
        ("/a b [std_msgs/msg/String]", "f"),
        ("/a//b [std_msgs/msg/String]", "f:1"),
        ("/a [std_msgs/msg/String]\na [std_msgs/msg/String]", "f:2"),
        ("topics: {/a: std_srvs/srv/Empty}", "f:topics./a"),
        ("topics: {/a: []}", "f:topics./a"),
        ("topics: {}", "f"),
        ("topics: 3", "f:topics"),
        ("things: {}", "f"),
        ("just words", "f"),
        ("# nothing", "f"),
        ("topics: {/a: std_msgs/msg/String}\ntypes: {nothing: ''}", "f:types.nothing"),
        (
            "topics: {/a: a/msg/B}\ntypes: {a/msg/B: 'string x\n\n  9 !'}",
            "f:types.a/msg/B",
        ),
        ("topics: {/a: a/msg/B}\ntypes: {a/msg/B: '9 !'}", "f:types.a/msg/B"),
    ]:
        with case(text, where):
            with pytest.raises(MalformedError) as caught:
                read_ros(text, where="f")
            assert caught.value.where.startswith(where)


def test_a_definition_nested_without_end_is_refused() -> None:
    deep = "\n".join("\t" * n + "a/B x" for n in range(60))
    with pytest.raises(MalformedError, match="levels"):
        read_ros(json.dumps({"topics": {"/a": "a/msg/B"}, "types": {"a/msg/B": deep}}), where="f")
    wide = "\n".join(f"int8 x{n}" for n in range(MAX_FIELDS + 1))
    with pytest.raises(MalformedError) as caught:
        read_ros(json.dumps({"topics": {"/a": "a/msg/B"}, "types": {"a/msg/B": wide}}), where="f")
    assert caught.value.reason is Reason.INPUT_TOO_LARGE


JSONS = st.recursive(
    st.none() | st.booleans() | st.integers() | st.text(max_size=8),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(
            st.sampled_from(
                ["tools", "name", "inputSchema", "properties", "type", "items", "function", "x"]
            )
            | st.text(max_size=4),
            inner,
            max_size=4,
        )
    ),
    max_leaves=20,
)


@settings(max_examples=amount(60, 300))
@given(JSONS)
def test_whatever_json_is_a_list_or_an_error_with_a_place(value: Any) -> None:
    text = json.dumps(value)
    places: list[str] = []
    for read in (read_mcp, read_openai, read_ros):
        try:
            assert read(text, where="f")
        except MalformedError as error:
            places.append(error.where)
    assert all(place.startswith(("f", "list")) for place in places)


@settings(max_examples=amount(40, 200))
@given(st.text(max_size=200))
def test_whatever_text_is_a_list_or_an_error_with_a_place(text: str) -> None:
    places: list[str] = []
    for read in (read_mcp, read_openai, read_ros):
        try:
            assert read(text, where="f")
        except MalformedError as error:
            places.append(error.where)
    assert all(places)
