# SPDX-License-Identifier: Apache-2.0
"""The checker finds what is wrong, names ways that meet, and makes samples that are valid."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from authguard_r.authoring.binding.check import check_binding
from authguard_r.authoring.binding.samples import Sampler, probe_site
from authguard_r.core.errors import MalformedError
from authguard_r.normalize.binding import Binding, ToolBinding, effect_of, require_sound, ways
from authguard_r.normalize.expected import TEXT
from authguard_r.normalize.shipped import binding_source, shipped_names
from authguard_r.site.model import Parameter, Profile, Robot, Rounding, Site
from authguard_r.site.source import convert
from authguard_r.site.words import standard_words
from fixtures import scenarios
from unit.normalize.bound import (
    GO_BY_STOPS,
    GO_TO_POSE,
    NOTED,
    WAIT,
    Plain,
    faults,
    fixed,
    load,
    mapped,
    number,
    report,
    site,
    square,
    unchecked,
    wait,
)

# -- what is found ---------------------------------------------------------------------------------


@pytest.mark.parametrize("name", shipped_names())
def test_a_shipped_binding_has_no_fault(name: str) -> None:
    binding = convert(binding_source(name), Binding, where=name)
    found = check_binding(binding, probe_site(binding, standard_words()))
    assert (found.faults, found.unproven, found.binding) == ((), (), name)
    assert (found.interface, found.unmapped, found.uncompared) == (None, None, None)
    assert found.ways >= found.tools > 0


def test_the_hospital_s_binding_has_no_fault_at_its_site_and_with_the_standard_words() -> None:
    for place in (scenarios.site(), probe_site(scenarios.binding(), standard_words())):
        found = check_binding(scenarios.binding(), place)
        assert found.faults == ()
        assert found.fields == {"mapped": 11, "fixed": 0, "refused": 1, "noted": 7}


def test_every_fault_of_a_binding_is_named_not_only_the_first() -> None:
    tools = {
        "one": {**WAIT, "arguments": {"a": {"use": "fixed"}, "b": {**NOTED, "decimal": "1"}}},
        "two": {"type": "fly", "tool": "wings"},
        "g\u00f6": WAIT,
    }
    binding = msgspec.structs.replace(unchecked(tools), site="elsewhere")
    found = check_binding(binding, site())
    assert faults(found) == [
        "site",
        "tools.one.arguments.a.value",
        "tools.one.arguments.b.decimal",
        "tools.one.arguments",
        "tools.two.type",
        "tools.'g\\xf6'",
    ]
    with pytest.raises(MalformedError):
        require_sound(binding, site())


def test_a_position_that_no_frame_holds_is_found_where_maps_lie_over_each_other() -> None:
    """What the executor would resolve in its own frame, we would guess."""
    tool = {**GO_TO_POSE, "arguments": {"x": number("pose.x"), "y": number("pose.y")}}
    assert report({"go": tool}).faults == ()
    two = site(attic=square(0, frame="upper"))
    (fault,) = report({"go": tool}, two).faults
    assert fault.where == "tools.go"
    assert "attic, square-1" in fault.message


def test_a_number_that_cannot_be_given_back_is_found() -> None:
    """A tool that carries a level to a room reads what no other call of it says."""
    words = standard_words()
    step = Parameter(unit="count", low=1, high=9, rounding=Rounding.COUNT, required=True)
    kind = msgspec.structs.replace(words["lamp"], params={"lamp_no": step})
    place = msgspec.structs.replace(site(), vocabulary={**words, "lamp": kind})
    tool = {
        "type": "lamp",
        "tool": "lamp",
        "arguments": {
            "no": mapped("params.lamp_no", optional=True),
            "all": {"use": "noted", "value": 1},
        },
    }
    assert faults(report({"go": tool}, place)) == []


@pytest.mark.parametrize(
    "tool",
    [
        GO_TO_POSE,
        GO_BY_STOPS,
        {"type": "describe", "tool": "x", "arguments": {"name": mapped("object")}},
    ],
)
def test_a_way_of_which_the_site_has_no_example_is_unproven_and_that_is_a_fault(
    tool: Plain,
) -> None:
    """What no sample shows is not shown: the check says so instead of passing."""
    empty = msgspec.structs.replace(site(), regions={}, objects={})
    assert Sampler(empty).call(ways(unchecked({"go": tool}))[0]) is None
    found = report({"go": tool, "stay": wait()}, empty)
    assert (found.unproven, faults(found)) == (("tools.go",), ["tools.go"])
    assert "check it without `--site`" in found.faults[0].message
    assert report({"go": tool, "stay": wait()}).unproven == ()


# -- samples ---------------------------------------------------------------------------------------


def sample(tool: Plain, where: Site | None = None) -> Plain:
    call = Sampler(where or site()).call(ways(load({"go": tool}, where))[0])
    assert call is not None
    return call.arguments


def test_a_sample_says_what_must_be_said_and_nothing_noted() -> None:
    pose = {"header": {"frame_id": "map"}, "pose": {"position": {"x": 1, "y": 1, "z": 0}}}
    assert sample(GO_TO_POSE) == {"goal": pose, "behavior_tree": ""}
    assert sample(GO_BY_STOPS) == {"poses": [pose]}
    assert sample({**wait(), "when": {"mode.0": 2}}) == {"seconds": 1, "mode": [2]}
    assert sample(wait(values={"b": 2, "a": 1}, per_unit="1")) == {"seconds": "b"}
    each = {"name": mapped("region"), "kind": fixed("room"), "why": NOTED}
    by_name = {**GO_TO_POSE, "arguments": {"to": mapped("stops", each=each)}}
    assert sample(by_name) == {"to": [{"name": "Square 1", "kind": "room"}]}


def test_a_sample_position_means_one_region() -> None:
    inner = site(alcove=square(500, 500, side=1000))
    assert sample(GO_TO_POSE, inner)["goal"]["pose"]["position"]["x"] == 4


def test_a_sample_number_lies_in_the_type_s_range() -> None:
    """Whole where it can be; else the range's own ends."""
    assert sample(wait(per_unit="0.001")) == {"seconds": 1001}
    assert sample(wait(per_unit="100000000000")) != {}
    narrow = msgspec.structs.replace(
        standard_words()["wait"].params["duration_ms"], low=250, high=300
    )
    words = standard_words()
    kind = msgspec.structs.replace(words["wait"], params={"duration_ms": narrow})
    place = msgspec.structs.replace(site(), vocabulary={**words, "wait": kind})
    assert 0.25 <= float(sample(wait(), place)["seconds"]) <= 0.3


