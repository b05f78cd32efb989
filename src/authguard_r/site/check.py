# SPDX-License-Identifier: Apache-2.0
"""Every fault of a site model with its place, so that an author mends them in one round."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from msgspec import Struct

from authguard_r.core.geometry import may_lie_in, polygon
from authguard_r.site.model import Site

_SKELETON = str.maketrans("", "", "_.:-")


class Fault(Struct, frozen=True):
    """One thing to mend: where, and what is expected there."""

    where: str
    message: str


def faults(site: Site) -> tuple[Fault, ...]:
    """Return every fault of the model, in the order of its parts; none when it is sound."""
    return tuple(
        Fault(where, message)
        for part in (_twins, _names, _regions, _doors, _objects, _vocabulary, _robots)
        for where, message in part(site)
    )


def _twins(site: Site) -> Iterator[tuple[str, str]]:
    """Ids that a person would take for each other (L2)."""
    groups: dict[str, Iterable[str]] = {
        "regions": site.regions,
        "objects": site.objects,
        "robots": site.robots,
        "vocabulary": site.vocabulary,
    }
    for group, ids in groups.items():
        seen: dict[str, str] = {}
        for item in ids:
            twin = seen.setdefault(skeleton(item), item)
            if twin != item:
                yield f"{group}.{item}", f"expected an id that cannot be taken for `{twin}`"


def _names(site: Site) -> Iterator[tuple[str, str]]:
    """One spelling, one thing."""
    named: list[tuple[str, str, tuple[str, ...]]] = [
        ("regions", region, model.names) for region, model in site.regions.items()
    ]
    named += [("objects", item, thing.names) for item, thing in site.objects.items()]
    seen: dict[tuple[str, str], str] = {}
    for group, item, names in named:
        for name in (item, *names):
            owner = seen.setdefault((group, name), item)
            if owner != item:
                yield f"{group}.{item}.names", f"expected a name other than `{name}` of `{owner}`"


def _regions(site: Site) -> Iterator[tuple[str, str]]:
    for region, model in site.regions.items():
        area = polygon(model.map, model.floor, model.points)
        if _doubled_area(model.points) == 0:
            yield f"regions.{region}.points", "expected corners that enclose an area"
        elif not _is_simple(model.points):
            yield f"regions.{region}.points", "expected edges that do not cross or touch"
        elif not may_lie_in(area, model.approach, 0):
            yield f"regions.{region}.approach", "expected a point inside the region"
        if list(model.tags) != sorted(set(model.tags)) or not model.tags:
            yield f"regions.{region}.tags", "expected a sorted set of at least one tag"


def _doors(site: Site) -> Iterator[tuple[str, str]]:
    for number, door in enumerate(site.doors):
        for region in door.between:
            model = site.regions.get(region)
            if model is None:
                yield f"doors[{number}].between", f"expected regions of this site, got `{region}`"
            elif not may_lie_in(polygon(model.map, model.floor, model.points), door.at, 0):
                yield f"doors[{number}].at", f"expected a point on the edge of `{region}`"


def _objects(site: Site) -> Iterator[tuple[str, str]]:
    for item, model in site.objects.items():
        if model.home not in site.regions:
            yield f"objects.{item}.home", f"expected a region of this site, got `{model.home}`"


def _vocabulary(site: Site) -> Iterator[tuple[str, str]]:
    for kind, model in site.vocabulary.items():
        place = f"vocabulary.{kind}"
        if list(model.fields) != sorted(set(model.fields)):
            yield f"{place}.fields", "expected a sorted set"
        for name, parameter in model.params.items():
            if parameter.low > parameter.high:
                yield f"{place}.params.{name}.high", "expected at least `low`"
        if model.records and "max_bytes" not in model.params:
            yield f"{place}.params", "expected `max_bytes`: a recording type says how much at most"
        if (model.stores or model.transmits) and not model.records:
            yield f"{place}.records", "expected true for a type that stores or transmits"


def _robots(site: Site) -> Iterator[tuple[str, str]]:
    for rid, robot in site.robots.items():
        if robot.home not in site.regions:
            yield f"robots.{rid}.home", f"expected a region of this site, got `{robot.home}`"
        for kind, tools in robot.profile.tools.items():
            place = f"robots.{rid}.profile.tools.{kind}"
            if kind not in site.vocabulary:
                yield place, "expected an action type of the vocabulary"
            if list(tools) != sorted(set(tools)) or not tools:
                yield place, "expected a sorted set of at least one tool"


def _doubled_area(points: tuple[tuple[int, int], ...]) -> int:
    pairs = zip(points, points[1:] + points[:1], strict=True)
    return sum(ax * by - bx * ay for (ax, ay), (bx, by) in pairs)


def skeleton(identifier: str) -> str:
    """Return the identifier without `_.:-`.

    Two ids with equal skeletons (`room-1`, `room_1`) look alike to a person who reviews a
    mission, so a site model may not hold both (L2).
    """
    return identifier.translate(_SKELETON)


def _is_simple(points: tuple[tuple[int, int], ...]) -> bool:
    """True when edges meet only at the corner that two neighbors share."""
    edges = list(zip(points, points[1:] + points[:1], strict=True))
    count = len(edges)
    for i, (a, b) in enumerate(edges):
        for j in range(i + 1, count):
            c, d = edges[j]
            if j == i + 1 or (i == 0 and j == count - 1):
                shared, far = (b, d) if j == i + 1 else (a, c)
                other = a if j == i + 1 else b
                if _side(other, shared, far) == 0 and _between(other, far, shared):
                    return False
            elif _touch(a, b, c, d):
                return False
    return True


def _touch(a: tuple[int, int], b: tuple[int, int], c: tuple[int, int], d: tuple[int, int]) -> bool:
    """True when two segments have a point in common."""
    first, second = _side(a, b, c), _side(a, b, d)
    third, fourth = _side(c, d, a), _side(c, d, b)
    if first != second and third != fourth:
        return True
    on = ((first, a, b, c), (second, a, b, d), (third, c, d, a), (fourth, c, d, b))
    return any(side == 0 and _on(p, q, r) for side, p, q, r in on)


def _side(a: tuple[int, int], b: tuple[int, int], p: tuple[int, int]) -> int:
    cross = (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])
    return (cross > 0) - (cross < 0)


def _on(a: tuple[int, int], b: tuple[int, int], p: tuple[int, int]) -> bool:
    """True when a point of the segment's line lies between its ends."""
    return min(a[0], b[0]) <= p[0] <= max(a[0], b[0]) and min(a[1], b[1]) <= p[1] <= max(a[1], b[1])


def _between(p: tuple[int, int], q: tuple[int, int], corner: tuple[int, int]) -> bool:
    """True when two collinear edges leave their common corner in the same direction."""
    return (p[0] - corner[0]) * (q[0] - corner[0]) + (p[1] - corner[1]) * (q[1] - corner[1]) > 0
