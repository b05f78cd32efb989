# SPDX-License-Identifier: Apache-2.0
"""The language of nested, fixed and alternative fields: each fault alone, each near miss."""

from __future__ import annotations

from typing import Any

import pytest

from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.normalize.binding import (
    Argument,
    ArgumentUse,
    Binding,
    ToolBinding,
    binding_digest,
    load_binding,
    same,
    ways,
)
from fixtures import scenarios
from fixtures.cases import case
from unit.normalize.bound import (
    GO_BY_STOPS,
    GO_TO_POSE,
    HELD,
    NOTED,
    POSE,
    WAIT,
    Plain,
    fault,
    fixed,
    load,
    mapped,
    number,
    plain,
    site,
    square,
    wait,
)

SECONDS: Plain = mapped("params.duration_ms", per_unit="1000")


def with_arguments(**arguments: Any) -> Plain:
    return {**WAIT, "arguments": {"seconds": SECONDS, **arguments}}


def by_name(**more: Any) -> Plain:
    return {
        "type": "navigate",
        "tool": "base",
        "fixed": {"params.speed_mm_s": 500},
        "attested": ["source"],
        "arguments": {"to": mapped("destination")},
        **more,
    }


def stops(**argument: Any) -> Plain:
    return {**GO_BY_STOPS, "arguments": {"poses": {**mapped("stops", each=POSE), **argument}}}


FAULTS: dict[str, tuple[Plain, str]] = {
    "fixed without a value": (with_arguments(a={"use": "fixed"}), "arguments.a.value"),
    "mapped with a value": (wait(value=1), "arguments.seconds.value"),
    "refused with a value": (
        with_arguments(a={"use": "refused", "value": ""}),
        "arguments.a.value",
    ),
    "a decimal that is whole": (
        with_arguments(a={"use": "noted", "decimal": "1"}),
        "arguments.a.decimal",
    ),
    "a decimal with a second spelling": (
        with_arguments(a={"use": "noted", "decimal": "0.10"}),
        "arguments.a.decimal",
    ),
    "a value and a decimal": (
        with_arguments(a={"use": "fixed", "value": 1, "decimal": "0.1"}),
        "arguments.a.decimal",
    ),
    "words for a place": (
        by_name(arguments={"to": mapped("destination", values={"dock": 1})}),
        "arguments.to.values",
    ),
    "a word outside the type's range": (
        wait(values={"never": 0}),
        "arguments.seconds.values.never",
    ),
    "a list of nothing": (
        by_name(arguments={"to": mapped("stops")}),
        "arguments.to.each",
    ),
    "a list for one place": (
        by_name(arguments={"to": mapped("destination", each={"name": mapped("region")})}),
        "arguments.to.each",
    ),
    "a list of places without a place": (stops(each={"a": NOTED}), "arguments.poses.each"),
    "a list of half positions": (stops(each={"x": number("pose.x")}), "arguments.poses.each"),
    "a list of lists": (
        stops(each={"name": mapped("region"), "a": {**NOTED, "each": {"b": NOTED}}}),
        "arguments.poses.each.a",
    ),
    "another name within a list": (
        stops(each={"name": mapped("region", also=["1"])}),
        "arguments.poses.each.name",
    ),
    "a fault within a list": (
        stops(each={"name": mapped("region"), "a": {"use": "fixed"}}),
        "arguments.poses.each.a.value",
    ),
    "a path within a path, in a list": (
        stops(each={"name": mapped("region"), "a": NOTED, "a.b": NOTED}),
        "arguments.poses.each.a.b",
    ),
    "stops that may be left out": (stops(optional=True), "arguments.poses.optional"),
    "half a position": (
        by_name(arguments={"x": number("pose.x")}),
        "pose",
    ),
    "a map without a position": (
        by_name(arguments={"to": mapped("destination"), "frame": mapped("pose.map")}),
        "pose",
    ),
    "a position for a type that goes nowhere": (
        with_arguments(x=number("pose.x"), y=number("pose.y")),
        "destination",
    ),
    "a position and a name": (
        {**GO_TO_POSE, "arguments": {**GO_TO_POSE["arguments"], "to": mapped("destination")}},
        "destination",
    ),
    "a height": (
        {**GO_TO_POSE, "arguments": {**GO_TO_POSE["arguments"], "z": number("pose.z")}},
        "pose.z",
    ),
    "a map that the site does not have": (
        by_name(
            arguments={"x": number("pose.x"), "y": number("pose.y")},
            fixed={"params.speed_mm_s": 500, "pose.map": "cellar"},
        ),
        "fixed.pose.map",
    ),
    "a fixed position": (
        by_name(fixed={"params.speed_mm_s": 500, "pose.x": 1}),
        "fixed.pose.x",
    ),
    "monitored but not fixed": (
        {
            **by_name(fixed={}, monitored=["params.speed_mm_s"]),
            "arguments": {"to": mapped("destination"), "v": mapped("params.speed_mm_s")},
        },
        "monitored.params.speed_mm_s",
    ),
    "monitored but shown by nothing": (
        {**WAIT, "fixed": {"params.duration_ms": 1}, "monitored": ["params.duration_ms"]},
        "monitored.params.duration_ms",
    ),
    "monitored and no parameter": (
        {
            **by_name(),
            "fixed": {**HELD["fixed"], "source": "square-1"},
            "attested": [],
            "monitored": ["source"],
        },
        "monitored.source",
    ),
    "a path within a path": (with_arguments(**{"a": NOTED, "a.b": NOTED}), "arguments.a.b"),
    "a path within a constant": (
        {**with_arguments(**{"mode.x": NOTED}), "when": {"mode": 1}},
        "arguments.mode.x",
    ),
    "a constant that is an argument": (
        {**with_arguments(mode=NOTED), "when": {"mode": 1}},
        "arguments.mode",
    ),
    "another name that is an argument": (
        with_arguments(a=NOTED, b={**NOTED, "also": ["a"]}),
        "arguments.a",
    ),
    "nothing between dots": (with_arguments(**{"a..b": NOTED}), "arguments.a..b"),
    "no name at all": (with_arguments(**{"": NOTED}), "arguments."),
    "a list without its first item": (with_arguments(**{"a.1": NOTED}), "arguments.a"),
    "a list that is an object too": (
        with_arguments(**{"a.0": NOTED, "a.b": NOTED}),
        "arguments.a",
    ),
}