# -- ways to one effect ----------------------------------------------------------------------------


def brake(**more: Any) -> Plain:
    return {"type": "brake", "tool": "car", **more}


def test_ways_that_can_be_one_action_are_named_together() -> None:
    level = {"arguments": {"level": mapped("params.level_permille", per_unit="1000")}}
    words = {
        "arguments": {"how": mapped("params.level_permille", values={"half": 500, "full": 1000})}
    }
    tools = {
        "press": brake(**level),
        "release": brake(fixed={"params.level_permille": 0}),
        "stamp": brake(fixed={"params.level_permille": 1000}),
        "say": brake(**words),
        "hold": {"type": "hold", "tool": "car"},
        "other": brake(tool="rover", **level),
        "pose": {"type": "set_pose", "tool": "car"},
        "pose_again": {"type": "set_pose", "tool": "car"},
        "unknown": {"type": "fly", "tool": "car"},
    }
    groups = report(tools).groups
    assert groups == {"brake by car": ("tools.press", "tools.release", "tools.stamp", "tools.say")}
    alone = {name: tools[name] for name in ("release", "say")}
    assert report(alone).groups == {}


def test_ways_of_which_one_always_says_more_never_meet() -> None:
    survey = {
        "type": "survey",
        "tool": "m",
        "attested": ["source"],
        "fixed": {"params.max_bytes": 1},
    }
    tools = {
        "map": {**survey, "arguments": {"to": mapped("destination")}},
        "explore": {
            **survey,
            "arguments": {"to": mapped("destination"), "r": mapped("params.radius_mm")},
        },
        "stops": {**GO_BY_STOPS},
        "pose": {**GO_TO_POSE},
    }
    assert report(tools).groups == {
        "navigate by base params.speed_mm_s=500": ("tools.stops", "tools.pose")
    }
    tools["explore"]["arguments"]["r"]["optional"] = True
    assert ("tools.map", "tools.explore") in report(tools).groups.values()


