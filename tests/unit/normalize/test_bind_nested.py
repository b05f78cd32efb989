# SPDX-License-Identifier: Apache-2.0
"""Nested goals, positions, words and ways: what they mean, and every refusal with its place."""

from __future__ import annotations

from decimal import Decimal
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from authguard_r.core.action import Action
from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.normalize.bind import MAX_ROUTE, Binder
from authguard_r.normalize.dialects import Call
from fixtures.amount import amount
from fixtures.cases import case
from unit.normalize.bound import (
    GO_BY_STOPS,
    GO_TO_POSE,
    HELD,
    NOTED,
    POSE,
    REFUSED,
    WAIT,
    Plain,
    bind,
    fixed,
    load,
    mapped,
    number,
    refused,
    site,
    spot,
    square,
    wait,
)

#: Meters in the middle of the first and the second square.
FIRST = spot(1, 1)
SECOND = spot(Decimal("4.0"), 1)


def navigate(destination: str, *route: str) -> Action:
    return Action(
        type="navigate",
        tool="base",
        destination=destination,
        route=route,
        params={"speed_mm_s": 500},
    )


# -- positions -------------------------------------------------------------------------------------


def test_a_position_means_the_region_that_it_lies_in() -> None:
    for pose in (spot(1, 1), spot(Decimal("0.001"), Decimal("1.999")), spot(Decimal("1e0"), 1)):
        assert bind(GO_TO_POSE, {"goal": pose}) == navigate("square-1")
    assert bind(GO_TO_POSE, {"goal": SECOND}) == navigate("square-2")


def test_where_the_robot_looks_and_what_is_noted_changes_nothing() -> None:
    looks = {**FIRST["pose"], "orientation": {"z": Decimal("0.7"), "w": Decimal("0.7")}}
    assert bind(GO_TO_POSE, {"goal": {**FIRST, "pose": looks}}) == navigate("square-1")


@settings(max_examples=amount(40, 200))
@given(st.integers(-4000, 12_000), st.integers(-1000, 3000))
def test_every_position_is_in_its_one_square_or_refused(x: int, y: int) -> None:
    squares = {f"square-{n}": left for n, left in ((1, 0), (2, 3000), (3, 6000))}
    homes = [name for name, left in squares.items() if left <= x <= left + 2000 and 0 <= y <= 2000]
    pose = {"goal": spot(Decimal(x) / 1000, Decimal(y) / 1000)}
    if homes:
        assert bind(GO_TO_POSE, pose) == navigate(*homes)
    else:
        refused(GO_TO_POSE, pose, Reason.NAME_UNKNOWN, "input")


def test_a_position_on_the_edge_of_two_regions_is_nobody_s_to_guess() -> None:
    joined = site(next_door=square(2000))
    found = refused(GO_TO_POSE, {"goal": spot(2, 1)}, Reason.NAME_AMBIGUOUS, "input", at=joined)
    assert "next_door, square-1" in found.message
    near = bind(GO_TO_POSE, {"goal": spot(Decimal("2.001"), 1)}, joined)
    assert near.destination == "next_door"


def test_a_position_where_two_regions_overlap_is_refused() -> None:
    refused(
        GO_TO_POSE,
        {"goal": FIRST},
        Reason.NAME_AMBIGUOUS,
        "input",
        at=site(alcove=square(500, 500, side=1000)),
    )


def test_a_position_in_a_region_within_another_means_the_inner_one() -> None:
    """The author said that it lies there; a pose in it lies in both, and a lease checks both."""
    nested = site(
        alcove=square(1000, 0, side=1000, within="square-1"),
        niche=square(1000, 0, side=500, within="alcove"),
        bay=square(1000, 1000, side=1000, within="square-1"),
    )

    def at(x: str, y: str) -> str | None:
        goal = {"goal": spot(Decimal(x), Decimal(y))}
        return bind(GO_TO_POSE, goal, nested).destination

    assert [at("0.5", "0.5"), at("1.7", "0.7"), at("1.2", "0.2")] == ["square-1", "alcove", "niche"]
    found = refused(
        GO_TO_POSE, {"goal": spot(Decimal("1.7"), 1)}, Reason.NAME_AMBIGUOUS, "input", at=nested
    )
    assert "alcove, bay" in found.message


