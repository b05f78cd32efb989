# SPDX-License-Identifier: Apache-2.0
"""Exact predicates on simple polygons: contained, overlapping, sharing an edge.

All corners are integers (millimeters); points in between are exact fractions, so two rooms that
share a wall touch and never overlap by a rounding error. Spec page: docs/spec/site-model.md
"""

from __future__ import annotations

from collections.abc import Iterator
from enum import IntEnum
from fractions import Fraction
from itertools import pairwise

from authguard_r.core.geometry import Point

Points = tuple[Point, ...]
Edge = tuple[Point, Point]
#: x and y over a common positive divisor: the exact point (x / d, y / d).
_Exact = tuple[int, int, int]


class Side(IntEnum):
    """Where a point lies."""

    OUTSIDE = -1
    EDGE = 0
    INSIDE = 1


def edges_of(points: Points) -> list[Edge]:
    """Return the polygon's edges in order, the closing one last."""
    return list(zip(points, points[1:] + points[:1], strict=True))


def side(a: Point, b: Point, point: Point) -> int:
    """Return 1, 0 or -1: left of, on, or right of the line from `a` to `b`."""
    cross = (b[0] - a[0]) * (point[1] - a[1]) - (b[1] - a[1]) * (point[0] - a[0])
    return (cross > 0) - (cross < 0)


def doubled_area(points: Points) -> int:
    """Return twice the signed area; positive when the corners turn left."""
    return sum(ax * by - bx * ay for (ax, ay), (bx, by) in edges_of(points))


def is_simple(points: Points) -> bool:
    """True when edges meet only at the corner that two neighbors share."""
    edges = edges_of(points)
    order = sorted(range(len(edges)), key=lambda number: min(edges[number]))
    near: list[int] = []  # a sweep from left to right: only edges that may still be met
    for number in order:
        left = min(edges[number])[0]
        near = [other for other in near if max(edges[other])[0] >= left]
        if any(_collide(edges, *sorted((number, other))) for other in near):
            return False
        near.append(number)
    return True


def _collide(edges: list[Edge], i: int, j: int) -> bool:
    """True when two edges of an outline, `i` before `j`, meet where they may not."""
    (a, b), (c, d) = edges[i], edges[j]
    if j == i + 1:
        return side(a, b, d) == 0 and _ahead(a, d, b)
    if i == 0 and j == len(edges) - 1:
        return side(b, a, c) == 0 and _ahead(b, c, a)
    return _touch(a, b, c, d)


def side_of(point: Point, points: Points) -> Side:
    """Return where a point lies with respect to a simple polygon."""
    return _side((point[0], point[1], 1), points)


def contains(outer: Points, inner: Points) -> bool:
    """True when no point of the simple polygon `inner` lies outside the simple polygon `outer`."""
    return all(
        _side(point, outer) is not Side.OUTSIDE for point in _pieces(edges_of(inner), inner, outer)
    )


def overlap(first: Points, second: Points) -> bool:
    """True when two simple polygons have an area in common; a common edge is no area."""
    return _enters(first, second) or _enters(second, first) or _outline(first) == _outline(second)


def effort(edges: int, points: Points, other: Points) -> int:
    """Return about how many edges are looked at to compare so many edges with a polygon.

    Each edge is held against each near one of the other, and each stretch against all of them.
    """
    return (edges + len(_near(other, points))) * len(other)


def overlap_effort(first: Points, second: Points) -> int:
    """Return about how many edges `overlap` looks at."""
    one, two = len(_near(first, second)), len(_near(second, first))
    return (one + two) * (len(first) + len(second))


def _enters(points: Points, other: Points) -> bool:
    """True when the outline of the first runs through the inside of the other."""
    pieces = _pieces(_near(points, other), points, other)
    return any(_side(point, other) is Side.INSIDE for point in pieces)


def shared_edges(first: Points, second: Points) -> tuple[Edge, ...]:
    """Return the stretches, longer than a point, that edges of both polygons have in common.

    Each ends at corners of the two polygons, in rising order; the stretches are sorted.
    """
    found: set[Edge] = set()
    near = _near(second, first)
    for a, b in _near(first, second):
        for c, d in near:
            if side(a, b, c) == 0 == side(a, b, d):
                low, high = max(min(a, b), min(c, d)), min(max(a, b), max(c, d))
                if low < high:
                    found.add((low, high))
    return tuple(sorted(found))


