# SPDX-License-Identifier: Apache-2.0
"""Where a way may lead, and where a robot comes to rest, in exact integers.

Spec page: docs/spec/state.md#place
"""

from __future__ import annotations

from itertools import pairwise

from authguard_r.core.geometry import Point, Polygon, comes_within, edges_of, may_lie_in
from authguard_r.site.shapes import side


def may_cross(area: Polygon, path: tuple[Point, ...], margin_mm: int) -> bool:
    """True when some position within `margin_mm` of the path lies in the polygon or on its edge.

    Args:
        area: the polygon; map and floor are the caller's to compare.
        path: corners of the way in order, at least one.
        margin_mm: how far from the way the robot may be.
    """
    if any(may_lie_in(area, point, margin_mm) for point in path):
        return True
    return any(_near(leg, edge, margin_mm) for leg in pairwise(path) for edge in edges_of(area))


def stopping_margin(margin_mm: int, speed_mm_s: int, *, reaction_ms: int, brake_mm_s2: int) -> int:
    """Return how far from its pose a robot may come to rest, in millimeters, rounded up.

    Args:
        margin_mm: of the pose itself.
        speed_mm_s: the speed at which it is told to stop; its sign does not matter.
        reaction_ms: time until the brakes act.
        brake_mm_s2: deceleration, positive.
    """
    speed = abs(speed_mm_s)
    return margin_mm - (-speed * reaction_ms // 1_000) - (-speed * speed // (2 * brake_mm_s2))


def _near(leg: tuple[Point, Point], edge: tuple[Point, Point], margin_mm: int) -> bool:
    """True when two segments cross or an end of the edge comes within the margin of the leg."""
    (a, b), (c, d) = leg, edge
    if side(a, b, c) != side(a, b, d) and side(c, d, a) != side(c, d, b):
        return True
    return comes_within(a, b, c, margin_mm) or comes_within(a, b, d, margin_mm)
