# SPDX-License-Identifier: Apache-2.0
"""Neighbors and hierarchy are worked out from the drawing, never from what a planner says."""

from __future__ import annotations

from typing import Any

import msgspec

from authguard_r.core.checks.place import place_findings
from authguard_r.core.identifiers import RegionId
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.core.state import AttestedState, attest
from authguard_r.sim.robot import snapshot_of
from authguard_r.site.model import Door, Region, Site, facts_of, profile_digest
from authguard_r.site.places import adjacent, ancestors
from fixtures import scenarios

replace = msgspec.structs.replace


def square(x: int, y: int, side: int, **changes: Any) -> Region:
    points = ((x, y), (x + side, y), (x + side, y + side), (x, y + side))
    middle = (x + side // 2, y + side // 2)
    return Region(map="main", floor=1, points=points, approach=middle, tags=("staff",), **changes)


def site(regions: dict[str, Region], *doors: Door) -> Site:
    return replace(scenarios.site(), regions=regions, doors=doors, objects={}, robots={})


def test_the_hospital_s_rooms_are_neighbors_where_they_share_a_wall_or_a_door() -> None:
    found = {pair.between: pair for pair in adjacent(scenarios.site())}
    ward = found["public-corridor", "station-101"]
    assert ward.edges == (((10000, 3000), (16000, 3000)),)
    assert [scenarios.site().doors[n].at for n in ward.doors] == [(13000, 3000)]
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


def bay_within_dock(place: tuple[int, int]) -> AttestedState:
    """Return the state of a robot at a point of a dock that has a bay within it."""
    base = scenarios.site()
    points = ((35000, 500), (37000, 500), (37000, 2500), (35000, 2500))
    bay = replace(base.regions["dock"], points=points, names=(), within="dock")
    changed = replace(base, regions={**base.regions, "bay": bay})
    facts = facts_of(
        changed, rid=scenarios.RID, profile=profile_digest(base.robots["courier-1"].profile)
    )
    seen = snapshot_of(scenarios.world("dock"), robot=scenarios.RID, epoch=1, seq=1)
    assert seen.pose is not None
    pose = replace(seen.pose, x_mm=place[0], y_mm=place[1], margin_mm=100)
    return attest(replace(seen, pose=pose), facts, arrived_mono_ms=0)


def passes(state: AttestedState, *regions: str) -> bool:
    found = place_findings(
        state,
        tuple(RegionId(region) for region in regions),
        reason=Reason.OUTSIDE_REGIONS,
        rid=scenarios.RID,
        now=Now(scenarios.START_MS, 0),
        max_age_ms=1_000,
    )
    return not found


def test_granting_a_parent_grants_no_child_and_granting_the_child_suffices_in_it() -> None:
    """Farther from the child's edge than the margin, the child alone is the place."""
    state = bay_within_dock((36000, 1500))
    assert state.place == {"bay"}
    assert passes(state, "bay")
    assert passes(state, "bay", "dock")
    assert not passes(state, "dock")


def test_granting_a_child_grants_nothing_of_its_parent() -> None:
    state = bay_within_dock((34500, 1500))
    assert state.place == {"dock"}
    assert passes(state, "dock")
    assert not passes(state, "bay")


def test_on_the_border_of_a_child_both_must_be_allowed() -> None:
    """Within the margin of the edge nobody can say on which side the robot is."""
    for x in (34901, 35000, 35099):
        state = bay_within_dock((x, 1500))
        assert state.place == {"bay", "dock"}
        assert passes(state, "bay", "dock")
        assert not passes(state, "bay")
        assert not passes(state, "dock")
