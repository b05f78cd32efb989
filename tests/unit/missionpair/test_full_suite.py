# SPDX-License-Identifier: Apache-2.0
"""The large suite: every cell that applies is filled, no pair comes twice, each check has its own.

It is made once for all of this, which takes as long as everything else here.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

import msgspec
import pytest
from msgspec.structs import replace

from fixtures.suites import loaded
from missionpair.judging import check
from missionpair.mutation import mutate, slice_of
from missionpair.pair import Layout, Pair, Suite, plan_bytes
from missionpair.stage import Yard
from missionpair.suites import canonical, counts_of, frozen, require_suite, skeleton
from missionpair.suites._canonical import form_of
from missionpair.suites._making import Makers
from missionpair.words import Category, Channel, Domain
from unit.missionpair.test_suites import asked

pytestmark = pytest.mark.complete


@pytest.fixture(scope="module")
def full() -> Suite:
    return loaded("full")[0]


def test_it_is_large(full: Suite) -> None:
    assert len(full.pairs) >= 6_000
    assert len(full.layouts) >= 200
    require_suite(full)


def test_every_cell_that_applies_is_filled(full: Suite) -> None:
    filled = Counter((*pair.id.split(".")[:3], pair.channels[0]) for pair in full.pairs)
    cells = {tuple(map(str, cell)) for cell in Makers(2).cells()}
    assert set(filled) == cells
    assert min(filled.values()) >= 1
    for domain in Domain:
        for category in (*map(str, Category), "combined"):
            here = {c for c in cells if c[:2] == (domain, category)}
            assert {c[3] for c in here} == set(Channel)


def test_no_attack_is_another_one_with_other_names(full: Suite) -> None:
    forms = Counter(canonical(pair, full.layouts[pair.layout]) for pair in full.pairs)
    assert forms.most_common(1)[0][1] == 1


def test_the_variety_is_one_of_structure_and_not_of_numbers(full: Suite) -> None:
    bare = {skeleton(pair, full.layouts[pair.layout]) for pair in full.pairs}
    assert len(bare) >= 6_000
    drafts = [pair.missions["v1"] for pair in full.pairs]
    grants = [grant for draft in drafts for grant in draft["grants"]]
    assert {len([g for g in d["grants"] if g["type"] == "place"]) for d in drafts} >= {
        0,
        1,
        2,
        3,
        4,
    }
    assert {len(grant["rows"]) for grant in grants} >= {1, 2, 3, 4}
    assert {g["chooser"] for g in grants} == {"operator", "supervisor", "trusted_sensor", "planner"}
    assert {g["repeat"] for g in grants} >= {1, 2, 3}
    assert any(g.get("after") for g in grants)
    assert any(g.get("until") for g in grants)
    assert any(g.get("data") for g in grants)
    assert any(g.get("done_when") for g in grants)
    assert {bool(d.get("closing")) for d in drafts} == {True, False}
    assert len({d["window"]["for"] for d in drafts}) >= 6


def test_two_channels_support_each_other_in_every_cell(full: Suite) -> None:
    pairs = [pair for pair in full.pairs if len(pair.channels) == 2]
    cells = {(*pair.id.split(".")[:3], pair.channels[0]) for pair in pairs}
    assert len(cells) == len(pairs)
    assert len(pairs) * 5 == len(full.pairs)
    assert all(len(set(pair.channels)) == 2 for pair in pairs)


def test_every_layout_is_used(full: Suite) -> None:
    used = Counter(pair.layout for pair in full.pairs)
    assert set(used) == set(full.layouts)
    assert min(used.values()) >= 5


def test_every_protected_field_that_a_planner_reaches_is_violated_by_some_pair(full: Suite) -> None:
    alone = {pair.violates[0] for pair in full.pairs if len(pair.violates) == 1}
    assert alone >= {
        *("ACTION_OUT_OF_SCOPE", "TOOL_OUT_OF_SCOPE", "OBJECT_OUT_OF_SCOPE"),
        *("SOURCE_OUT_OF_SCOPE", "OUTSIDE_REGIONS", "DESTINATION_OUT_OF_SCOPE"),
        *("ROUTE_OUT_OF_SCOPE", "PARAMETER_OUT_OF_BOUNDS", "DATA_RIGHT_MISSING"),
        *("GRANT_CLOSED", "REPEAT_EXHAUSTED", "RATE_EXCEEDED", "BUDGET_EXCEEDED", "GUARD_FALSE"),
        *("PROVENANCE_DENIED", "APPROVAL_REQUIRED", "APPROVAL_TIMEOUT", "EXPIRED"),
        "MISSION_COMPLETED",
    }


def test_the_texts_ask_for_the_twin_and_say_nothing_hidden(full: Suite) -> None:
    for pair in full.pairs[:: len(full.pairs) // 200]:
        layout = full.layouts[pair.layout]
        assert all(item.text.isprintable() or "\n" in item.text for item in pair.inputs)
        assert asked(pair, layout) == pair.attack.plan, pair.id


def renamed(pair: Pair, layout: Layout) -> tuple[Pair, Layout]:
    """The pair with every place, thing and name called otherwise."""
    site = layout.site
    spoken = {}
    for kind in ("regions", "objects"):
        for number, (key, model) in enumerate(site[kind].items()):
            spoken[key] = f"{kind[0]}-id-{number}"
            spoken[model["names"][0]] = f"{kind[0].upper()} name {number}"
    grants = {g["id"]: f"grant-{9 - n}" for n, g in enumerate(pair.missions["v1"]["grants"])}

    def called(value: Any) -> Any:
        if isinstance(value, str):
            return spoken.get(value, value)
        if isinstance(value, list | tuple):
            found = [called(item) for item in value]
            return sorted(found) if all(isinstance(item, str) for item in found) else found
        if isinstance(value, dict):
            return {
                spoken.get(key, key): item if key in {"tool", "type"} else called(item)
                for key, item in value.items()
            }
        return value

    draft = called(pair.missions["v1"])
    text = msgspec.json.encode(draft)
    for old, new in grants.items():
        text = text.replace(f'"{old}"'.encode(), f'"{new}"'.encode())
    plain = called(msgspec.to_builtins(pair))
    plain["missions"] = {**plain["missions"], "v1": msgspec.json.decode(text)}
    made = msgspec.convert(plain, Pair)
    return made, replace(layout, site=called(site))


def test_renaming_everything_changes_no_form(full: Suite) -> None:
    for pair in full.pairs[:: len(full.pairs) // 60]:
        layout = full.layouts[pair.layout]
        assert canonical(*renamed(pair, layout)) == canonical(pair, layout), pair.id


@pytest.mark.parametrize(
    "changed",
    [
        {"budgets": {"actions": 1}},
        {"guards": [{"variable": "battery_permille", "ge": 1, "max_age": 1}]},
        {"window": {"for": "7 min"}},
    ],
)
def test_what_a_mission_says_is_part_of_its_form(full: Suite, changed: dict[str, Any]) -> None:
    pair = full.pairs[0]
    layout = full.layouts[pair.layout]
    other = replace(pair, missions={"v1": {**pair.missions["v1"], **changed}})
    assert canonical(other, layout) != canonical(pair, layout)
    assert form_of(replace(pair, violates=("EXPIRED",)), layout) != form_of(pair, layout)


def test_the_large_suite_is_as_it_was_frozen(full: Suite) -> None:
    assert counts_of(full) == frozen()["full"][-1], "raise its version, then freeze"


def test_the_suite_notices_the_loss_of_every_check(full: Suite, yard: Yard) -> None:
    """A slice with one pair of each kind and domain; nothing is let through with all in place."""
    few = slice_of(full)
    assert {pair.domain for pair in few.pairs} == set(Domain)
    assert [row.check for row in mutate(few, yard) if not row.is_as_it_should] == []


def test_a_plan_with_the_twin_in_it_is_compliance(full: Suite, yard: Yard) -> None:
    for pair in slice_of(full, most=40).pairs:
        stage = yard.stage(pair, full.layouts[pair.layout], pair.attack)
        checked = check(stage, plan_bytes(pair.attack.plan))
        assert (checked.complied, checked.succeeds) == (True, True), pair.id
