# SPDX-License-Identifier: Apache-2.0
"""The suites: every cell that applies is filled, nothing comes twice, nothing changes unnoticed."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from authguard_r.core.identifiers import RobotId
from authguard_r.normalize.binding import load_binding
from authguard_r.site.model import Site
from authguard_r.site.source import convert
from fixtures.suites import loaded
from missionpair import suites
from missionpair.pair import Layout, Pair
from missionpair.planners._tools import places_of, things_of, tools_of
from missionpair.registry import names
from missionpair.suites import (
    _freeze,
    counts_of,
    digest_of,
    frozen,
    require_suite,
)
from missionpair.suites._making import Makers
from missionpair.suites.availability import poisoned
from missionpair.suites.live import ROWS
from missionpair.suites.long import STEPS
from missionpair.wording import HidingMethod, read
from missionpair.words import Category, Channel, Domain, Family

pytestmark = pytest.mark.complete

SPEC = Path(__file__).resolve().parents[3] / "docs" / "spec" / "missionpair.md"


@pytest.fixture(scope="module")
def makers() -> Makers:
    return Makers(2)


# what a full one has


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


def asked(pair: Pair, layout: Layout) -> Any:
    """What an obedient reader takes the inputs for."""
    site = convert(layout.site, Site, where="site")
    binding = load_binding(layout.binding, site=site, where="binding")
    robot = RobotId(pair.attack.robot)
    tools = tools_of(site, binding, robot=robot, beyond=pair.commissioned)
    names = {"places": places_of(site), "things": things_of(site)}
    texts = [read(item.text, tools=tools, **names) for item in pair.inputs]
    return tuple(call for found in texts if found for call in found)


# the others


@pytest.mark.parametrize("name", [name for name in _freeze.names() if name != "full"])
def test_a_suite_is_as_it_was_frozen(name: str) -> None:
    suite, digest = loaded(name)
    require_suite(suite)
    assert (suite.name, digest) == (name, digest_of(suite))
    assert counts_of(suite) == frozen()[name][-1], "raise its version, then freeze"


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
    before = {**held[-1], "version": 0, "digest": "before"}
    assert _freeze.refrozen({"hand": [before]}) == {"hand": [before, held[-1]]}
    # the same suite, counted further than before
    less = {name: held[-1][name] for name in ("version", "digest", "pairs")}
    assert _freeze.refrozen({"hand": [less]}) == {"hand": [held[-1]]}
    with pytest.raises(ValueError, match="raise its `VERSION`"):
        _freeze.refrozen({"hand": [{**held[-1], "digest": "other"}]})


def test_live_has_the_paper_s_six_rows_with_ten_pairs_each() -> None:
    live = loaded("live")[0]
    rows = Counter(pair.categories[0] for pair in live.pairs)
    assert list(rows) == list(ROWS)
    assert set(rows.values()) == {10}
    assert {pair.domain for pair in live.pairs} == {Domain.HOSPITAL}
    assert {pair.channels[0] for pair in live.pairs} == set(Channel)


def test_long_missions_have_twenty_steps_and_are_attacked_half_way() -> None:
    suite = loaded("long")[0]
    assert {pair.domain for pair in suite.pairs} == set(Domain)
    for pair in suite.pairs:
        done = sum(len(act.calls) for act in pair.attack.before)
        assert len(pair.benign.plan) >= STEPS
        assert len(pair.benign.plan) // 3 <= done < len(pair.benign.plan)


def test_every_update_has_its_unauthenticated_twin() -> None:
    suite = loaded("updates")[0]
    kinds = {act.do for pair in suite.pairs for act in pair.update}
    assert kinds == {"activate", "approve", "choose", "order", "propose"}
    assert len({tuple(pair.id.split(".")[:3]) for pair in suite.pairs}) == len(suite.pairs)


def test_hidden_spellings_are_in_the_stress_suite_alone() -> None:
    stress = loaded("stress")[0]
    told = Counter(pair.id.rpartition(".")[2] for pair in stress.pairs)
    assert set(told) == set(HidingMethod)
    assert len({(pair.domain, pair.categories[0]) for pair in stress.pairs}) == 60


def test_texts_full_of_names_ask_for_nothing() -> None:
    suite = loaded("availability")[0]
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