def test_a_frame_is_one_of_the_site_s_maps_exactly() -> None:
    """Another frame moves the same numbers to another place (L16)."""
    place = "input.goal.header.frame_id"
    for frame in ("odom", "base_link", "Map", " map", "map/", "/map", ""):
        refused(GO_TO_POSE, {"goal": spot(1, 1, frame)}, Reason.NAME_UNKNOWN, place)
    for frame in (None, 1, ["map"]):
        refused(GO_TO_POSE, {"goal": spot(1, 1, frame)}, Reason.VALUE_INVALID, place)
    two = site(attic=square(0, frame="upper"))
    assert bind(GO_TO_POSE, {"goal": spot(1, 1, "upper")}, two).destination == "attic"
    assert bind(GO_TO_POSE, {"goal": spot(1, 1)}, two).destination == "square-1"


def test_a_position_without_a_frame_is_sought_on_every_map() -> None:
    tool = {
        **GO_TO_POSE,
        "arguments": {"x": number("pose.x"), "y": number("pose.y")},
    }
    assert bind(tool, {"x": 1, "y": 1}).destination == "square-1"
    two = site(attic=square(0, frame="upper"))
    refused(tool, {"x": 1, "y": 1}, Reason.NAME_AMBIGUOUS, "input", at=two)
    upper = {**tool, "fixed": {**HELD["fixed"], "pose.map": "upper"}}
    assert bind(upper, {"x": 1, "y": 1}, two).destination == "attic"
    assert bind({**upper, "fixed": HELD["fixed"]}, {"x": 4, "y": 1}, two).destination == "square-2"


@pytest.mark.parametrize("value", ["1", None, True, [], {}, "NaN"])
def test_a_coordinate_is_a_number(value: Any) -> None:
    where = "input.goal.pose.position.x"
    refused(GO_TO_POSE, {"goal": spot(value, 1)}, Reason.VALUE_INVALID, where)


def test_a_coordinate_beyond_the_world_is_out_of_range() -> None:
    where = "input.goal.pose.position.y"
    refused(GO_TO_POSE, {"goal": spot(1, 10**30)}, Reason.VALUE_OUT_OF_RANGE, where)


# -- nesting ---------------------------------------------------------------------------------------


def test_one_stray_leaf_refuses_the_goal_in_its_place() -> None:
    for change, reason, where in [
        ({"behavior_tree": "other.xml"}, Reason.FIELD_REFUSED, "input.behavior_tree"),
        ({"timeout": 5}, Reason.FIELD_UNKNOWN, "input.timeout"),
        ({"goal.pose": {}}, Reason.FIELD_UNKNOWN, "input.goal.pose"),
        ({"goal": {**FIRST, "id": 1}}, Reason.FIELD_UNKNOWN, "input.goal.id"),
        (
            {"goal": {**FIRST, "header": {"frame_id": "map", "seq": {"a": 1}}}},
            Reason.FIELD_UNKNOWN,
            "input.goal.header.seq",
        ),
        ({"goal": "square-1"}, Reason.VALUE_INVALID, "input.goal"),
        ({"goal": [FIRST]}, Reason.VALUE_INVALID, "input.goal"),
        ({"goal": None}, Reason.FIELD_MISSING, "input.goal.header.frame_id"),
        ({"goal": {}}, Reason.FIELD_MISSING, "input.goal.header.frame_id"),
        (
            {"goal": {**FIRST, "pose": {"position": {"x": 1}}}},
            Reason.FIELD_MISSING,
            "input.goal.pose.position.y",
        ),
        (
            {"goal": {**FIRST, "pose": {"position": {"x": 1, "y": 1, "z": 1}}}},
            Reason.FIELD_REFUSED,
            "input.goal.pose.position.z",
        ),
    ]:
        with case(change, reason, where):
            good = {"goal": FIRST, "behavior_tree": ""}
            assert bind(GO_TO_POSE, good) == navigate("square-1")
            refused(GO_TO_POSE, {**good, **change}, reason, where)