TWIST: Plain = {
    "type": "drive",
    "tool": "base",
    "attested": ["source"],
    "fixed": {"params.duration_ms": 500},
    "arguments": {
        "x": mapped("params.linear_mm_s"),
        "y": mapped("params.lateral_mm_s"),
        "z": mapped("params.turn_urad_s"),
    },
}


@pytest.mark.parametrize(
    "effects",
    [
        ({"effect": "/cmd_vel"}, {"effect": "/cmd_vel"}),
        ({"effect": "cmd_vel"}, {"effect": "/cmd_vel/"}),
        ({"effect": "/cmd_vel"}, {"when": {"topic": "/cmd_vel", "type": "TwistStamped"}}),
        (
            {"when": {"topic": "/cmd_vel", "type": "Twist"}},
            {"when": {"topic": "/cmd_vel", "type": "TwistStamped"}},
        ),
        ({"when": {"service_name": "/go"}}, {"when": {"service": "/go", "service_type": "Go"}}),
    ],
)
def test_ways_to_one_effect_have_one_type_and_one_tool(effects: tuple[Plain, Plain]) -> None:
    """A grant of one way says nothing of the wheels while another way moves them (L1)."""
    one, two = ({**TWIST, **effect} for effect in effects)
    found = report({"go": one, "stamped": two})
    assert found.faults == ()
    assert found.groups == {"drive by base params.duration_ms=500": ("tools.go", "tools.stamped")}
    for apart in ({"tool": "other"}, {"type": "turn"}):
        (fault,) = [
            fault
            for fault in report({"go": one, "stamped": {**two, **apart}}).faults
            if fault.where == "tools.stamped.effect"
        ]
        assert fault.message.startswith("expected `drive` by `base` as `tools.go` moves `")
        with pytest.raises(MalformedError):
            load({"go": one, "stamped": {**two, "tool": "other"}})


def test_different_effects_and_calls_that_are_always_refused_need_not_meet() -> None:
    pose = {"type": "set_pose", "tool": "none", "effect": "/cmd_vel"}
    one = {**TWIST, "effect": "/cmd_vel"}
    other = {**TWIST, "tool": "other"}
    assert report({"go": one, "pose": pose, "free": other}).faults == ()
    assert report({"go": one, "far": {**other, "effect": "/far/cmd_vel"}}).faults == ()
    commands = [
        {**TWIST, "tool": tool, "when": {"topic": "/command", "data": tool}} for tool in "ab"
    ]
    assert report({"go": commands}).faults == ()
    plain = {**TWIST, "tool": "c", "when": {"topic": "/command"}}
    assert faults(report({"go": commands, "any": plain})) == ["tools.any.effect"]
    declared = [{**way, "effect": "command"} for way in commands]
    assert faults(report({"go": declared})) == ["tools.go[1].effect"]


