# SPDX-License-Identifier: Apache-2.0
"""Whatever a binding says is checked; what a sound one binds is dispatched as authorized."""

from __future__ import annotations

from typing import Any

from hypothesis import assume, given, settings
from hypothesis import strategies as st

from authguard_r.authoring.binding.check import check_binding
from authguard_r.authoring.binding.samples import Sampler
from authguard_r.core.errors import MalformedError
from authguard_r.normalize.bind import Binder
from authguard_r.normalize.binding import binding_faults, ways
from authguard_r.normalize.dialects import Call
from authguard_r.normalize.interface import read_interface
from authguard_r.normalize.rebuild import Rebuilder
from authguard_r.site.words import standard_words
from fixtures.amount import amount
from unit.normalize.bound import (
    NOTED,
    REFUSED,
    Plain,
    fixed,
    mapped,
    number,
    site,
    unchecked,
)

targets = st.sampled_from(
    [
        "object",
        "source",
        "destination",
        "route",
        "stops",
        "region",
        "pose.x",
        "pose.y",
        "pose.map",
        "pose.z",
        "params.speed_mm_s",
        "params.duration_ms",
        "params.",
        "tool",
        "",
    ]
)
constants = st.sampled_from([None, 0, 1, -5, True, False, "", "map", "x"])
names = st.sampled_from(["a", "b", "a.b", "a.0", "a.1", "1", "", "b..", "0.a", "c.d.e"])
arguments = st.fixed_dictionaries(
    {"use": st.sampled_from(["mapped", "mapped", "fixed", "noted", "refused"])},
    optional={
        "to": targets,
        "per_unit": st.sampled_from(["1", "1000", "1/3", "0.001", "0", "x"]),
        "offset": st.sampled_from([0, 7, -7]),
        "whole": st.booleans(),
        "optional": st.booleans(),
        "default": st.sampled_from([1, 500, -1]),
        "value": constants.filter(lambda value: value is not None),
        "decimal": st.sampled_from(["0.5", "1", "-0.25"]),
        "values": st.dictionaries(st.sampled_from(["x", "y"]), st.integers(0, 600), max_size=2),
        "also": st.lists(st.sampled_from(["1", "a", "z"]), max_size=1),
    },
)
items = st.dictionaries(names, arguments, max_size=3)
tools = st.fixed_dictionaries(
    {
        "type": st.sampled_from(["navigate", "wait", "pick", "describe", "set_pose", "survey"]),
        "tool": st.just("base"),
    },
    optional={
        "arguments": st.dictionaries(
            names,
            st.builds(
                lambda one, each: {**one, "each": each} if each else one,
                arguments,
                st.just({}) | items,
            ),
            max_size=4,
        ),
        "fixed": st.dictionaries(
            targets, st.sampled_from([1, 500, "square-1", "thing-1", "map"]), max_size=3
        ),
        "monitored": st.lists(targets, max_size=1),
        "attested": st.just(["source"]),
        "when": st.dictionaries(names, constants.filter(lambda v: v is not None), max_size=2),
        "body": st.sampled_from(["a", "c"]),
        "effect": st.sampled_from(["/a", "a", "b"]),
        "controller": st.just("c"),
        "message": st.just("my_msgs/msg/Go"),
    },
)
SURFACES = (
    *read_interface('[{"name": "go", "args": [{"name": "a"}]}]', name="tools.json"),
    *read_interface("int32 b\n", name="Go.msg"),
)


@settings(max_examples=amount(60, 300))
@given(tools | st.lists(tools, min_size=1, max_size=2))
def test_any_binding_is_checked_and_a_sound_one_keeps_its_law(tool: Any) -> None:
    """No fault of a binding escapes as an exception; without one, samples bind and rebuild."""
    binding = unchecked({"go": tool})
    place = site()
    found = check_binding(binding, place, interface=SURFACES)
    assert all(fault.where.isascii() and fault.message for fault in found.faults)
    if not any(binding_faults(binding, place)):
        Binder(place, binding)
        for way in ways(binding):
            Sampler(place).call(way)


#: Paths of which none lies within another.
PATHS = ("a", "b", "c.d", "c.e.f", "g.0", "h.0.i", "1", "j")
extras = st.sampled_from([NOTED, REFUSED, {"use": "noted", "value": 1}, fixed(0), fixed("x")])
rows = st.fixed_dictionaries({"name": st.just(mapped("region"))}, optional={"kind": extras})
amounts = st.fixed_dictionaries(
    {"use": st.just("mapped"), "per_unit": st.sampled_from(["1", "1000", "1/3", "3", "0.001"])},
    optional={
        "whole": st.booleans(),
        "optional": st.booleans(),
        "default": st.sampled_from([1, 500]),
        "offset": st.sampled_from([0, 7, -7]),
        "also": st.just(["2"]),
    },
)


@st.composite
def likely(draw: st.DrawFn) -> Plain:
    """Return a tool whose every field has an origin, drawn among all that the language knows."""
    kind = draw(st.sampled_from(["navigate", "wait", "pick", "describe", "survey", "plan_path"]))
    model = standard_words()[kind]
    filled: list[Plain] = []
    settled: Plain = {}
    for field in model.fields:
        if field == "object" or (field == "route" and draw(st.booleans())):
            filled.append(mapped(field, optional=field == "route"))
        elif field == "destination":
            if "route" in model.fields and not any(f["to"] == "route" for f in filled):
                choice = draw(st.sampled_from(["name", "pose", "stops"]))
            else:
                choice = draw(st.sampled_from(["name", "pose"]))
            if choice == "name":
                filled.append(mapped("destination"))
            elif choice == "stops":
                filled.append(mapped("stops", each=draw(rows)))
            else:
                filled += [number("pose.x"), number("pose.y"), mapped("pose.map")]
    if any(f["to"] == "stops" for f in filled):
        filled = [f for f in filled if f["to"] != "route"]
    for name, parameter in model.params.items():
        if draw(st.booleans()):
            settled[f"params.{name}"] = parameter.low
        else:
            filled.append({**draw(amounts), "to": f"params.{name}"})
    paths = draw(st.permutations(PATHS))
    bound = dict(zip(paths, filled, strict=False))
    for path in paths[len(filled) : len(filled) + draw(st.integers(0, 2))]:
        bound[path] = draw(extras)
    attested = ["source"] if "source" in model.fields else []
    when = draw(st.sampled_from([{}, {"mode": 1}, {"k.0": "x"}]))
    return {
        "type": kind,
        "tool": "base",
        "arguments": bound,
        "fixed": settled,
        "attested": attested,
        "when": when,
    }


@settings(max_examples=amount(50, 250))
@given(st.data())
def test_any_call_of_any_sound_binding_is_dispatched_as_it_was_authorized(
    data: st.DataObject,
) -> None:
    """Or refused with a place: by the binder, or because the tool cannot say it."""
    binding, place = unchecked({"go": data.draw(likely())}), site()
    assume(not any(binding_faults(binding, place)))
    check_binding(binding, place)
    call = Sampler(place).call(ways(binding)[0])
    assert call is not None
    changes = st.dictionaries(names | st.sampled_from(PATHS), constants | st.just([1]), max_size=2)
    given_arguments = {**call.arguments, **data.draw(changes)}
    binder = Binder(place, binding)
    try:
        action = binder.bind(Call("go", given_arguments, "input"))
        again = binder.bind(Rebuilder(place, binding).rebuild(action))
    except MalformedError as error:
        places = [error.where]
    else:
        places = ["input"]
        assert again == action
    assert places[0].startswith(("input", "action.tool"))
