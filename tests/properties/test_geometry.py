# SPDX-License-Identifier: Apache-2.0
"""The exact geometry says what shapely says, on more than 100,000 random cases, touches included.

Small coordinates make corners, edges and collinear legs meet by chance, as walls and doors do.
Shapely's predicates are exact; its distances are floats, so a case whose distance is within a
hair of the margin is left out, counted, and held to few.
"""

from __future__ import annotations

import math
import os
import random
from itertools import pairwise

import numpy as np
import shapely

from authguard_r.core.geometry import Point, Polygon, may_lie_in, polygon

SEED = os.environ.get("AUTHGUARD_SEED", "geometry")
HAIR = 1e-9
POLYGONS, POINTS, PATHS = 700, 160, 40


def a_polygon(dice: random.Random, size: int) -> tuple[Point, ...]:
    """Return a simple polygon: a star around a point, a room, or corners of a small grid."""
    while True:
        kind = dice.randrange(3)
        if kind == 0:
            angles = sorted(dice.uniform(0, 2 * math.pi) for _ in range(dice.randint(3, 12)))
            points = tuple(
                (round(math.cos(a) * r), round(math.sin(a) * r))
                for a in angles
                for r in (dice.uniform(size / 5, size),)
            )
        elif kind == 1:
            x, y = dice.randint(-size, size), dice.randint(-size, size)
            w, h = dice.randint(1, size), dice.randint(1, size)
            points = ((x, y), (x + w, y), (x + w, y + h), (x, y + h))
        else:
            points = tuple(
                (dice.randint(0, 5), dice.randint(0, 5)) for _ in range(dice.randint(3, 7))
            )
        shape = shapely.Polygon(points)
        if len(set(points)) == len(points) and shape.is_valid and shape.area > 0:
            return points if dice.random() < 0.5 else points[::-1]


def cases(seed: str) -> list[tuple[random.Random, Polygon, shapely.Polygon, int]]:
    dice = random.Random(f"{SEED} {seed}")
    made = []
    for _ in range(POLYGONS):
        size = dice.choice([3, 8, 100, 10_000, 1_000_000])
        points = a_polygon(dice, size)
        made.append((dice, polygon("main", 1, points), shapely.Polygon(points), size))
    return made


def a_point(dice: random.Random, area: Polygon, size: int) -> Point:
    """Return a point near the polygon, now and then a corner or a point on an edge's line."""
    kind = dice.randrange(4)
    if kind == 0:
        return dice.choice(area.points)
    if kind == 1:
        a, b = dice.choice(list(pairwise((*area.points, area.points[0]))))
        step = math.gcd(b[0] - a[0], b[1] - a[1])
        n = dice.randint(-1, step + 1)
        return (a[0] + (b[0] - a[0]) // step * n, a[1] + (b[1] - a[1]) // step * n)
    return (dice.randint(-size - 2, size + 7), dice.randint(-size - 2, size + 7))


def test_where_a_pose_may_lie_is_where_shapely_says() -> None:
    compared = left_out = inside = touching = 0
    for dice, area, shape, size in cases("points"):
        margins = [0, 0, 1, size // 3, size]
        given = [(a_point(dice, area, size), dice.choice(margins)) for _ in range(POINTS)]
        points = shapely.points(np.array([p for p, _ in given], dtype=float))
        meets, distances = shapely.intersects(shape, points), shapely.distance(shape, points)
        touches = shapely.touches(shape, points)
        for (point, margin), meet, distance, touch in zip(
            given, meets, distances, touches, strict=True
        ):
            if margin and abs(distance - margin) <= HAIR * max(1, margin):
                left_out += 1
                continue
            wanted = bool(meet) if margin == 0 else bool(distance <= margin)
            assert may_lie_in(area, point, margin) is wanted, (area.points, point, margin)
            compared += 1
            inside += wanted
            touching += bool(touch)
    assert compared >= 100_000
    assert left_out < compared // 10
    assert inside > compared // 10
    assert touching > compared // 10
