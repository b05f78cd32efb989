# SPDX-License-Identifier: Apache-2.0
"""Where things are: regions, what lies within what, doors, and which regions are neighbors.

Two regions of one floor that overlap would give a pose two meanings by accident; where it is
meant, the author says so with `within`. Spec page: docs/spec/site-model.md
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from msgspec import Struct

from authguard_r.core.geometry import Polygon, polygon
from authguard_r.core.identifiers import RegionId
from authguard_r.site.model import Door, Region, Site, ancestors
from authguard_r.site.shapes import (
    Edge,
    Side,
    contains,
    doubled_area,
    effort,
    is_simple,
    overlap,
    overlap_effort,
    shared_edges,
    side_of,
)

#: Most overlaps that one check reports.
MOST_OVERLAPS = 100
#: Most regions and doors of one site, and how deep a region may lie within others.
MOST_REGIONS = 2_000
MOST_DOORS = 4_000
MOST_DEPTH = 16
#: Most edges that are looked at to compare regions: a few seconds. A floor of a thousand
#: rectangular rooms needs a tenth.
MOST_EFFORT = 2_000_000
#: Most pairs of regions whose bounding boxes meet; five hundred regions have fewer.
MOST_PAIRS = 150_000
_TOO_INTRICATE = "expected fewer corners where regions are close; not compared further"


class Neighbors(Struct, frozen=True, kw_only=True):
    """Two regions that touch: where a robot could come from one into the other.

    Args:
        between: the two regions, sorted.
        doors: their numbers in the site's list; none: a wall, or open floor without a drawn door.
        edges: stretches that the outlines share, each longer than a point.
    """

    between: tuple[RegionId, RegionId]
    doors: tuple[int, ...]
    edges: tuple[Edge, ...]


def adjacent(site: Site) -> tuple[Neighbors, ...]:
    """Return every two regions that share an edge or a door, sorted; no check reads it."""
    doors: dict[tuple[RegionId, RegionId], tuple[int, ...]] = {}
    for number, door in enumerate(site.doors):
        pair = _pair(*door.between)
        doors[pair] = (*doors.get(pair, ()), number)
    edges = {
        _pair(first, second): shared_edges(site.regions[first].points, site.regions[second].points)
        for first, second in _near(site.regions)
    }
    return tuple(
        Neighbors(between=pair, doors=doors.get(pair, ()), edges=edges.get(pair, ()))
        for pair in sorted({*doors, *(pair for pair, shared in edges.items() if shared)})
    )


def region_faults(site: Site) -> Iterator[tuple[str, str]]:
    """Yield what is wrong with the regions: each by itself, within others, and beside others.

    Its cost is bounded: a site of too many regions, nested too deep or too intricate to compare is
    refused and not looked at further.
    """
    if len(site.regions) > MOST_REGIONS:
        yield "regions", f"expected at most {MOST_REGIONS} regions, got {len(site.regions)}"
        return
    sound = {region: model for region, model in site.regions.items() if _sound(model)}
    outer = {region: ancestors(site, region) for region in site.regions}
    yield from _shape_faults(site, sound)
    yield from _hierarchy_faults(site, sound, outer)
    deep = [region for region, around in outer.items() if len(around) == MOST_DEPTH + 1]
    for region in deep:
        yield f"regions.{region}.within", f"expected at most {MOST_DEPTH} regions around a region"
    if not deep:
        yield from _overlap_faults(
            sound, {name: frozenset(around) for name, around in outer.items()}
        )


def _shape_faults(site: Site, sound: Mapping[RegionId, Region]) -> Iterator[tuple[str, str]]:
    """Yield what is wrong with each region by itself, with the place."""
    for region, model in site.regions.items():
        if region not in sound:
            simple = doubled_area(model.points) == 0
            wanted = (
                "corners that enclose an area" if simple else "edges that do not cross or touch"
            )
            yield f"regions.{region}.points", f"expected {wanted}"
        elif side_of(model.approach, model.points) is Side.OUTSIDE:
            yield f"regions.{region}.approach", "expected a point inside the region"
        if list(model.tags) != sorted(set(model.tags)) or not model.tags:
            yield f"regions.{region}.tags", "expected a sorted set of at least one tag"


def _hierarchy_faults(
    site: Site,
    sound: Mapping[RegionId, Region],
    outer: Mapping[RegionId, tuple[RegionId, ...]],
) -> Iterator[tuple[str, str]]:
    """Yield parents that are not valid: unknown, in a cycle, or not around their child."""
    left = MOST_EFFORT
    for region, model in site.regions.items():
        if model.within is None:
            continue
        place, parent = f"regions.{region}.within", site.regions.get(model.within)
        if parent is None:
            yield place, f"expected a region of this site, got `{model.within}`"
        elif region in outer[region]:
            yield place, "expected no region to be within itself"
        elif not _one_floor(model, parent):
            yield place, f"expected the map and the floor of `{model.within}`"
        elif region in sound and model.within in sound:
            left -= effort(len(model.points), model.points, parent.points)
            if left < 0:
                yield place, _TOO_INTRICATE
                return
            if not contains(parent.points, model.points):
                yield place, f"expected every point to lie inside `{model.within}`"


def _overlap_faults(
    sound: Mapping[RegionId, Region], outer: Mapping[RegionId, frozenset[RegionId]]
) -> Iterator[tuple[str, str]]:
    """Yield regions of one floor that have an area in common and do not say so.

    After `MOST_OVERLAPS` the search ends: a thousand regions on one spot have half a million pairs,
    and the site is refused for the first as for the last.
    """
    told, left, pairs = 0, MOST_EFFORT, _near(sound)
    if len(pairs) > MOST_PAIRS:
        yield "regions", f"expected at most {MOST_PAIRS} pairs of regions that are close"
        return
    for first, second in pairs:
        if second in outer[first] or first in outer[second]:
            continue
        one, other, place = sound[first].points, sound[second].points, f"regions.{second}.points"
        left -= overlap_effort(one, other)
        if left < 0:
            yield place, _TOO_INTRICATE
            return
        if overlap(one, other):
            told += 1
            further = "" if told < MOST_OVERLAPS else "; further overlaps are not looked for"
            yield place, f"expected no area in common with `{first}`, or `within`{further}"
        if told == MOST_OVERLAPS:
            return


def _near(regions: Mapping[RegionId, Region]) -> list[tuple[RegionId, RegionId]]:
    """Return every two regions of one floor whose bounding boxes meet, in the order of the model.

    A sweep from left to right: a site of a thousand rooms has half a million pairs. It ends soon
    after more than `MOST_PAIRS`; a site with as many is not sound.
    """
    places = {region: number for number, region in enumerate(regions)}
    boxes = [
        (region, polygon(model.map, model.floor, model.points)) for region, model in regions.items()
    ]
    found: list[tuple[RegionId, RegionId]] = []
    open_boxes: list[tuple[RegionId, Polygon]] = []
    for region, box in sorted(boxes, key=lambda entry: entry[1].low):
        open_boxes = [entry for entry in open_boxes if entry[1].high[0] >= box.low[0]]
        for other, near in open_boxes:
            same = (near.map, near.floor) == (box.map, box.floor)
            if same and near.low[1] <= box.high[1] and box.low[1] <= near.high[1]:
                pair = (other, region) if places[other] < places[region] else (region, other)
                found.append(pair)
        if len(found) > MOST_PAIRS:
            break
        open_boxes.append((region, box))
    return sorted(found, key=lambda pair: (places[pair[0]], places[pair[1]]))


def door_faults(site: Site) -> Iterator[tuple[str, str]]:
    """Yield doors that join no two regions, or regions that do not touch there."""
    if len(site.doors) > MOST_DOORS:
        yield "doors", f"expected at most {MOST_DOORS} doors, got {len(site.doors)}"
        return
    for number, door in enumerate(site.doors):
        unknown = [region for region in door.between if region not in site.regions]
        for region in unknown:
            yield f"doors[{number}].between", f"expected regions of this site, got `{region}`"
        if not unknown:
            yield from _door(site, number, door)


def _door(site: Site, number: int, door: Door) -> Iterator[tuple[str, str]]:
    first, second = door.between
    one, other = site.regions[first], site.regions[second]
    if first == second:
        yield f"doors[{number}].between", f"expected two regions, got `{first}` twice"
        return
    if one.map != other.map:
        yield f"doors[{number}].between", "expected regions of one map"
        return
    sides = {region: side_of(door.at, site.regions[region].points) for region in door.between}
    outside = [region for region, side in sides.items() if side is Side.OUTSIDE]
    for region in outside:
        yield f"doors[{number}].at", f"expected a point on the edge of `{region}`"
    if one.floor == other.floor and not outside and Side.EDGE not in sides.values():
        yield f"doors[{number}].at", f"expected a point on the edge of `{first}` or `{second}`"


def _sound(model: Region) -> bool:
    """True when the corners make a simple polygon; other shapes are not compared."""
    return doubled_area(model.points) != 0 and is_simple(model.points)


def _one_floor(one: Region, other: Region) -> bool:
    return (one.map, one.floor) == (other.map, other.floor)


def _pair(first: RegionId, second: RegionId) -> tuple[RegionId, RegionId]:
    return (first, second) if first < second else (second, first)
