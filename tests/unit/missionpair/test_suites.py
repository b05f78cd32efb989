# SPDX-License-Identifier: Apache-2.0
"""The suites: every cell that applies is filled, nothing comes twice, nothing changes unnoticed."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import msgspec
import pytest
from msgspec.structs import replace

from missionpair import suites
from missionpair.briefing import Tool
from missionpair.pair import Layout, Pair, Suite
from missionpair.registry import names
from missionpair.suites import (
    _freeze,
    canonical,
    counts_of,
    digest_of,
    frozen,
    load,
    require_suite,
    skeleton,
)
from missionpair.suites._canonical import form_of
from missionpair.suites._making import Makers
from missionpair.suites.availability import poisoned
from missionpair.suites.live import ROWS
from missionpair.suites.long import STEPS
from missionpair.wording import How, read
from missionpair.words import Category, Channel, Domain, Family

SPEC = Path(__file__).resolve().parents[3] / "docs" / "spec" / "missionpair.md"


@pytest.fixture(scope="module")
def full() -> Suite:
    return load("full")[0]


@pytest.fixture(scope="module")
def makers() -> Makers:
    return Makers(2)


# full


def test_it_is_large(full: Suite) -> None:
    assert len(full.pairs) >= 6_000
    assert len(full.layouts) >= 200
    require_suite(full)


def test_every_cell_that_applies_is_filled(full: Suite, makers: Makers) -> None:
    filled = Counter((*pair.id.split(".")[:3], pair.channels[0]) for pair in full.pairs)
    cells = {tuple(map(str, cell)) for cell in makers.cells()}
    assert set(filled) == cells
    assert min(filled.values()) >= 1
    for domain in Domain:
        for category in (*map(str, Category), "combined"):
            here = {c for c in cells if c[:2] == (domain, category)}
            assert {c[3] for c in here} == set(Channel)


def test_every_cell_that_does_not_apply_says_why(makers: Makers) -> None:
    told = {
        (category, family): makers.why_not(domain, category, family)
        for domain in Domain
        for category in makers.twins
        for family in Family
        if makers.why_not(domain, category, family)
    }
    assert told
    assert all(len(why) > 20 for why in told.values())


def test_the_page_has_the_matrix_as_it_is(makers: Makers) -> None:
    assert matrix(makers) in SPEC.read_text(encoding="utf-8")


def matrix(makers: Makers) -> str:
    """Return the matrix as the page has it."""
    lines = ["| category | " + " | ".join(Family) + " |", "|---" * (len(Family) + 1) + "|"]
    for category in (*map(str, Category), "combined"):
        cells = []
        for family in Family:
            where = makers.twins[category].families[family]
            some = ", ".join(sorted(where.domains)) if len(where.domains) < len(Domain) else "yes"
            cells.append(f"no: {where.why_not}" if where.why_not else _some(some, where.elsewhere))
        lines.append(f"| {category} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _some(some: str, elsewhere: str) -> str:
    return some if some == "yes" else f"{some}; elsewhere {elsewhere}"


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
        assert pair.inputs[0].text.isascii()
        assert asked(pair, layout) == pair.attack.plan, pair.id


def asked(pair: Pair, layout: Layout) -> Any:
    """What an obedient reader takes the inputs for."""
    tools = tuple(
        Tool(name, "", {"properties": {argument: {} for argument in tool["arguments"]}})
        for name, tool in layout.binding["tools"].items()
    )
    places = tuple(model["names"][0] for model in layout.site["regions"].values())
    things = tuple(model["names"][0] for model in layout.site["objects"].values())
    texts = [read(i.text, tools=tools, places=places, things=things) for i in pair.inputs]
    return tuple(call for found in texts if found for call in found)


# the canonical form


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


# the others


@pytest.mark.parametrize("name", [name for name in _freeze.names() if name != "full"])
def test_a_suite_is_as_it_was_frozen(name: str) -> None:
    suite, digest = load(name)
    require_suite(suite)
    assert (suite.name, digest) == (name, digest_of(suite))
    assert counts_of(suite) == frozen()[name][-1], "raise its version, then freeze"


def test_the_large_suite_is_as_it_was_frozen(full: Suite) -> None:
    assert counts_of(full) == frozen()["full"][-1], "raise its version, then freeze"


def test_everything_is_frozen_and_versions_only_grow() -> None:
    assert set(frozen()) == set(_freeze.names())
    assert set(_freeze.names()) == set(names(suites)) - _freeze.OPEN
    for versions in frozen().values():
        numbers = [version["version"] for version in versions]
        assert numbers == sorted(set(numbers))


def test_a_suite_that_changed_without_a_new_version_is_not_frozen(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(_freeze, "names", lambda: ("hand",))
    held = frozen()["hand"]
    assert _freeze.refrozen({"hand": held}) == {"hand": held}
    assert _freeze.refrozen({}) == {"hand": [held[-1]]}
    before = {**held[-1], "version": 0}
    assert _freeze.refrozen({"hand": [before]}) == {"hand": [before, held[-1]]}
    with pytest.raises(ValueError, match="raise its `VERSION`"):
        _freeze.refrozen({"hand": [{**held[-1], "digest": "other"}]})


def test_live_has_the_paper_s_six_rows_with_ten_pairs_each() -> None:
    live = load("live")[0]
    rows = Counter(pair.categories[0] for pair in live.pairs)
    assert list(rows) == list(ROWS)
    assert set(rows.values()) == {10}
    assert {pair.domain for pair in live.pairs} == {Domain.HOSPITAL}
    assert {pair.channels[0] for pair in live.pairs} == set(Channel)


def test_long_missions_have_twenty_steps_and_are_attacked_half_way() -> None:
    suite = load("long")[0]
    assert {pair.domain for pair in suite.pairs} == set(Domain)
    for pair in suite.pairs:
        done = sum(len(act.calls) for act in pair.attack.before)
        assert len(pair.benign.plan) >= STEPS
        assert len(pair.benign.plan) // 3 <= done < len(pair.benign.plan)


def test_every_update_has_its_unauthenticated_twin() -> None:
    suite = load("updates")[0]
    kinds = {act.do for pair in suite.pairs for act in pair.update}
    assert kinds == {"activate", "approve", "choose", "order", "propose"}
    assert len({tuple(pair.id.split(".")[:3]) for pair in suite.pairs}) == len(suite.pairs)


def test_hidden_spellings_are_in_the_stress_suite_alone() -> None:
    stress = load("stress")[0]
    told = Counter(pair.id.rpartition(".")[2] for pair in stress.pairs)
    assert set(told) == set(How)
    assert len({(pair.domain, pair.categories[0]) for pair in stress.pairs}) == 60


def test_texts_full_of_names_ask_for_nothing() -> None:
    suite = load("availability")[0]
    poison = [pair for pair in suite.pairs if len(pair.inputs) > 1]
    assert len(poison) * 2 == len(suite.pairs)
    for pair in poison[::9]:
        layout = suite.layouts[pair.layout]
        alone = replace(pair, inputs=pair.inputs[:-1])
        assert asked(alone, layout) == ()
        said = " ".join(item.text for item in alone.inputs)
        models = [*layout.site["regions"].values(), *layout.site["objects"].values()]
        assert all(model["names"][0] in said for model in models)
    again = poisoned(replace(poison[0], inputs=poison[0].inputs[-1:]), layout, 1)
    assert len(again.inputs) == 4
