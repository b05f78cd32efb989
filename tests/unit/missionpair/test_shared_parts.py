# SPDX-License-Identifier: Apache-2.0
"""What the judge has in common with the gate, each part held to a second reading of its own.

Source: docs/spec/measures.md#judge
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import pytest
from msgspec.structs import replace

from authguard_r.core.action import Action
from fixtures.suites import loaded
from missionpair.judging import Walk, plain, proved
from missionpair.mutation import slice_of
from missionpair.pair import Layout, Pair, PriorAct, Suite, WordedCall, plan_bytes
from missionpair.stage import Yard

#: Parts of a registry's entry that say when something happened, on clocks that a walk has not.
_CLOCKS = ("releases",)
#: A robot ends its motion at its next tick; a walk ends it at once.
_TICK_MS = 50


@pytest.fixture(scope="module")
def suite() -> Suite:
    return slice_of(loaded("full:each=1")[0], most=60)


def every_call(pair: Pair) -> list[WordedCall]:
    acts = (*pair.benign.before, *pair.attack.before)
    return [*pair.benign.plan, *pair.attack.plan, *(call for act in acts for call in act.calls)]


def spelled(layout: Layout, word: str) -> str:
    """Return the id of a place or a thing that people call so."""
    for kind in ("regions", "objects"):
        for key, model in layout.site[kind].items():
            if word in (key, *model.get("names", ())):
                return str(key)
    raise KeyError(word)


def reading(layout: Layout, call: WordedCall) -> dict[str, Any]:
    """Return what a call means, by the binding's own text."""
    tool = layout.binding["tools"][call.tool]
    found: dict[str, Any] = {"type": tool["type"], "tool": tool["tool"]}
    params = {key.removeprefix("params."): value for key, value in tool.get("fixed", {}).items()}
    for name, how in tool.get("arguments", {}).items():
        where = how.get("to", "")
        if how["use"] != "mapped" or (name not in call.arguments and "default" not in how):
            continue
        if where.startswith("params."):
            value = how.get("default")
            if name in call.arguments:
                exact = Fraction(str(call.arguments[name])) * Fraction(str(how.get("per_unit", 1)))
                value = int(exact)
            params[where.removeprefix("params.")] = value
        elif where == "route":
            via: Any = call.arguments[name]
            found[where] = [
                spelled(layout, word) for word in ([via] if isinstance(via, str) else via)
            ]
        else:
            found[where] = spelled(layout, str(call.arguments[name]))
    return found | ({"params": params} if params else {})


def shown(action: Action) -> dict[str, Any]:
    """Return of a normalized action what a call can say."""
    named = ("type", "tool", "object", "destination", "route", "params")
    return {key: value for key, value in plain(action).items() if key in named and value}


def test_the_normalizer_reads_every_call_as_its_binding_says(suite: Suite, yard: Yard) -> None:
    count = 0
    for pair in suite.pairs:
        layout = suite.layouts[pair.layout]
        stage = yard.stage(pair, layout, pair.attack)
        for call in every_call(pair):
            (step,) = stage.read(plan_bytes((call,))).steps
            assert shown(step.action) == reading(layout, call), (pair.id, call)
            count += 1
    assert count > 300


def runs(pair: Pair) -> tuple[tuple[PriorAct, ...], tuple[WordedCall, ...]]:
    """Return what happens before the mission's history, and the history."""
    acts = pair.attack.before
    at = next((n for n, act in enumerate(acts) if act.do == "run"), None)
    return (acts, ()) if at is None or acts[at + 1 :] else (acts[:at], acts[at].calls)


def test_the_registry_of_the_gate_is_the_oracles_after_every_history(
    suite: Suite, yard: Yard
) -> None:
    """The gate carries the history out; the oracle goes along, and counts for itself."""
    compared = 0
    for pair in suite.pairs:
        before, history = runs(pair)
        if not history:
            continue
        layout = suite.layouts[pair.layout]
        gate = yard.stage(pair, layout, pair.attack)
        begun = yard.stage(pair, layout, replace(pair.attack, before=before))
        walk = Walk.of(begun)
        for step in begun.read(plan_bytes(history)).steps:
            effect = proved(walk, walk.completed(step))
            assert effect.authorized, (pair.id, effect)
            assert walk.go_on(effect.action, grant=effect.grant)
        assert walk.standing is not None
        mine, theirs = counted(walk.standing), counted(plain(gate.standing()))
        moved = [entry.get("spent", {}).pop("motion_ms", 0) for entry in (mine, theirs)]
        assert mine == theirs, pair.id
        assert abs(moved[0] - moved[1]) <= _TICK_MS * len(history), pair.id
        assert walk.state == gate.sim.robot.state
        compared += 1
    assert compared > 10


def counted(standing: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in standing.items() if key not in _CLOCKS and value}


def test_what_an_estimator_attests_is_what_the_world_is(suite: Suite, yard: Yard) -> None:
    for pair in suite.pairs:
        stage = yard.stage(pair, suite.layouts[pair.layout], pair.attack)
        state, walk = stage.sim.robot.state, Walk.of(stage)
        seen = plain(walk.snapshot)
        values = {name: one["value"] for name, one in seen["readings"].items()}
        assert values["holding"] == (state.holding or "nothing")
        assert values["battery_permille"] == state.battery_permille
        assert {one["label"] for one in seen["readings"].values()} == {"trusted_sensor"}
        assert inside(suite.layouts[pair.layout], seen["pose"]) == {state.region}


def inside(layout: Layout, pose: dict[str, Any]) -> set[str]:
    """Return the rooms in whose corners a pose lies; every room of the suite is a rectangle."""
    found = set()
    for name, region in layout.site["regions"].items():
        xs, ys = ({point[axis] for point in region["points"]} for axis in (0, 1))
        is_here = (region["map"], region["floor"]) == (pose["map"], pose["floor"])
        within = min(xs) <= pose["x_mm"] <= max(xs) and min(ys) <= pose["y_mm"] <= max(ys)
        found |= {str(name)} if is_here and within else set()
    return found


def test_answers_whose_signatures_hold_are_those_of_the_people_who_answered(yard: Yard) -> None:
    """Once each, for the question that is open; who only asked, or signed twice, adds nothing."""
    full, tried = loaded("full:each=1")[0], 0
    for pair in full.pairs:
        people = [name for act in pair.attack.before if act.do == "approve" for name in act.by]
        if not people:
            continue
        walk = Walk.of(yard.stage(pair, full.layouts[pair.layout], pair.attack))
        assert walk.standing is not None
        ((grant, request),) = walk.standing["requests"].items()
        given = [(one["approver"]["id"], one["approval"]) for one in walk.approvals]
        assert sorted(name for name, _ in given) == sorted(set(people)), pair.id
        for name, answer in given:
            assert name.startswith(f"{_role_of(walk, name)}-")
            assert (answer["grant"], answer["verdict"]) == (grant, "approve")
            assert {key: request[key] for key in ("counter", "scope", "situation")} == {
                key: answer[key] for key in ("counter", "scope", "situation")
            }
        tried += 1
        if tried == 12:
            return
    pytest.fail("too few pairs have an answer")


def _role_of(walk: Walk, name: str) -> str:
    found = next(one["approver"] for one in walk.approvals if one["approver"]["id"] == name)
    return str(found["role"])
