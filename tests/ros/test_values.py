# SPDX-License-Identifier: Apache-2.0
"""Messages are read as what they say: no NaN, no number of another kind, no word unseen (L3)."""

from __future__ import annotations

import math
import struct
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2 (tests/ros/make.sh makes an environment)")

from geometry_msgs.msg import Point32, PoseStamped
from hypothesis import given
from hypothesis import strategies as st
from test_msgs import msg
from test_msgs.action import Fibonacci

import ros.graph  # noqa: F401 - its imports first: they warn
from authguard_r.core.errors import EnvironmentFault, MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.integrations.ros.names import TypePart
from authguard_r.integrations.ros.nodes.values import (
    MAX_VALUES,
    load_type,
    message_of,
    plain_of,
    require_narrow,
    texts_of,
)

EVERY = (
    "Arrays",
    "BasicTypes",
    "BoundedSequences",
    "Builtins",
    "Defaults",
    "Empty",
    "MultiNested",
    "Nested",
    "Strings",
    "UnboundedSequences",
    "WStrings",
)


@pytest.mark.parametrize("name", EVERY)
def test_a_message_that_was_read_and_made_again_is_the_same(name: str) -> None:
    kind = load_type(f"test_msgs/msg/{name}", TypePart.MESSAGE)
    plain = plain_of(kind())
    assert message_of(kind, plain) == kind()
    assert plain_of(message_of(kind, plain)) == plain


def test_what_the_rebuilt_call_leaves_out_is_the_types_default() -> None:
    assert message_of(PoseStamped, {}).pose.orientation.w == 1.0
    assert message_of(msg.Defaults, {"int8_value": 3}).uint8_value == msg.Defaults().uint8_value


@given(st.integers(0, 2**32 - 1))
def test_a_number_of_32_bits_is_the_shortest_decimal_that_means_it(bits: int) -> None:
    (value,) = struct.unpack("<f", struct.pack("<I", bits))
    if not math.isfinite(value):
        return
    read = plain_of(Point32(x=value))["x"]
    assert struct.pack("<f", read) == struct.pack("<f", value)
    assert len(repr(read)) <= len(repr(value))


def test_a_tenth_of_32_bits_is_a_tenth() -> None:
    (tenth,) = struct.unpack("<f", struct.pack("<f", 0.1))
    assert plain_of(Point32(x=tenth))["x"] == 0.1


@pytest.mark.smoke
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_l3_a_number_that_is_none_is_refused_with_its_place(value: float) -> None:
    goal = PoseStamped()
    goal.pose.position.x = value
    with pytest.raises(MalformedError) as refused:
        plain_of(goal, where="args.pose")
    assert refused.value.where == "args.pose.pose.position.x"
    nested = msg.MultiNested()
    nested.array_of_arrays[1].float32_values[2] = value
    with pytest.raises(MalformedError) as refused:
        plain_of(nested)
    assert refused.value.where == "array_of_arrays[1].float32_values[2]"


WRONG: list[tuple[Any, dict[str, Any], str]] = [
    (msg.BasicTypes, {"x": 1}, "x"),
    (msg.BasicTypes, {"int8_value": 128}, "int8_value"),
    (msg.BasicTypes, {"uint64_value": -1}, "uint64_value"),
    (msg.BasicTypes, {"int32_value": 1.0}, "int32_value"),
    (msg.BasicTypes, {"int32_value": True}, "int32_value"),
    (msg.BasicTypes, {"bool_value": 1}, "bool_value"),
    (msg.BasicTypes, {"float64_value": "1"}, "float64_value"),
    (msg.BasicTypes, {"float64_value": True}, "float64_value"),
    (msg.BasicTypes, {"float64_value": math.nan}, "float64_value"),
    (msg.BasicTypes, {"float64_value": 10**400}, "float64_value"),
    (msg.BasicTypes, {"float32_value": 1e39}, "float32_value"),
    (msg.BasicTypes, {"byte_value": 256}, "byte_value"),
    (msg.Strings, {"string_value": 1}, "string_value"),
    (msg.Strings, {"string_value": "a\0b"}, "string_value"),
    (msg.Strings, {"bounded_string_value": "x" * 23}, "bounded_string_value"),
    (msg.Arrays, {"int8_values": [1, 2]}, "int8_values"),
    (msg.Arrays, {"int8_values": [1, 2, None]}, "int8_values[2]"),
    (msg.Arrays, {"basic_types_values": [{}, {}, {"x": 1}]}, "basic_types_values[2].x"),
    (msg.BoundedSequences, {"int8_values": [1, 2, 3, 4]}, "int8_values"),
    (msg.Nested, {"basic_types_value": []}, "basic_types_value"),
]


@pytest.mark.parametrize(("kind", "plain", "where"), WRONG)
def test_l3_a_value_that_is_not_the_fields_is_refused_with_its_place(
    kind: Any, plain: dict[str, Any], where: str
) -> None:
    with pytest.raises(MalformedError) as refused:
        message_of(kind, plain)
    assert refused.value.where == where


def test_more_values_than_any_goal_has_are_refused() -> None:
    much = msg.UnboundedSequences(int8_values=[0] * (MAX_VALUES + 1))
    with pytest.raises(MalformedError) as refused:
        plain_of(much)
    assert refused.value.reason is Reason.INPUT_TOO_LARGE


def test_every_word_is_found_in_bytes_too() -> None:
    inner = msg.UnboundedSequences(string_values=["one", "two", "one"])
    inner.byte_values = [b"f", b"o", b"u", b"r"]
    inner.uint8_values = list(b"five")
    whole = msg.MultiNested()
    whole.unbounded_sequence_of_unbounded_sequences = [inner]
    assert {"one", "two", "four", "five"} <= set(texts_of(whole))
    assert texts_of(whole).count("one") == 1
    wide = msg.WStrings(wstring_value="ハロー")
    assert "ハロー" in texts_of(wide)
    assert texts_of(Fibonacci.Goal(order=1)) == ()


@pytest.mark.parametrize(
    ("kind", "part"),
    [
        (msg.WStrings, TypePart.MESSAGE),
        (SimpleNamespace(Goal=msg.WStrings, Result=msg.Empty), TypePart.ACTION),
        (SimpleNamespace(Request=msg.WStrings, Response=msg.Empty), TypePart.SERVICE),
    ],
)
def test_l3_a_wide_string_is_nothing_that_a_planner_sends(kind: Any, part: TypePart) -> None:
    """Units that are no character end the thread that takes them, before anybody could refuse."""
    with pytest.raises(MalformedError, match="wstring"):
        require_narrow(kind, part, where="mediated.it.type")
    answers = SimpleNamespace(Request=msg.Empty, Response=msg.WStrings)  # the robot's own report
    for narrow, of in (
        (msg.MultiNested, TypePart.MESSAGE),
        (Fibonacci, TypePart.ACTION),
        (answers, TypePart.SERVICE),
    ):
        require_narrow(narrow, of, where="mediated.it.type")


@pytest.mark.parametrize("name", ["no_msgs/msg/Thing", "std_msgs/msg/Nothing"])
def test_a_type_that_is_not_installed_is_an_error_at_the_start(name: str) -> None:
    with pytest.raises(EnvironmentFault, match="to be installed"):
        load_type(name, TypePart.MESSAGE)


@pytest.mark.parametrize("name", ["std_msgs/msg/../x", "os/msg/path", "std_msgs/srv/String", ""])
def test_what_is_no_types_name_is_never_imported(name: str) -> None:
    with pytest.raises((MalformedError, EnvironmentFault)):
        load_type(name, TypePart.MESSAGE)