def test_an_effect_is_what_is_declared_or_else_the_constant_name() -> None:
    def effect(**more: Any) -> str:
        return effect_of(convert({**TWIST, **more}, ToolBinding, where="way"))

    named = {"when": {"topic": "/cmd_vel", "type": "Twist"}}
    assert effect() == effect(when={"topic": 1}) == ""
    assert effect(**named) == "cmd_vel"
    assert effect(**named, effect="wheels") == "wheels"
    assert effect(arguments={"action_name": fixed("/spin")}) == "spin"
    assert effect(arguments={"action_name": mapped("object")}) == ""


@pytest.mark.parametrize("name", ["cmd-vel", "ros-mcp"])
def test_a_shipped_twist_bound_to_another_tool_than_its_stamped_form_is_found(name: str) -> None:
    plain: Any = binding_source(name)
    (stamped,) = [
        way
        for way in plain["tools"]["publish" if name == "cmd-vel" else "publish_once"]
        if "geometry_msgs/msg/TwistStamped" in way["when"].values()
    ]
    assert stamped["tool"] == "base"
    stamped["tool"] = "base-stamped"
    binding = convert(plain, Binding, where=name)
    found = check_binding(binding, probe_site(binding, standard_words()))
    assert [fault.where.rpartition(".")[2] for fault in found.faults] == ["effect"]


def test_a_name_of_an_effect_is_ascii() -> None:
    assert faults(report({"go": {**TWIST, "effect": "/\u0441md_vel"}})) == ["tools.'go'"]


# -- what a controller settles ---------------------------------------------------------------------


def staffed(tools: dict[str, list[str]], controllers: dict[str, str]) -> Site:
    profile = {
        "tools": tools,
        "max_speed_mm_s": 1,
        "max_force_mn": 1,
        "max_payload_g": 1,
        "controllers": controllers,
    }
    robot = Robot(profile=convert(profile, Profile, where="profile"), home="square-1")
    return msgspec.structs.replace(site(), robots={"robot-1": robot})


def test_a_fixed_value_hangs_on_the_signed_digest_of_its_controller() -> None:
    """Every robot that has the tool has the controller in its profile, or the way is unsound."""
    way = {**TWIST, "controller": "watchdog"}
    able, digest = {"drive": ["base"]}, {"watchdog": "A" * 43}
    assert report({"go": way}, staffed(able, digest)).faults == ()
    assert report({"go": way}).faults == ()
    assert report({"go": way}, staffed({"drive": ["other"], "walk": ["base"]}, {})).faults == ()
    for controllers in ({}, {"nav2": "A" * 43}):
        (fault,) = report({"go": way}, staffed(able, controllers)).faults
        assert fault.where == "tools.go.controller"
        assert fault.message == "expected a controller in the profile of `robot-1`, got `watchdog`"
        with pytest.raises(MalformedError):
            load({"go": way}, staffed(able, controllers))


def test_a_controller_that_settles_nothing_is_found() -> None:
    (fault,) = report({"go": {**wait(), "controller": "watchdog"}}).faults
    assert fault.where == "tools.go.controller"
    assert "under `fixed`" in fault.message


# -- what nobody asks ------------------------------------------------------------------------------

MOVES = {**GO_TO_POSE, "arguments": {"place": mapped("destination")}}
LOOKS = {"type": "scan_obstacles", "tool": "lidar"}


@pytest.mark.parametrize(
    ("looks_at", "assumed"),
    [
        ({}, ("tools.go",)),
        ({"succeeds": {"status": "arrived"}}, ()),
        ({"fails": {TEXT: {"contains": "not armed"}}}, ()),
    ],
    ids=["neither", "succeeds", "fails"],
)
def test_a_tool_that_moves_the_robot_and_whose_answer_nobody_looks_into_is_named(
    looks_at: Plain, assumed: tuple[str, ...]
) -> None:
    """A failure in an answer without an error would count as success (lesson L29)."""
    found = report({"go": {**MOVES, **looks_at}})
    assert (found.assumed, faults(found)) == (assumed, [])


def test_a_tool_that_moves_nothing_needs_no_look_into_its_answer() -> None:
    assert report({"look": LOOKS}).assumed == ()
