# SPDX-License-Identifier: Apache-2.0
"""What is authorized is what runs: equal scopes are equal calls, and every call reads back."""

from __future__ import annotations

import json
from decimal import Decimal
from fractions import Fraction
from functools import cache
from typing import Any

import msgspec
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from authguard_r.authoring.binding.samples import Sampler, probe_site
from authguard_r.core.action import Action, ActionMeta, scope_of
from authguard_r.core.encoding import Tag, digest_of
from authguard_r.core.errors import MalformedError
from authguard_r.core.provenance import Label
from authguard_r.core.reasons import Reason
from authguard_r.normalize.bind import Binder
from authguard_r.normalize.binding import Argument, ArgumentUse, Binding, ToolWay, ways
from authguard_r.normalize.dialects import Call
from authguard_r.normalize.quantity import scale, unscale
from authguard_r.normalize.rebuild import Rebuilder, call_bytes
from authguard_r.normalize.shipped import binding_source, shipped_names
from authguard_r.site.model import Parameter, Rounding, Site
from authguard_r.site.source import convert
from authguard_r.site.words import standard_words
from fixtures import scenarios
from fixtures.amount import amount
from fixtures.cases import case
from unit.normalize.bound import (
    GO_BY_STOPS,
    GO_TO_POSE,
    HELD,
    NOTED,
    POSE,
    WAIT,
    Plain,
    fixed,
    load,
    mapped,
    number,
    rebuilt,
    site,
    square,
    wait,
)

GO = Action(type="navigate", tool="base", destination="square-2", params={"speed_mm_s": 500})
PAUSE = Action(type="wait", tool="base", params={"duration_ms": 1500})
#: What the middle of the second square is, as the executor of a stamped pose reads it.
SECOND: Plain = {
    "header": {"frame_id": "map"},
    "pose": {"position": {"x": 4, "y": 1, "z": 0}, "orientation": {"w": 1}},
}


def cannot(tool: Any, action: Action, where: Site | None = None) -> None:
    """Assert that no way of the tool carries the action."""
    with pytest.raises(MalformedError) as caught:
        rebuilt(tool, action, where)
    assert (caught.value.reason, caught.value.where) == (Reason.TOOL_UNKNOWN, "action.tool")


def scope(action: Action) -> str:
    return digest_of(Tag.SCOPE, scope_of(action))


# -- what is dispatched ----------------------------------------------------------------------------


def test_a_region_is_dispatched_as_its_own_halting_place() -> None:
    assert rebuilt(GO_TO_POSE, GO) == {"goal": SECOND, "behavior_tree": ""}


def test_stops_are_dispatched_in_order_the_destination_last() -> None:
    through = msgspec.structs.replace(GO, route=("square-1", "square-2"))
    poses = rebuilt(GO_BY_STOPS, through)["poses"]
    assert [pose["pose"]["position"]["x"] for pose in poses] == [1, 4, 4]
    assert rebuilt(GO_BY_STOPS, GO) == {"poses": [SECOND]}


def test_names_are_dispatched_in_their_first_spelling_and_an_unnamed_one_by_its_id() -> None:
    each = {"name": mapped("region"), "kind": fixed("room")}
    tool = {
        **GO_TO_POSE,
        "arguments": {"to": mapped("destination"), "via": mapped("route", each=each)},
    }
    bare = site(cellar=square(0, 9000))
    action = msgspec.structs.replace(GO, destination="cellar", route=("square-1",))
    assert rebuilt(tool, action, bare) == {
        "to": "cellar",
        "via": [{"name": "Square 1", "kind": "room"}],
    }
    plain = {**tool, "arguments": {"to": mapped("destination"), "via": mapped("route")}}
    assert rebuilt(plain, action, bare)["via"] == ["Square 1"]