def test_a_tool_with_one_fault_is_refused_in_its_place() -> None:
    for name, (tool, place) in FAULTS.items():
        with case(name):
            where, message = fault(tool)
            assert where == f"tools.go.{place}"
            assert message.startswith("expected ")


SOUND: dict[str, Plain] = {
    "a pose": GO_TO_POSE,
    "a list of poses": GO_BY_STOPS,
    "a list of names": stops(each={"name": mapped("region"), "kind": fixed("place")}),
    "a fixed truth value": with_arguments(a=fixed(value=False)),
    "a fixed word": with_arguments(a=fixed("")),
    "a fixed decimal": with_arguments(a={"use": "fixed", "decimal": "-0.5"}),
    "a noted value": with_arguments(a={"use": "noted", "value": 1}),
    "two items of a list": with_arguments(**{"a.0": NOTED, "a.1": NOTED}),
    "positions": {**WAIT, "arguments": {"1": SECONDS, "2": NOTED}},
    "words": wait(values={"short": 1000, "long": 60_000}, per_unit="1"),
    "a fixed map": by_name(
        arguments={"x": number("pose.x"), "y": number("pose.y")},
        fixed={"params.speed_mm_s": 500, "pose.map": "map"},
    ),
    "a route of items": by_name(
        arguments={
            "to": mapped("destination"),
            "via": mapped("route", optional=True, each={"name": mapped("region")}),
        }
    ),
    "one way with a constant": {**with_arguments(), "when": {"mode": "slow"}},
}