def _near(points: Points, other: Points) -> list[Edge]:
    """Return the edges whose bounding box meets the other polygon's."""
    (left, right), (low, high) = ((min(c), max(c)) for c in zip(*other, strict=True))
    return [
        (a, b)
        for a, b in edges_of(points)
        if min(a[0], b[0]) <= right
        and max(a[0], b[0]) >= left
        and min(a[1], b[1]) <= high
        and max(a[1], b[1]) >= low
    ]


def _pieces(edges: list[Edge], points: Points, other: Points) -> Iterator[_Exact]:
    """Yield the middle of each stretch of these edges between meetings with the other outline.

    Between two meetings a stretch stays on one side of the other polygon, so its middle speaks for
    all of it.
    """
    against = _near(other, points)
    for a, b in edges:
        cuts = {Fraction(0), Fraction(1)}
        for c, d in against:
            cuts.update(t for t in _meetings(a, b, c, d) if 0 < t < 1)
        for low, high in pairwise(sorted(cuts)):
            t = (low + high) / 2
            n, q = t.numerator, t.denominator
            yield a[0] * q + n * (b[0] - a[0]), a[1] * q + n * (b[1] - a[1]), q


def _meetings(a: Point, b: Point, c: Point, d: Point) -> Iterator[Fraction]:
    """Yield how far along `a`-`b` (0 to 1) it meets `c`-`d`; both ends of a common stretch."""
    ux, uy, vx, vy = b[0] - a[0], b[1] - a[1], d[0] - c[0], d[1] - c[1]
    wx, wy = c[0] - a[0], c[1] - a[1]
    cross = ux * vy - uy * vx
    if cross != 0:
        if 0 <= Fraction(wx * uy - wy * ux, cross) <= 1:
            yield Fraction(wx * vy - wy * vx, cross)
    elif wx * uy == wy * ux:
        length2 = ux * ux + uy * uy
        yield Fraction(wx * ux + wy * uy, length2)
        yield Fraction((wx + vx) * ux + (wy + vy) * uy, length2)


def _side(point: _Exact, points: Points) -> Side:
    """Return where an exact point lies, by the even-odd rule on integers."""
    x, y, q = point
    odd = False
    for (ax, ay), (bx, by) in edges_of(points):
        ax, ay, bx, by = ax * q, ay * q, bx * q, by * q  # noqa: PLW2901 - on the point's scale
        cross = (bx - ax) * (y - ay) - (x - ax) * (by - ay)
        if cross == 0 and min(ax, bx) <= x <= max(ax, bx) and min(ay, by) <= y <= max(ay, by):
            return Side.EDGE
        if (ay > y) != (by > y) and (cross > 0) == (by > ay):
            odd = not odd
    return Side.INSIDE if odd else Side.OUTSIDE


def _outline(points: Points) -> frozenset[Edge]:
    """Return the outline as maximal straight stretches, without corners along them."""
    corners = [
        here
        for before, here, after in zip(
            points[-1:] + points[:-1], points, points[1:] + points[:1], strict=True
        )
        if side(before, here, after) != 0
    ]
    return frozenset((min(a, b), max(a, b)) for a, b in edges_of(tuple(corners)))


def _touch(a: Point, b: Point, c: Point, d: Point) -> bool:
    """True when two segments have a point in common."""
    first, second = side(a, b, c), side(a, b, d)
    third, fourth = side(c, d, a), side(c, d, b)
    if first != second and third != fourth:
        return True
    on = ((first, a, b, c), (second, a, b, d), (third, c, d, a), (fourth, c, d, b))
    return any(which == 0 and _on(p, q, r) for which, p, q, r in on)


def _on(a: Point, b: Point, p: Point) -> bool:
    """True when a point of the segment's line lies between its ends."""
    return min(a[0], b[0]) <= p[0] <= max(a[0], b[0]) and min(a[1], b[1]) <= p[1] <= max(a[1], b[1])


def _ahead(p: Point, q: Point, corner: Point) -> bool:
    """True when two collinear edges leave their common corner in the same direction."""
    return (p[0] - corner[0]) * (q[0] - corner[0]) + (p[1] - corner[1]) * (q[1] - corner[1]) > 0


def stopping_margin(margin_mm: int, speed_mm_s: int, *, reaction_ms: int, brake_mm_s2: int) -> int:
    """Return how far from its pose a robot may come to rest, in millimeters, rounded up.

    Args:
        margin_mm: of the pose itself.
        speed_mm_s: the speed at which it is stopped; its sign does not matter.
        reaction_ms: time until the brakes act.
        brake_mm_s2: deceleration, positive.
    """
    speed = abs(speed_mm_s)
    return margin_mm - (-speed * reaction_ms // 1_000) - (-speed * speed // (2 * brake_mm_s2))