def test_constants_words_and_items_of_lists_are_filled_in() -> None:
    tool = {
        "type": "fill",
        "tool": "hand",
        "when": {"verb": "fill", "options.0": True},
        "arguments": {
            "things.0": mapped("object"),
            "from": mapped("source"),
            "liquid": mapped("params.liquid_no", values={"water": 1, "aqua": 1, "oil": 2}),
            "share": {"use": "fixed", "decimal": "0.5", "optional": True},
            "reason": NOTED,
            "rate": {"use": "noted", "value": 3},
            "deep.er.still": fixed(value=False),
        },
    }
    action = Action(
        type="fill", tool="hand", object="thing-2", source="square-1", params={"liquid_no": 1}
    )
    assert rebuilt(tool, action) == {
        "verb": "fill",
        "options": [True],
        "things": ["Thing 2"],
        "from": "Square 1",
        "liquid": "water",
        "share": Decimal("0.5"),
        "rate": 3,
        "deep": {"er": {"still": False}},
    }
    cannot(tool, msgspec.structs.replace(action, params={"liquid_no": 3}))


def test_the_bytes_of_a_call_are_canonical_and_its_numbers_exact() -> None:
    arguments = {"b": Decimal("0.1"), "a": [1, {"d": True, "c": "\u00fc"}]}
    expected = '{"arguments":{"a":[1,{"c":"\u00fc","d":true}],"b":0.1},"tool":"go"}'
    assert call_bytes(Call("go", arguments, "anywhere")) == expected.encode()
    assert call_bytes(Call("go", arguments, "elsewhere")) == expected.encode()


def test_a_map_that_configuration_fixes_is_not_written() -> None:
    two = site(attic=square(0, frame="upper"))
    by_numbers = {"x": number("pose.x"), "y": number("pose.y")}
    tool = {**GO_TO_POSE, "arguments": by_numbers, "fixed": {**HELD["fixed"], "pose.map": "upper"}}
    attic = msgspec.structs.replace(GO, destination="attic")
    assert rebuilt(tool, attic, two) == {"x": 1, "y": 1}
    cannot(tool, GO, two)  # the second square is on another map


# -- what cannot be carried is not dropped ---------------------------------------------------------


def test_an_action_that_the_tool_cannot_say_as_it_is_is_refused() -> None:
    for tool, action in [
        (GO_TO_POSE, msgspec.structs.replace(GO, route=("square-1",))),
        (GO_TO_POSE, msgspec.structs.replace(GO, params={"speed_mm_s": 501})),
        (GO_TO_POSE, msgspec.structs.replace(GO, params={})),
        (GO_TO_POSE, msgspec.structs.replace(GO, object="thing-1")),
        (GO_TO_POSE, msgspec.structs.replace(GO, tool="legs")),
        (GO_TO_POSE, msgspec.structs.replace(GO, destination=None)),
        (GO_TO_POSE, msgspec.structs.replace(GO, destination="nowhere")),
        (GO_BY_STOPS, msgspec.structs.replace(GO, destination=None)),
        (wait(), GO),
        (wait(), Action(type="wait", tool="base")),
        (wait(optional=True, default=1000), Action(type="wait", tool="base")),
        (wait(whole=True), PAUSE),
        (wait(values={"long": 60_000}, per_unit="1"), PAUSE),
        ({**WAIT, "fixed": {"params.duration_ms": 1000}}, PAUSE),
    ]:
        with case(tool, action):
            cannot(tool, action)


def test_a_region_that_no_position_means_alone_is_not_dispatched_as_one() -> None:
    inner = site(alcove=square(3500, 500, side=1000))
    cannot(GO_TO_POSE, GO, inner)
    cannot(GO_BY_STOPS, GO, inner)
    within = site(alcove=square(3500, 500, side=1000, within="square-2"))
    cannot(GO_TO_POSE, GO, within)  # its halting place means the alcove
    alcove = msgspec.structs.replace(GO, destination="alcove")
    assert rebuilt(GO_TO_POSE, alcove, within)["goal"] == SECOND
    by_name = {**GO_TO_POSE, "arguments": {"to": mapped("destination")}}
    assert rebuilt(by_name, GO, inner) == {"to": "Square 2"}


