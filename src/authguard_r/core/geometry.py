# SPDX-License-Identifier: Apache-2.0
"""Which regions an uncertain position may lie in, in exact integers.

Floats never decide authority: a rounding error at a wall would. All coordinates are millimeters.
Spec page: docs/spec/state.md#place
"""

from __future__ import annotations

from msgspec import Struct

Point = tuple[int, int]


class Polygon(Struct, frozen=True):
    """A simple polygon on one floor of one map, with its bounding box.

    Args:
        map: the map whose frame the coordinates are in.
        floor: the floor; two floors never share a region.
        points: corners in order, at least three, not closed.
    """

    map: str
    floor: int
    points: tuple[Point, ...]
    low: Point
    high: Point


def polygon(map_id: str, floor: int, points: tuple[Point, ...]) -> Polygon:
    """Return the polygon with its bounding box worked out."""
    xs = [x for x, _ in points]
    ys = [y for _, y in points]
    return Polygon(map_id, floor, points, (min(xs), min(ys)), (max(xs), max(ys)))


def may_lie_in(area: Polygon, point: Point, margin_mm: int) -> bool:
    """True when some position within `margin_mm` of `point` lies in the polygon or on its edge.

    Wrong reading: true does not mean the robot is inside; it means that it may be.
    """
    (x, y), low, high, far = point, area.low, area.high, margin_mm
    if not (low[0] - far <= x <= high[0] + far and low[1] - far <= y <= high[1] + far):
        return False
    edges = edges_of(area)
    return _inside(edges, point) or any(comes_within(a, b, point, margin_mm) for a, b in edges)


def must_lie_in(area: Polygon, point: Point, margin_mm: int) -> bool:
    """True when every position within `margin_mm` of `point` lies inside the polygon's edge."""
    edges = edges_of(area)
    return _inside(edges, point) and not any(comes_within(a, b, point, margin_mm) for a, b in edges)


def edges_of(area: Polygon) -> list[tuple[Point, Point]]:
    """Return the polygon's edges in order, the closing one last."""
    return list(zip(area.points, area.points[1:] + area.points[:1], strict=True))


def _inside(edges: list[tuple[Point, Point]], point: Point) -> bool:
    """Even-odd rule on integers; the edge itself is caught by the distance test with margin 0."""
    x, y = point
    odd = False
    for (ax, ay), (bx, by) in edges:
        if (ay > y) == (by > y):
            continue
        cross = (bx - ax) * (y - ay) - (x - ax) * (by - ay)
        if (cross > 0) == (by > ay):
            odd = not odd
    return odd


def comes_within(a: Point, b: Point, point: Point, margin_mm: int) -> bool:
    """True when the segment from `a` to `b` comes within the margin of `point`."""
    dx, dy = b[0] - a[0], b[1] - a[1]
    px, py = point[0] - a[0], point[1] - a[1]
    along = px * dx + py * dy
    length2 = dx * dx + dy * dy
    if along <= 0:
        return px * px + py * py <= margin_mm * margin_mm
    if along >= length2:
        qx, qy = point[0] - b[0], point[1] - b[1]
        return qx * qx + qy * qy <= margin_mm * margin_mm
    cross = px * dy - py * dx
    return cross * cross <= margin_mm * margin_mm * length2