@settings(max_examples=amount(30, 150))
@given(
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.text(max_size=4),
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=4), inner),
        max_leaves=8,
    )
)
def test_whatever_stands_in_a_goal_is_an_action_or_a_refusal_with_a_place(goal: Any) -> None:
    for tool in (GO_TO_POSE, GO_BY_STOPS):
        for name in ("goal", "poses"):
            with pytest.raises(MalformedError) as caught:
                bind(tool, {name: goal})
            assert caught.value.where.startswith("input")


#: A tool with one argument of each kind that nesting knows.
MIXED: Plain = {
    "type": "pick",
    "tool": "hand",
    "attested": ["source"],
    "arguments": {
        "things.0": mapped("object", also=["1"]),
        "force.newton": number("params.force_mn"),
        "mode": fixed(value=True, also=["2"]),
        "why": NOTED,
        "grasps": REFUSED,
    },
}
GOOD: Plain = {"things": ["Thing 1"], "force": {"newton": 5}, "mode": True}


def test_an_argument_has_one_place_and_perhaps_other_names() -> None:
    plain = Action(type="pick", tool="hand", object="thing-1", params={"force_mn": 5000})
    assert bind(MIXED, GOOD) == plain
    assert bind(MIXED, {"1": "Thing 1", "force": {"newton": 5}, "2": True}) == plain
    assert bind(MIXED, {**GOOD, "why": {"any": ["thing"]}}) == plain


def test_one_fault_among_nested_arguments_is_refused_in_its_place() -> None:
    for change, reason, where in [
        ({"1": "Thing 2"}, Reason.VALUE_INVALID, "input.1"),
        ({"2": True}, Reason.VALUE_INVALID, "input.2"),
        ({"things": ["Thing 1", "Thing 2"]}, Reason.FIELD_UNKNOWN, "input.things[1]"),
        ({"things": {"0": "Thing 1"}}, Reason.VALUE_INVALID, "input.things"),
        ({"things": "Thing 1"}, Reason.VALUE_INVALID, "input.things"),
        ({"things": []}, Reason.FIELD_MISSING, "input.things[0]"),
        ({"things": [["Thing 1"]]}, Reason.VALUE_INVALID, "input.things[0]"),
        ({"things": ["Thing 3"]}, Reason.NAME_UNKNOWN, "input.things[0]"),
        ({"mode": 1}, Reason.FIELD_REFUSED, "input.mode"),
        ({"mode": "true"}, Reason.FIELD_REFUSED, "input.mode"),
        ({"grasps": []}, Reason.FIELD_REFUSED, "input.grasps"),
        ({"force": 5}, Reason.VALUE_INVALID, "input.force"),
        ({"\u0430": 5}, Reason.FIELD_UNKNOWN, "input.\\u0430"),
    ]:
        with case(change, reason, where):
            refused(MIXED, {**GOOD, **change}, reason, where)


def test_a_fixed_argument_that_is_not_optional_must_be_there() -> None:
    given = {name: value for name, value in GOOD.items() if name != "mode"}
    refused(MIXED, given, Reason.FIELD_MISSING, "input.mode")


# -- words and numbers -----------------------------------------------------------------------------


def test_a_word_is_the_number_that_the_binding_gives_it() -> None:
    tool = wait(values={"short": 1000, "long": 60_000}, per_unit="1")
    assert bind(tool, {"seconds": "long"}).params == {"duration_ms": 60_000}
    for value in ("Long", "", 1000, None, ["long"]):
        error = refused(tool, {"seconds": value}, Reason.VALUE_INVALID, "input.seconds")
        assert "short, long" in error.message


def test_a_whole_number_is_written_as_one() -> None:
    assert bind(wait(whole=True), {"seconds": 2}).params == {"duration_ms": 2000}
    for value in (Decimal("2.0"), Decimal("1.5"), True, "2"):
        refused(wait(whole=True), {"seconds": value}, Reason.VALUE_INVALID, "input.seconds")