def test_what_the_planner_may_leave_out_is_left_out_when_the_action_has_none() -> None:
    tool = {
        **GO_TO_POSE,
        "arguments": {"to": mapped("destination"), "via": mapped("route", optional=True)},
    }
    assert rebuilt(tool, GO) == {"to": "Square 2"}
    needed = {**tool, "arguments": {"to": mapped("destination"), "via": mapped("route")}}
    cannot(needed, GO)


def test_what_state_attests_is_no_part_of_the_call() -> None:
    arrived = msgspec.structs.replace(GO, source="square-1")
    assert rebuilt(GO_TO_POSE, arrived) == rebuilt(GO_TO_POSE, GO)


# -- one effect, one call --------------------------------------------------------------------------

TOOLS: Plain = {
    "to_pose": GO_TO_POSE,
    "by_stops": GO_BY_STOPS,
    "by_name": {**GO_TO_POSE, "arguments": {"to": mapped("destination"), "why": NOTED}},
}


def test_whichever_tool_the_planner_used_one_effect_is_one_call() -> None:
    place = site()
    binding = load(TOOLS, place)
    rebuilder = Rebuilder(place, binding)
    assert rebuilder.rebuild(GO).tool == "by_name"
    through = msgspec.structs.replace(GO, route=("square-1",))
    assert rebuilder.rebuild(through).tool == "by_stops"
    turned = load(dict(reversed(TOOLS.items())), place)
    assert call_bytes(Rebuilder(place, turned).rebuild(GO)) == call_bytes(rebuilder.rebuild(GO))
    assert rebuilder.rebuild(GO, tool="to_pose").arguments["goal"] == SECOND
    with pytest.raises(MalformedError):
        rebuilder.rebuild(GO, tool="to_")


def test_who_proposed_it_and_why_changes_nothing_that_is_dispatched() -> None:
    meta = ActionMeta(planner="p", timestamp="2026-01-01T00:00:00Z", evidence="A" * 43)
    told = msgspec.structs.replace(GO, meta=meta, provenance={"destination": Label.CAMERA})
    place = site()
    rebuilder = Rebuilder(place, load(TOOLS, place))
    assert scope(told) == scope(GO)
    assert call_bytes(rebuilder.rebuild(told)) == call_bytes(rebuilder.rebuild(GO))


def test_calls_of_one_meaning_are_dispatched_as_the_same_bytes() -> None:
    """Spelling, digits, order, defaults, notes and the spot within a room all fall away."""
    binder = Binder(scenarios.site(), scenarios.binding())
    rebuilder = Rebuilder(scenarios.site(), scenarios.binding())
    same = [
        {"destination": "Station 101"},
        {"destination": "station-101", "speed": Decimal("0.5")},
        {"reason": "a voice said so", "speed": Decimal("0.50"), "destination": "Room 101"},
        {"destination": "Nurse Station 101", "speed": Decimal("0.4999"), "via": []},
    ]
    found = {
        call_bytes(rebuilder.rebuild(binder.bind(Call("navigate_to", arguments, "x"))))
        for arguments in same
    }
    assert [json.loads(one)["arguments"] for one in found] == [
        {"destination": "Station 101", "speed": 0.5}
    ]


@settings(max_examples=amount(30, 150))
@given(
    st.sampled_from(sorted(scenarios.site().regions)),
    st.lists(st.sampled_from(sorted(scenarios.site().regions)), max_size=3),
    st.integers(1, 3000),
)
def test_binding_a_rebuilt_call_gives_the_same_action(
    destination: str, route: list[str], speed: int
) -> None:
    action = Action(
        type="navigate",
        tool="base",
        destination=destination,
        route=tuple(route),
        params={"speed_mm_s": speed},
    )
    rebuilder = Rebuilder(scenarios.site(), scenarios.binding())
    call = rebuilder.rebuild(action)
    assert Binder(scenarios.site(), scenarios.binding()).bind(call) == action
    assert json.loads(call_bytes(call))["arguments"]["speed"] == speed / 1000