def test_a_tool_that_just_keeps_the_rule_is_sound() -> None:
    for name, tool in SOUND.items():
        with case(name):
            assert isinstance(load({"go": tool}).tools["go"], ToolBinding)


def test_ways_that_a_call_could_both_be_are_refused() -> None:
    """Two ways are apart when they hold one argument to different constants."""
    one = {**with_arguments(), "when": {"mode": 1}}
    where, message = fault([one, {**with_arguments(), "when": {"mode": 1}}])
    assert where == "tools.go[1].when"
    assert "tools.go[0]" in message
    assert fault([one, {**with_arguments(), "when": {"pace": 2}}])[0] == "tools.go[1].when"
    assert fault([one, with_arguments()])[0] == "tools.go[1].when"
    apart = [one, {**with_arguments(), "when": {"mode": True}}]
    assert [way.place for way in ways(load({"go": apart}))] == ["tools.go[0]", "tools.go[1]"]


def test_a_fault_within_one_of_several_ways_is_named_with_its_number() -> None:
    good = {**with_arguments(), "when": {"mode": 1}}
    bad = {**with_arguments(a={"use": "fixed"}), "when": {"mode": 2}}
    assert fault([good, bad])[0] == "tools.go[1].arguments.a.value"


def test_a_tool_of_no_ways_is_no_tool() -> None:
    where, _ = fault([])
    assert where == "binding:tools.go"


@pytest.mark.parametrize("name", ["g\u00f6", "\u0455top"])
def test_names_within_lists_and_other_names_are_ascii_too(name: str) -> None:
    for tool in (
        stops(each={"name": mapped("region"), name: NOTED}),
        with_arguments(a={**NOTED, "also": [name]}),
    ):
        assert "ASCII" in fault(tool)[1]


def test_a_binding_that_names_no_site_fits_any_with_its_types() -> None:
    data = plain({"go": with_arguments()})
    for place in (scenarios.site(), site()):
        assert load_binding(data, site=place, where="binding").site is None
    with pytest.raises(MalformedError) as caught:
        load_binding(plain({"go": GO_TO_POSE | {"type": "dock"}}), site=scenarios.site(), where="b")
    assert caught.value.where == "tools.go.type"
    with pytest.raises(MalformedError) as caught:
        load_binding({**data, "site": "elsewhere"}, site=site(), where="binding")
    assert (caught.value.where, caught.value.reason) == ("site", Reason.SCHEMA_INVALID)


def test_what_is_left_out_does_not_change_a_binding_s_digest() -> None:
    """The hospital's digest is in logs: the language grew without touching it."""
    assert binding_digest(scenarios.binding()) == "lP1ClaILC-6BcNXq8PlCJCLYEpAmwp2mKJXtY2rZcOI"
    bare = Binding(schema="authguard-r/binding/1", id="x", tools={})
    assert binding_digest(bare) != binding_digest(scenarios.binding())


def test_a_constant_is_only_itself() -> None:
    for value, constant, equal in [
        (1, 1, True),
        (0, False, False),
        (False, 0, False),
        (True, True, True),
        (1, True, False),
        ("", "", True),
        ("1", 1, False),
        (1, "1", False),
        (None, "", False),
        ([], 0, False),
        ({}, "", False),
    ]:
        with case(value, constant, equal):
            assert same(value, constant) is equal


def test_a_constant_is_the_value_or_the_decimal() -> None:
    assert Argument(use=ArgumentUse.NOTED).constant() is None
    assert Argument(use=ArgumentUse.NOTED, value=0).constant() == 0
    assert str(Argument(use=ArgumentUse.NOTED, decimal="0.1").constant()) == "0.1"


def test_a_region_of_another_map_can_be_fixed() -> None:
    two = site(attic=square(0, frame="upper"))
    tool = by_name(
        arguments={"x": number("pose.x"), "y": number("pose.y")},
        fixed={"params.speed_mm_s": 500, "pose.map": "upper"},
    )
    assert load({"go": tool}, two)