def test_an_offset_is_added_before_rounding() -> None:
    tool = {
        "type": "climate",
        "tool": "car",
        "fixed": {"params.level_permille": 0, "params.mode_no": 0},
        "arguments": {"celsius": mapped("params.temperature_mk", per_unit="1000", offset=273_150)},
    }
    for value, expected in (
        (22, 295_150),
        (Decimal("21.5"), 294_650),
        (Decimal("0.0004"), 273_150),
    ):
        assert bind(tool, {"celsius": value}).params["temperature_mk"] == expected
    refused(tool, {"celsius": -1}, Reason.VALUE_OUT_OF_RANGE, "input.celsius")


def test_a_fixed_decimal_is_compared_as_a_number() -> None:
    tool = {
        **wait(),
        "arguments": {**wait()["arguments"], "share": {"use": "fixed", "decimal": "0.5"}},
    }
    assert bind(tool, {"seconds": 1, "share": Decimal("0.50")}).params == {"duration_ms": 1000}
    for value in (Decimal("0.51"), 0, "0.5", True):
        refused(tool, {"seconds": 1, "share": value}, Reason.FIELD_REFUSED, "input.share")


# -- lists of places -------------------------------------------------------------------------------


def test_the_last_stop_is_the_destination_and_those_before_it_the_route() -> None:
    assert bind(GO_BY_STOPS, {"poses": [FIRST]}) == navigate("square-1")
    found = bind(GO_BY_STOPS, {"poses": [FIRST, SECOND, FIRST]})
    assert found == navigate("square-1", "square-1", "square-2")


def test_a_list_with_one_fault_is_refused_at_its_entry() -> None:
    for poses, reason, where in [
        ([], Reason.VALUE_INVALID, "input.poses"),
        ([FIRST] * (MAX_ROUTE + 1), Reason.VALUE_INVALID, "input.poses"),
        ({"0": FIRST}, Reason.VALUE_INVALID, "input.poses"),
        (["square-1"], Reason.VALUE_INVALID, "input.poses[0]"),
        ([FIRST, None], Reason.VALUE_INVALID, "input.poses[1]"),
        ([FIRST, spot(90, 1)], Reason.NAME_UNKNOWN, "input.poses[1]"),
        ([FIRST, {**FIRST, "id": 1}], Reason.FIELD_UNKNOWN, "input.poses[1].id"),
        ([FIRST, {"pose": FIRST["pose"]}], Reason.FIELD_MISSING, "input.poses[1].header.frame_id"),
    ]:
        with case(poses, reason, where):
            refused(GO_BY_STOPS, {"poses": poses}, reason, where)


def test_stops_and_routes_can_be_items_with_names() -> None:
    each = {"name": mapped("region"), "loops": fixed(0, optional=True)}
    tool = {**GO_BY_STOPS, "arguments": {"poses": mapped("stops", each=each)}}
    assert bind(tool, {"poses": [{"name": "Square 2"}, {"name": "square-1", "loops": 0}]}) == (
        navigate("square-1", "square-2")
    )
    refused(
        tool,
        {"poses": [{"name": "Square 2", "loops": 3}]},
        Reason.FIELD_REFUSED,
        "input.poses[0].loops",
    )
    via = {"to": mapped("destination"), "via": mapped("route", each=each)}
    tool = {**GO_BY_STOPS, "arguments": via}
    assert bind(tool, {"to": "Square 3", "via": []}) == navigate("square-3")
    assert bind(tool, {"to": "Square 3", "via": [{"name": "Square 1"}]}) == (
        navigate("square-3", "square-1")
    )


def test_two_ways_to_one_place_are_one_action() -> None:
    by_name = {**GO_TO_POSE, "arguments": {"place": mapped("destination")}}
    assert bind(by_name, {"place": "Square 1"}) == bind(GO_TO_POSE, {"goal": FIRST})
    assert bind(GO_BY_STOPS, {"poses": [FIRST]}) == bind(GO_TO_POSE, {"goal": FIRST})


# -- ways ------------------------------------------------------------------------------------------

PUBLISH: list[Plain] = [
    {**wait(), "when": {"topic": "/pause", "msg.kind": 1}},
    {"type": "hold", "tool": "base", "attested": [], "when": {"topic": "/pause", "msg.kind": 2}},
    {"type": "hold", "tool": "base", "when": {"topic": "/halt", "items.0": True}},
    {
        "type": "set_pose",
        "tool": "base",
        "when": {"topic": "/initialpose"},
        "arguments": {"msg": REFUSED},
    },
]