@settings(max_examples=amount(25, 100))
@given(st.integers(-100, 6100), st.integers(0, 2000), st.integers(-100, 6100), st.integers(0, 2000))
def test_two_positions_are_one_call_exactly_when_they_are_one_action(
    x: int, y: int, u: int, v: int
) -> None:
    place = site(wing=square(0, 2000))
    binding = load({"go": GO_TO_POSE}, place)
    binder, rebuilder = Binder(place, binding), Rebuilder(place, binding)
    calls = []
    for one, two in ((x, y), (u, v)):
        position = {"x": Decimal(one) / 1000, "y": Decimal(two) / 1000}
        goal = {"header": {"frame_id": "map"}, "pose": {"position": position}}
        try:
            calls.append(binder.bind(Call("go", {"goal": goal}, "x")))
        except MalformedError:
            assume(False)
    first, second = calls
    dispatched = call_bytes(rebuilder.rebuild(first)), call_bytes(rebuilder.rebuild(second))
    assert (scope(first) == scope(second)) == (dispatched[0] == dispatched[1])


# -- numbers ---------------------------------------------------------------------------------------

factors = st.fractions(Fraction(1, 1000), 10**6, max_denominator=1000).map(str) | st.sampled_from(
    ["17453.292519943296", "447.04", "3785.411784", "1/3", "0.001", "1000000"]
)


@settings(max_examples=amount(80, 400))
@given(
    st.integers(-(10**9), 10**9), factors, st.sampled_from(Rounding), st.integers(-300_000, 300_000)
)
def test_a_number_that_the_tool_is_given_is_read_as_the_authorized_one(
    value: int, per_unit: str, rounding: Rounding, offset: int
) -> None:
    parameter = Parameter(unit="mm", low=-(10**10), high=10**10, rounding=rounding, required=True)
    argument = Argument(use=ArgumentUse.MAPPED, to="params.x", per_unit=per_unit, offset=offset)
    found = unscale(value, argument, parameter)
    factor = Fraction(per_unit)
    if found is None:
        assert (value - offset) * factor.denominator % factor.numerator != 0
        return
    assert scale(found, parameter, per_unit=factor, where="x", offset=offset) == value
    assert abs(Fraction(found) * factor) <= abs(value - offset)


def test_a_decimal_is_exact_where_it_can_be_and_cut_toward_zero_where_it_cannot() -> None:
    limit = Parameter(unit="x", low=-(10**9), high=10**9, rounding=Rounding.LIMIT, required=True)

    def number_of(value: int, per_unit: str, **more: Any) -> Any:
        return unscale(value, Argument(use=ArgumentUse.MAPPED, per_unit=per_unit, **more), limit)

    assert number_of(1500, "1000") == Decimal("1.5")
    assert number_of(-1500, "1000") == Decimal("-1.5")
    assert number_of(2000, "1000") == 2
    assert number_of(-1, "8") == Decimal("-0.125")
    third = number_of(1, "3")
    assert third == Decimal("0.3333")
    assert number_of(-1, "3") == -third
    assert number_of(1500, "1000", whole=True) is None
    count = msgspec.structs.replace(limit, rounding=Rounding.COUNT)
    assert unscale(1, Argument(use=ArgumentUse.MAPPED, per_unit="3"), count) is None
    assert unscale(3, Argument(use=ArgumentUse.MAPPED, per_unit="3"), count) == 1


# -- the shipped ones ------------------------------------------------------------------------------


def shipped(name: str) -> tuple[Binding, Site]:
    binding = convert(binding_source(name), Binding, where=name)
    return binding, probe_site(binding, standard_words())


