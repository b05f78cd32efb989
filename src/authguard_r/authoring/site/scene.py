# SPDX-License-Identifier: Apache-2.0
"""A scene graph as a draft site: named places at coordinates, and what is connected.

A graph has points where a site has areas. Each region becomes a square around its point, small
enough that no two come near; each connection becomes a narrow way of its own between two squares,
with a door at each end. What cannot be drawn without an overlap is refused: the importer does not
guess where a robot may drive. How-to: docs/howto/site.md#import
"""

from __future__ import annotations

import json
from fractions import Fraction
from typing import Any, Literal, NoReturn

from msgspec import Struct

from authguard_r.authoring.site.proposal import (
    UNKNOWN_MASS_G,
    SiteProposal,
    identifier,
    millimeters,
)
from authguard_r.core.errors import MalformedError
from authguard_r.core.geometry import Point
from authguard_r.core.identifiers import Identifier, ObjectId, RegionId
from authguard_r.site.check import UNREVIEWED, faults
from authguard_r.site.model import Door, ObjectModel, Region, Site
from authguard_r.site.names import shown, skeleton
from authguard_r.site.strict import convert

#: Most regions, objects and connections of each kind; a graph is compared pair by pair.
MOST = 500
#: Half the side of the smallest square, and the least width of a way.
_LEAST_MM = 100
_LEAST_WAY_MM = 10
_MAP = "map"


class _Node(Struct, frozen=True, forbid_unknown_fields=True):
    """A named point; its coordinates are checked one by one, for their place."""

    name: str
    coords: tuple[Any, Any]
    type: Literal["object", "region"] | None = None


class _SceneFile(Struct, frozen=True, forbid_unknown_fields=True):
    """The file. `extra` is for variants of the scene, and is not part of it."""

    regions: tuple[_Node, ...]
    objects: tuple[_Node, ...] = ()
    object_connections: tuple[tuple[str, str], ...] = ()
    region_connections: tuple[tuple[str, str], ...] = ()
    current_location: str | None = None
    extra_safe_objects: tuple[Any, ...] = ()
    extra_unsafe_objects: tuple[Any, ...] = ()
    extra_safe_regions: tuple[Any, ...] = ()
    extra_unsafe_regions: tuple[Any, ...] = ()


class _Square(Struct, frozen=True):
    """A region's square: its middle and half its side."""

    middle: Point
    half: int

    def side(self, axis: int, sign: int) -> int:
        """Return the coordinate of the side that faces up (`sign` 1) or down an axis."""
        return self.middle[axis] + sign * self.half


class _Port(Struct, frozen=True):
    """One end of a way: a stretch of a square's side.

    Args:
        axis: the axis that the side lies across.
        level: the side's coordinate on it.
        low: where the stretch begins, on the other axis.
        high: where it ends.
    """

    axis: int
    level: int
    low: int
    high: int

    def point(self, along: int) -> Point:
        """Return the point of the side's line at a coordinate of the other axis."""
        return (self.level, along) if self.axis == 0 else (along, self.level)


def import_scene(
    text: str, *, site: Identifier, floor: int, radius_mm: int, where: str
) -> SiteProposal:
    """Return the site that a scene graph describes.

    Args:
        text: the graph's JSON, from anyone.
        site: the id of the new site.
        floor: the floor that the whole graph is on; the graph does not say.
        radius_mm: half the side of a region's square, where neighbors leave that much room.
        where: the file's name, for places in messages.

    Raises:
        MalformedError: not a scene graph, a name that is unknown or taken twice, an object in two
            regions, or places and ways that would overlap; with the place.
    """
    graph = convert(_read(text, where), _SceneFile, where=where)
    for field in ("regions", "objects", "object_connections", "region_connections"):
        if len(getattr(graph, field)) > MOST:
            raise MalformedError(f"expected at most {MOST}", where=f"{where}:{field}")
    ids = _ids(graph.regions, f"{where}:regions")
    squares = _squares(graph, radius_mm, where)
    regions: dict[RegionId, Region] = {
        RegionId(ids[name]): _region(square.middle, _corners(square), (name,), floor)
        for name, square in squares.items()
    }
    doors = _ways(graph, ids, squares, regions, floor=floor, where=where)
    homes = _homes(graph, ids, where)
    things = {
        ObjectId(item): ObjectModel(
            kind=UNREVIEWED, home=homes[name], mass_g=UNKNOWN_MASS_G, names=(name,)
        )
        for name, item in _ids(graph.objects, f"{where}:objects").items()
        if name in homes
    }
    made = Site(
        schema="authguard-r/site/1",
        id=site,
        version=1,
        regions=regions,
        objects=things,
        robots={},
        vocabulary={},
        doors=doors,
    )
    for fault in faults(made):
        raise MalformedError(fault.message, where=f"{where}:{fault.where}")
    return SiteProposal(site=made, missing=tuple(_missing(graph, homes)))