def test_a_call_is_the_one_way_whose_constants_it_has() -> None:
    first = {"topic": "/pause", "msg": {"kind": 1}, "seconds": 1}
    assert bind(PUBLISH, first).type == "wait"
    assert bind(PUBLISH, {"topic": "/pause", "msg": {"kind": 2}}).type == "hold"
    assert bind(PUBLISH, {"topic": "/halt", "items": [True]}).type == "hold"
    refused(PUBLISH, {"topic": "/initialpose"}, Reason.STATE_WRITING_REFUSED, "input")


def test_the_form_of_a_message_may_be_left_out_where_its_name_has_one_form() -> None:
    drive = {**WAIT, "type": "hold", "when": {"topic": "/go", "type": "a/msg/B"}}
    stop = {**WAIT, "type": "hold", "when": {"topic": "/stop", "type": "a/msg/B"}}
    other = {**WAIT, "type": "hold", "when": {"topic": "/stop", "type": "a/msg/C"}}
    ways = [drive, stop, other]
    said = {"topic": "/go"}
    assert bind(ways, said) == bind(ways, {**said, "type": "a/msg/B"})
    for arguments, where in [
        ({**said, "type": "a/msg/C"}, "input.topic"),
        ({**said, "type": None}, "input.type"),
        ({**said, "topic": "/stop"}, "input.type"),  # two forms: the binding does not know it
        ({"type": "a/msg/B"}, "input.topic"),
    ]:
        with case(arguments):
            refused(ways, arguments, Reason.TOOL_UNKNOWN, where)


def test_a_name_is_what_the_executor_resolves_and_nothing_like_it() -> None:
    """Another spelling is another topic (L2)."""
    for topic in [
        "pause",
        "/pause/",
        "//pause",
        "/Pause",
        " /pause",
        "/pause ",
        "/p\u0430use",
        "",
        None,
    ]:
        with case(topic):
            refused(
                PUBLISH, {"topic": topic, "msg": {"kind": 2}}, Reason.TOOL_UNKNOWN, "input.topic"
            )


def test_a_call_that_is_no_way_is_refused_at_the_value_that_fits_none() -> None:
    for arguments, where in [
        ({}, "input.topic"),
        ({"topic": "/pause"}, "input.msg.kind"),
        ({"topic": "/pause", "msg": {"kind": 3}}, "input.msg.kind"),
        ({"topic": "/pause", "msg": {"kind": True}}, "input.msg.kind"),
        ({"topic": "/pause", "msg": 1}, "input.msg.kind"),
        ({"topic": "/halt", "items": []}, "input.msg.kind"),
        ({"topic": "/halt", "msg": {"kind": 1}, "items": [False]}, "input.items[0]"),
        ({"topic": "/halt", "msg": {"kind": 1}, "items": [True, True]}, "input.msg"),
    ]:
        with case(arguments, where):
            reason = Reason.FIELD_UNKNOWN if where == "input.msg" else Reason.TOOL_UNKNOWN
            refused(PUBLISH, arguments, reason, where)


def test_values_that_each_fit_a_way_but_none_together_are_refused() -> None:
    ways = [
        {**WAIT, "type": "hold", "when": {"a": 1, "b": 1}},
        {**WAIT, "type": "hold", "when": {"a": 2, "b": 2}},
    ]
    refused(ways, {"a": 1, "b": 2}, Reason.TOOL_UNKNOWN, "input.a")


def test_what_state_must_fill_is_said_for_the_way_that_the_call_is() -> None:
    ways = [
        {**GO_TO_POSE, "when": {"kind": "pose"}},
        {"type": "hold", "tool": "base", "when": {"kind": "hold"}},
    ]
    place = site()
    binder = Binder(place, load({"go": ways}, place))
    assert binder.way(Call("go", {"kind": "pose", "goal": FIRST}, "x")).attested == ("source",)
    assert binder.way(Call("go", {"kind": "hold"}, "x")).attested == ()


def test_the_pose_s_own_fields_are_those_of_the_language() -> None:
    assert {argument.get("to") for argument in POSE.values()} >= {"pose.x", "pose.y", "pose.map"}