def test_every_way_of_a_shipped_binding_binds_rebuilds_and_binds_again() -> None:
    """A sample call for each way; what writes state is refused however it is asked for."""
    for name in shipped_names():
        with case(name):
            binding, place = shipped(name)
            binder, rebuilder = Binder(place, binding), Rebuilder(place, binding)
            done = 0
            for way in ways(binding):
                call = Sampler(place).call(way)
                assert call is not None
                if place.vocabulary[way.tool.type].state_writing:
                    with pytest.raises(MalformedError) as caught:
                        binder.bind(call)
                    assert caught.value.reason is Reason.STATE_WRITING_REFUSED
                    continue
                action = binder.bind(call)
                for tool in (None, way.name):
                    again = binder.bind(rebuilder.rebuild(action, tool=tool))
                    assert scope(again) == scope(action), way.place
                done += 1
            assert done > 0


@cache
def machinery(name: str) -> tuple[Site, tuple[ToolWay, ...], Binder, Rebuilder, Sampler]:
    binding, place = shipped(name)
    every = ways(binding)
    return place, every, Binder(place, binding), Rebuilder(place, binding), Sampler(place)


anything = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-10, 10**7)
    | st.decimals(-100, 100, places=3)
    | st.sampled_from(["", "Square 1", "square-2", "Thing 2", "map", "/cmd_vel", "x"]),
    lambda inner: (
        st.lists(inner, max_size=2)
        | st.dictionaries(st.sampled_from(["x", "y", "pose", "header", "0"]), inner, max_size=2)
    ),
    max_leaves=4,
)


@pytest.mark.complete
@pytest.mark.parametrize("name", shipped_names())
@settings(max_examples=amount(25, 60))
@given(data=st.data())
def test_however_a_call_is_changed_equal_scopes_are_equal_bytes(
    name: str, data: st.DataObject
) -> None:
    """Two calls of any two ways, with arbitrary values in their places: one law, no exception."""
    _, every, binder, rebuilder, sampler = machinery(name)
    found: list[tuple[str, bytes]] = []
    places: list[str] = []
    for way in data.draw(st.lists(st.sampled_from(every), min_size=2, max_size=2)):
        call = sampler.call(way)
        assert call is not None
        paths = [*way.tool.arguments, *way.tool.when]
        names = data.draw(st.lists(st.sampled_from([*paths, "z"]), max_size=3))
        arguments: Any = call.arguments
        for path in names:
            arguments = with_value(arguments, path.split("."), data.draw(anything))
        try:
            action = binder.bind(Call(way.name, arguments, "input"))
        except MalformedError as error:
            places.append(error.where)
            continue
        dispatched = rebuilder.rebuild(action)
        assert scope(binder.bind(dispatched)) == scope(action)
        found.append((scope(action), call_bytes(dispatched)))
    assert all(place.startswith("input") for place in places)
    assert len({one for one, _ in found}) == len({two for _, two in found})


def with_value(node: Any, names: list[str], value: Any) -> Any:
    """Return a copy of nested arguments with one value set, where there is a place for it."""
    if not names:
        return value
    if isinstance(node, list):
        return [
            with_value(item, names[1:], value) if str(number) == names[0] else item
            for number, item in enumerate(node)
        ]
    kept = node if isinstance(node, dict) else {}
    return {**kept, names[0]: with_value(kept.get(names[0]), names[1:], value)}


def test_the_pose_of_the_language_is_the_pose_of_nav2() -> None:
    binding, place = shipped("nav2")
    call = Rebuilder(place, binding).rebuild(GO)
    assert call.arguments["action_type"] == "nav2_msgs/action/NavigateToPose"
    assert call.arguments["args"] == {"pose": SECOND, "behavior_tree": ""}
    assert set(POSE) <= {
        path.removeprefix("args.pose.") for path in ways(binding)[0].tool.arguments
    }