def _read(text: str, where: str) -> object:
    """Return JSON without duplicate keys and numbers that are not valid."""

    def fail(what: str) -> NoReturn:
        raise MalformedError(f"expected JSON without `{shown(what)}`", where=where)

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        seen: dict[str, Any] = {}
        for key, value in pairs:
            if key in seen:
                fail(f"{key} twice")
            seen[key] = value
        return seen

    try:
        return json.loads(text, object_pairs_hook=unique, parse_constant=fail)
    except (ValueError, RecursionError) as error:
        raise MalformedError(f"expected JSON: {shown(str(error))}", where=where) from error


def _ids(nodes: tuple[_Node, ...], where: str) -> dict[str, Identifier]:
    """Return the id of each name; two names that look alike are refused."""
    made: dict[str, Identifier] = {}
    seen: dict[str, str] = {}
    for number, node in enumerate(nodes):
        place = f"{where}[{number}].name"
        made[node.name] = identifier(node.name, where=place)
        twin = seen.setdefault(skeleton(made[node.name]), node.name)
        if twin != node.name or len(made) <= number:
            raise MalformedError(
                f"expected a name that cannot be taken for `{shown(twin)}`", where=place
            )
    return made


def _squares(graph: _SceneFile, radius_mm: int, where: str) -> dict[str, _Square]:
    """Return the squares: two fifths of the way to the nearest neighbor at most.

    So a fifth of the way is left between any two, and each way has a length.
    """
    middles: dict[str, Point] = {}
    for number, node in enumerate(graph.regions):
        place = f"{where}:regions[{number}].coords"
        x, y = (millimeters(c, where=f"{place}[{axis}]") for axis, c in enumerate(node.coords))
        middles[node.name] = (x, y)
    squares: dict[str, _Square] = {}
    for number, (name, (x, y)) in enumerate(middles.items()):
        room = [
            (max(abs(x - a), abs(y - b)), other)
            for other, (a, b) in middles.items()
            if other != name
        ]
        distance, nearest = min(room, default=(radius_mm * 5, ""))
        half = min(radius_mm, distance * 2 // 5)
        if half < _LEAST_MM:
            raise MalformedError(
                f"expected room for a square of {2 * _LEAST_MM} mm"
                + (f" beside `{shown(nearest)}`" if nearest else ""),
                where=f"{where}:regions[{number}].coords",
            )
        squares[name] = _Square((x, y), half)
    return squares


def _corners(square: _Square) -> tuple[Point, ...]:
    (x, y), r = square.middle, square.half
    return ((x - r, y - r), (x + r, y - r), (x + r, y + r), (x - r, y + r))


def _region(
    approach: Point, points: tuple[Point, ...], names: tuple[str, ...], floor: int
) -> Region:
    return Region(
        map=_MAP, floor=floor, points=points, approach=approach, tags=(UNREVIEWED,), names=names
    )


def _ways(
    graph: _SceneFile,
    ids: dict[str, Identifier],
    squares: dict[str, _Square],
    regions: dict[RegionId, Region],
    *,
    floor: int,
    where: str,
) -> tuple[Door, ...]:
    """Add a region for each connection to `regions`, and return the doors at its ends."""
    pairs = _pairs(graph, squares, where)
    ports = _ports(pairs, squares, where)
    doors: list[Door] = []
    for number, (first, second) in enumerate(pairs, 1):
        one, other = ports[first, second], ports[second, first]
        way = RegionId(f"way-{number}")
        if way in regions:
            raise MalformedError(f"expected no region with the id `{way}`", where=where)
        corners = (
            one.point(one.low), other.point(other.low), other.point(other.high), one.point(one.high)
        )  # fmt: skip
        middle = (sum(x for x, _ in corners) // 4, sum(y for _, y in corners) // 4)
        regions[way] = _region(middle, corners, (), floor)
        for name, port in ((first, one), (second, other)):
            at = port.point((port.low + port.high) // 2)
            doors.append(Door(between=(RegionId(ids[name]), way), at=at))
    return tuple(doors)


def _pairs(
    graph: _SceneFile, squares: dict[str, _Square], where: str
) -> dict[tuple[str, str], str]:
    """Return each connection once, whichever way round it is written, with its place."""
    pairs: dict[tuple[str, str], str] = {}
    for number, (first, second) in enumerate(graph.region_connections):
        place = f"{where}:region_connections[{number}]"
        for name in (first, second):
            if name not in squares:
                raise MalformedError(
                    f"expected a region of this graph, got `{shown(name)}`", where=place
                )
        if first == second:
            raise MalformedError(f"expected two regions, got `{shown(first)}` twice", where=place)
        if (second, first) not in pairs:
            pairs.setdefault((first, second), place)
    return pairs


def _ports(
    pairs: dict[tuple[str, str], str], squares: dict[str, _Square], where: str
) -> dict[tuple[str, str], _Port]:
    """Return where each way leaves its two squares: for (from, to), a stretch of `from`'s side.

    The ways that leave by one side get equal parts of it, in the order of their directions, so
    that they fan out; each takes the middle half of its part.
    """
    sides: dict[tuple[str, int, int], list[tuple[Fraction, str]]] = {}
    for first, second in (*pairs, *((b, a) for a, b in pairs)):
        delta = [squares[second].middle[axis] - squares[first].middle[axis] for axis in (0, 1)]
        axis = 0 if abs(delta[0]) >= abs(delta[1]) else 1
        slope = Fraction(delta[1 - axis], abs(delta[axis]))
        sign = 1 if delta[axis] > 0 else -1
        sides.setdefault((first, axis, sign), []).append((slope, second))
    ports: dict[tuple[str, str], _Port] = {}
    for (name, axis, sign), targets in sides.items():
        square, count = squares[name], len(targets)
        for number, (_, target) in enumerate(sorted(targets)):
            begin, length = square.side(1 - axis, -1), 2 * square.half
            low = begin + length * (4 * number + 1) // (4 * count)
            high = begin + length * (4 * number + 3) // (4 * count)
            if high - low < _LEAST_WAY_MM:
                raise MalformedError(
                    f"expected fewer connections on one side of `{shown(name)}`",
                    where=pairs.get((name, target)) or pairs.get((target, name), where),
                )
            ports[name, target] = _Port(axis, square.side(axis, sign), low, high)
    return ports


def _homes(graph: _SceneFile, ids: dict[str, Identifier], where: str) -> dict[str, RegionId]:
    """Return the region that each object is in; one that no connection places has none."""
    things = {node.name for node in graph.objects}
    homes: dict[str, RegionId] = {}
    for number, (item, region) in enumerate(graph.object_connections):
        place = f"{where}:object_connections[{number}]"
        if item not in things or region not in ids:
            raise MalformedError(
                f"expected an object and then a region of this graph, got `{shown(item)}` and "
                f"`{shown(region)}`",
                where=place,
            )
        home = RegionId(ids[region])
        if homes.setdefault(item, home) != home:
            raise MalformedError(f"expected one region for `{shown(item)}`", where=place)
    return homes


def _missing(graph: _SceneFile, homes: dict[str, RegionId]) -> list[str]:
    """Return what the graph does not say, or says of something else."""
    lines = [
        "regions: draw each as it is; every tag says `unreviewed`",
        "regions way-*: straight ways between connected regions, not surveyed",
        "robots: none; add each with its profile and home",
        "vocabulary: empty; add `words: standard`, or the types that the robots can do",
    ]
    if homes:
        lines.append("objects: say the kind of each, and weigh it")
    lines += [
        f"objects: `{shown(node.name)}` left out, no connection places it"
        for node in graph.objects
        if node.name not in homes
    ]
    extras = ("safe_objects", "unsafe_objects", "safe_regions", "unsafe_regions")
    lines += [
        f"extra_{field}: left out, no part of the scene"
        for field in extras
        if getattr(graph, f"extra_{field}")
    ]
    if graph.current_location is not None:
        lines.append("current_location: left out, a robot's home is the author's to say")
    return lines
