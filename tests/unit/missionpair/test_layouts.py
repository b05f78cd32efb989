# SPDX-License-Identifier: Apache-2.0
"""Generated floor plans: sound, short, the same every time, and none a renaming of another."""

from __future__ import annotations

import json
from collections.abc import Iterator
from itertools import permutations
from typing import Any

import pytest

from authguard_r.authoring.binding.check import check_binding
from authguard_r.normalize.binding import load_binding
from authguard_r.site.check import faults
from authguard_r.site.model import Site
from authguard_r.site.source import convert
from missionpair import domains
from missionpair.layouts import EACH, Ground, layouts_of, shape_of
from missionpair.registry import make, names
from missionpair.words import Domain

DOMAINS = names(domains)
#: Longest way between two places of a floor, in meters.
LONGEST_M = 40


@pytest.fixture(scope="module")
def grounds() -> dict[str, tuple[Ground, ...]]:
    return {name: layouts_of(make(domains, name)) for name in DOMAINS}


def every(grounds: dict[str, tuple[Ground, ...]]) -> Iterator[Ground]:
    for held in grounds.values():
        yield from held


def test_every_domain_has_its_file_and_at_least_forty_layouts(
    grounds: dict[str, tuple[Ground, ...]],
) -> None:
    assert {g.layout.domain for g in every(grounds)} == set(Domain)
    assert all(len(held) >= EACH >= 40 for held in grounds.values())
    assert sum(map(len, grounds.values())) >= 200


def test_no_layout_is_another_one_with_other_names(grounds: dict[str, tuple[Ground, ...]]) -> None:
    shapes = [shape_of(g.layout.site) for g in every(grounds)]
    assert len(set(shapes)) == len(shapes)


def test_a_shape_does_not_change_with_names_sizes_or_order(
    grounds: dict[str, tuple[Ground, ...]],
) -> None:
    for ground in (held[0] for held in grounds.values()):
        site = ground.layout.site
        known = sorted([*site["regions"], *site["objects"], *site["robots"]], key=len, reverse=True)
        text = json.dumps({**site, "vocabulary": {}})
        for number, name in enumerate(known):
            text = text.replace(f'"{name}"', f'"x-{number}"')
        renamed: dict[str, Any] = {**json.loads(text), "vocabulary": site["vocabulary"]}
        renamed["regions"] = dict(reversed(renamed["regions"].items()))
        renamed["doors"] = renamed["doors"][::-1]
        for region in renamed["regions"].values():
            region["points"] = [[x * 3, y * 3] for x, y in region["points"]]
        assert shape_of(renamed) == shape_of(site)


def test_one_door_tag_or_thing_more_is_another_shape(
    grounds: dict[str, tuple[Ground, ...]],
) -> None:
    site = grounds["hospital"][0].layout.site
    doors = [{**site["doors"][0], "variable": "shut"}, *site["doors"][1:]]
    if "variable" in site["doors"][0]:  # pragma: no cover - whichever the first door is
        doors = [{k: v for k, v in site["doors"][0].items() if k != "variable"}, *site["doors"][1:]]
    room = list(site["regions"])[-1]
    tags = {**site["regions"], room: {**site["regions"][room], "tags": ["other"]}}
    thing = {"kind": "x", "home": room, "mass_g": 1, "names": []}
    changed = (
        {**site, "doors": doors},
        {**site, "regions": tags},
        {**site, "objects": {**site["objects"], "more": thing}},
    )
    shapes = {shape_of(site), *map(shape_of, changed)}
    assert len(shapes) == 4


def test_every_layout_is_a_sound_site_with_a_sound_binding(
    grounds: dict[str, tuple[Ground, ...]],
) -> None:
    for ground in every(grounds):
        layout = ground.layout
        site = convert(layout.site, Site, where=layout.id)
        assert faults(site) == ()
        load_binding(layout.binding, site=site, where=layout.id)


@pytest.mark.parametrize("domain", DOMAINS)
def test_every_field_of_every_tool_is_bound(
    domain: str, grounds: dict[str, tuple[Ground, ...]]
) -> None:
    layout = grounds[domain][0].layout
    site = convert(layout.site, Site, where=layout.id)
    binding = load_binding(layout.binding, site=site, where=layout.id)
    report = check_binding(binding, site)
    assert report.faults == ()
    assert report.unproven == ()


def test_floors_differ_in_corridors_loops_wings_and_rooms_behind_rooms(
    grounds: dict[str, tuple[Ground, ...]],
) -> None:
    for held in grounds.values():
        rooms = {len(g.tags) for g in held}
        loops = {len(g.layout.site["doors"]) - len(g.tags) + 1 for g in held}
        closable = {any("variable" in d for d in g.layout.site["doors"]) for g in held}
        assert len(rooms) >= 6
        assert {0} < loops
        assert closable == {True, False}
        kinds = {tuple(sorted(set(g.tags.values()))) for g in held}
        assert any("hazardous" in tags for tags in kinds)


def test_everything_is_a_few_meters_apart_and_can_be_reached(
    grounds: dict[str, tuple[Ground, ...]],
) -> None:
    for ground in every(grounds):
        for start, end in permutations(ground.tags, 2):
            (x, y), (right, top) = ground.approach(start), ground.approach(end)
            assert abs(right - x) + abs(top - y) <= LONGEST_M * 1_000
            assert ground.way(start, end)[-1] == end


def test_no_way_leads_through_a_hazardous_room(grounds: dict[str, tuple[Ground, ...]]) -> None:
    for ground in every(grounds):
        for start, end in permutations(ground.tags, 2):
            assert "hazardous" not in {ground.tags[r] for r in ground.way(start, end)[1:-1]}


def test_the_same_layouts_come_every_time() -> None:
    words = make(domains, "office")
    again = [ground.layout for ground in layouts_of(words, 5)]
    assert again == [ground.layout for ground in layouts_of(words, 5)]
