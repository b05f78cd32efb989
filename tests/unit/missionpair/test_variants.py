# SPDX-License-Identifier: Apache-2.0
"""Every category's twins in every domain: one thing changes, and one signed act makes it right."""

from __future__ import annotations

from collections.abc import Iterator
from random import Random

import pytest
from msgspec.structs import replace

from fixtures.cases import case
from missionpair import domains, variants
from missionpair.layouts import Ground, layouts_of
from missionpair.missions import added, amended, raised, superseding
from missionpair.missions.amend import grant_of
from missionpair.missions.draw import UnfitDraw
from missionpair.pair import updated
from missionpair.registry import make, names
from missionpair.suites._making import Cell, pair_of
from missionpair.variants._twin import AttackVariant, AttackVariants
from missionpair.words import Category, Channel, Domain, Family

CATEGORIES = names(variants)
FALSE = Family.FALSE_EMERGENCY


@pytest.fixture(scope="module")
def grounds() -> dict[Domain, tuple[Ground, ...]]:
    made = (layouts_of(make(domains, name), 8) for name in names(domains))
    return {held[0].layout.domain: held for held in made}


def drawn(
    made: AttackVariants, ground: tuple[Ground, ...], family: Family, seed: int = 0
) -> AttackVariant:
    for attempt in range(400):
        rng = Random(f"{seed} {attempt}")
        try:
            return made.make(rng.choice(ground), rng, family)
        except UnfitDraw:
            continue
    raise AssertionError(f"no twin of {made.category} for {family}")


def cells(category: str) -> Iterator[tuple[Domain, Family]]:
    made: AttackVariants = make(variants, category)
    for domain in Domain:
        for family, where in made.families.items():
            if not where.refuses(domain):
                yield domain, family


def test_every_category_of_the_paper_has_its_file() -> None:
    assert set(CATEGORIES) == {*map(str, Category), "combined"}


def test_every_cell_has_a_twin_that_names_what_it_changes(
    grounds: dict[Domain, tuple[Ground, ...]],
) -> None:
    for category in CATEGORIES:
        with case(category):
            made: AttackVariants = make(variants, category)
            assert set(made.families) == set(Family)
            for domain, family in cells(category):
                twin = drawn(made, grounds[domain], family)
                assert twin.violates
                assert twin.update
                assert twin.authorized
                assert next(iter(twin.missions)) == "v1"
                assert (len(twin.categories) > 1) == (category == "combined")
                assert category == "combined" or twin.categories == (Category(category),)


def test_the_same_seed_gives_the_same_twin(grounds: dict[Domain, tuple[Ground, ...]]) -> None:
    for category in CATEGORIES:
        with case(category):
            made: AttackVariants = make(variants, category)
            domain, family = next(cells(category))
            first, again = (drawn(made, grounds[domain], family, 7) for _ in range(2))
            assert (first.missions, first.plan, first.before) == (
                again.missions,
                again.plan,
                again.before,
            )


def test_combinations_change_two_or_three_things(
    grounds: dict[Domain, tuple[Ground, ...]],
) -> None:
    made: AttackVariants = make(variants, "combined")
    held = [
        drawn(made, grounds[domain], family, seed)
        for domain, family in cells("combined")
        for seed in range(4)
    ]
    assert {len(set(twin.categories)) for twin in held} == {2, 3}
    assert any(len(twin.plan) > 1 for twin in held)


def test_what_a_robot_cannot_do_is_its_integrator_s_to_add(
    grounds: dict[Domain, tuple[Ground, ...]],
) -> None:
    """A twin beyond the profile: its operator signed it, and another profile authorizes it."""
    made: AttackVariants = make(variants, Category.CAPABILITY)
    for domain in Domain:
        found = (drawn(made, grounds[domain], Family.FALSE_EMERGENCY, seed) for seed in range(100))
        twin = next(twin for twin in found if twin.commissioned)
        layout, cell = twin.errand.ground.layout, Cell(domain, "capability", FALSE, Channel.SIGN)
        pair = pair_of(twin, cell, 1, seed=1)
        site = updated(pair, layout)
        ((kind, tool),) = pair.commissioned.items()
        tools = (of.site["robots"][twin.robot]["profile"]["tools"] for of in (layout, site))
        lacking, held = ((tool in of.get(kind, ())) for of in tools)
        assert (pair.violates, lacking, held) == (("CAPABILITY_EXCEEDED",), False, True)
        assert site.id != layout.id
        assert updated(replace(pair, commissioned={}), layout) is layout


def test_a_next_version_keeps_ids_of_grants_that_stay_and_renames_those_that_change() -> None:
    draft = {
        "mission": "m",
        "budgets": {"actions": 3},
        "grants": [
            {"id": "go", "type": "navigate", "tool": "base", "rows": [{"destination": "a"}]},
            {"id": "put", "type": "place", "tool": "hand", "rows": [{}], "after": ["go"]},
        ],
        "closing": {"grants": ["go"], "for": 1},
    }
    second = superseding(draft, amended(draft, "go", rows=[{"destination": "b"}]))
    assert second["version"] == 2
    assert [grant["id"] for grant in second["grants"]] == ["go-v2", "put"]
    assert grant_of(second, "put")["after"] == ["go-v2"]
    assert second["closing"]["grants"] == ["go-v2"]
    third = superseding(second, raised(second, actions=4))
    assert (third["version"], third["budgets"]["actions"]) == (3, 4)
    assert [grant["id"] for grant in third["grants"]] == ["go-v2", "put"]
    more = added(draft, {"id": "scan", "type": "scan_obstacles"}, first=True)
    assert [grant["id"] for grant in more["grants"]] == ["scan", "go", "put"]
