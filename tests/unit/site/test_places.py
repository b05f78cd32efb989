# SPDX-License-Identifier: Apache-2.0
"""Neighbors and hierarchy are worked out from the drawing, never from what a planner says."""

from __future__ import annotations

from typing import Any

import msgspec

import worlds
from authguard_r.core.checks.place import place_findings
from authguard_r.core.identifiers import RegionId
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.core.state import attest
from authguard_r.sim.robot import snapshot_of
from authguard_r.site.model import Door, Region, Site, facts_of, profile_digest
from authguard_r.site.places import adjacent, ancestors

replace = msgspec.structs.replace


def square(x: int, y: int, side: int, **changes: Any) -> Region:
    points = ((x, y), (x + side, y), (x + side, y + side), (x, y + side))
    middle = (x + side // 2, y + side // 2)
    return Region(map="main", floor=1, points=points, approach=middle, tags=("staff",), **changes)


def site(regions: dict[str, Region], *doors: Door) -> Site:
    return replace(worlds.site(), regions=regions, doors=doors, objects={}, robots={})


def test_the_hospital_s_rooms_are_neighbors_where_they_share_a_wall_or_a_door() -> None:
    found = {pair.between: pair for pair in adjacent(worlds.site())}
    ward = found["public-corridor", "station-101"]
    assert ward.edges == (((10000, 3000), (16000, 3000)),)
    assert [worlds.site().doors[n].at for n in ward.doors] == [(13000, 3000)]
    assert found["staff-corridor", "station-102"].doors == ()  # a wall
    assert ("pharmacy", "station-101") not in found
    assert all(pair.between[0] < pair.between[1] for pair in found.values())
    assert {n for pair in found.values() for n in pair.doors} == set(range(12))


def test_rooms_that_meet_at_a_corner_or_above_each_other_are_no_neighbors() -> None:
    regions = {
        "a": square(0, 0, 10),
        "b": square(10, 10, 10),
        "c": replace(square(10, 0, 10), floor=2),
        "d": replace(square(10, 0, 10), map="annex"),
    }
    assert adjacent(site(regions)) == ()
    lift = Door(between=("c", "a"), at=(10, 5))
    (pair,) = adjacent(site(regions, lift, lift))
    assert (pair.between, pair.doors, pair.edges) == (("a", "c"), (0, 1), ())


def test_ancestors_are_named_nearest_first_and_a_cycle_ends() -> None:
    nested = {
        "floor": square(0, 0, 100),
        "ward": square(0, 0, 50, within="floor"),
        "room": square(0, 0, 20, within="ward"),
    }
    assert ancestors(site(nested), "room") == ("ward", "floor")
    assert ancestors(site(nested), "floor") == ()
    assert ancestors(site(nested), "cellar") == ()
    circle = {"a": square(0, 0, 9, within="b"), "b": square(0, 0, 9, within="a")}
    assert ancestors(site(circle), "a") == ("b", "a")
    assert ancestors(site({"a": square(0, 0, 9, within="gone")}), "a") == ("gone",)


def test_granting_a_parent_grants_no_child() -> None:
    """A pose in the child lies in both regions, so permission for one is not enough."""
    base = worlds.site()
    dock = base.regions["dock"]
    points = ((35000, 500), (37000, 500), (37000, 2500), (35000, 2500))
    bay = replace(dock, points=points, names=(), within="dock")
    changed = replace(base, regions={**base.regions, "bay": bay})
    digest = profile_digest(base.robots["courier-1"].profile)
    facts = facts_of(changed, rid=worlds.RID, profile=digest)
    state = attest(
        snapshot_of(worlds.world("dock"), robot=worlds.RID, epoch=1, seq=1),
        facts,
        arrived_mono_ms=0,
    )
    assert state.place == {"bay", "dock"}

    def refused(*regions: str) -> bool:
        found = place_findings(
            state,
            tuple(RegionId(region) for region in regions),
            reason=Reason.OUTSIDE_REGIONS,
            rid=worlds.RID,
            now=Now(worlds.START_MS, 0),
            max_age_ms=1_000,
        )
        return bool(found)

    assert refused("dock")
    assert refused("bay")
    assert not refused("bay", "dock")
