# SPDX-License-Identifier: Apache-2.0
"""Contained, overlapping, sharing an edge: exact, and what a second implementation says."""

from __future__ import annotations

import math
import random
from itertools import pairwise
from typing import Any

import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from authguard_r.site.shapes import (
    Side,
    contains,
    doubled_area,
    is_simple,
    overlap,
    shared_edges,
    side_of,
)
from fixtures.amount import amount
from fixtures.cases import case

SQUARE = ((0, 0), (10, 0), (10, 10), (0, 10))
#: A room with a bay: the notch at the top runs from 4 to 6, down to 5.
BAY = ((0, 0), (10, 0), (10, 10), (6, 10), (6, 5), (4, 5), (4, 10), (0, 10))


def moved(points: Any, x: int, y: int) -> Any:
    return tuple((a + x, b + y) for a, b in points)


def around(points: list[tuple[int, int]]) -> Any:
    """Return the points in the order of their direction from their middle: mostly simple."""
    x = sum(x for x, _ in points) / len(points)
    y = sum(y for _, y in points) / len(points)
    return tuple(sorted(points, key=lambda p: (math.atan2(p[1] - y, p[0] - x), p)))


@st.composite
def outlines(draw: st.DrawFn) -> Any:
    """A simple polygon with corners on a small grid, so that corners and edges often coincide."""
    count = draw(st.integers(3, 7))
    corner = st.tuples(st.integers(0, 8), st.integers(0, 8))
    points = around(draw(st.lists(corner, min_size=count, max_size=count, unique=True)))
    assume(doubled_area(points) != 0 and is_simple(points))
    return points


def random_outline(dice: random.Random) -> Any:
    while True:
        points = tuple((dice.randrange(9), dice.randrange(9)) for _ in range(dice.randrange(3, 8)))
        if len(set(points)) == len(points) and doubled_area(points) != 0 and is_simple(points):
            return points


@settings(max_examples=amount(60, 300))
@given(st.lists(st.tuples(st.integers(0, 6), st.integers(0, 6)), min_size=3, max_size=7))
def test_an_outline_is_simple_when_shapely_says_so(corners: list[tuple[int, int]]) -> None:
    points = tuple(corners)
    ring = shapely.LinearRing([*points, points[0]])
    assume(all(a != b for a, b in pairwise([*points, points[0]])))
    assert (doubled_area(points) != 0 and is_simple(points)) == shapely.Polygon(ring).is_valid


@settings(max_examples=amount(60, 300))
@given(outlines(), outlines())
def test_overlap_and_containment_are_shapely_s_on_random_polygons(one: Any, other: Any) -> None:
    first, second = shapely.Polygon(one), shapely.Polygon(other)
    assert overlap(one, other) == shapely.relate_pattern(first, second, "T********")
    assert contains(one, other) == shapely.covers(first, second)


def test_overlap_and_containment_are_shapely_s_on_thousands_of_pairs() -> None:
    dice = random.Random(3)
    shapes = [random_outline(dice) for _ in range(200)]
    found = {"overlap": 0, "inside": 0, "edges": 0}
    large = [tuple((5 * x, 5 * y) for x, y in shape) for shape in shapes[:50]]
    turns = amount(2_000, 10_000)
    for turn in range(turns):
        one = dice.choice(large if turn % 2 else shapes)
        other = moved(dice.choice(shapes), *dice.choices(range(-9, 30 if turn % 2 else 9), k=2))
        first, second = shapely.Polygon(one), shapely.Polygon(other)
        assert overlap(one, other) == shapely.relate_pattern(first, second, "T********")
        assert contains(one, other) == shapely.covers(first, second)
        common = shapely.intersection(first.boundary, second.boundary).length
        told = sum(shapely.LineString(edge).length for edge in shared_edges(one, other))
        assert told == pytest.approx(common, abs=1e-9)
        found["overlap"] += overlap(one, other)
        found["inside"] += contains(one, other)
        found["edges"] += told > 0
    assert all(count > turns // 500 for count in found.values()), found


@settings(max_examples=amount(40, 200))
@given(outlines(), outlines())
def test_overlap_is_mutual_and_a_polygon_overlaps_itself_however_it_is_written(
    one: Any, other: Any
) -> None:
    assert overlap(one, other) == overlap(other, one)
    assert shared_edges(one, other) == shared_edges(other, one)
    assert overlap(one, one[::-1])
    assert contains(one, one[1:] + one[:1])


def test_rooms_that_share_a_wall_do_not_overlap_and_one_millimeter_more_does() -> None:
    assert not overlap(SQUARE, moved(SQUARE, 10, 0))
    assert not overlap(SQUARE, moved(SQUARE, 10, 10))
    assert overlap(SQUARE, moved(SQUARE, 9, 0))
    assert overlap(SQUARE, moved(SQUARE, 9, 9))


def test_far_from_the_origin_nothing_is_rounded() -> None:
    """Where floats could not tell one millimeter any more."""
    far = 9_007_199_254_740_000
    assert not overlap(moved(SQUARE, far, far), moved(SQUARE, far + 10, far))
    assert overlap(moved(SQUARE, far, far), moved(SQUARE, far + 9, far))
    assert contains(moved(SQUARE, far, far), moved(SQUARE, far, far))
    assert not contains(moved(SQUARE, far, far), moved(SQUARE, far + 1, far))


def test_a_bay_is_outside_although_its_corners_are_on_the_edge() -> None:
    bay = ((4, 5), (6, 5), (6, 10), (4, 10))
    assert not contains(BAY, bay)
    assert not overlap(BAY, bay)
    assert contains(SQUARE, BAY)
    assert shared_edges(BAY, bay) == (((4, 5), (4, 10)), ((4, 5), (6, 5)), ((6, 5), (6, 10)))


def test_the_same_room_with_more_corners_along_its_walls_is_the_same_room() -> None:
    longer = ((0, 0), (5, 0), (10, 0), (10, 10), (3, 10), (0, 10), (0, 7))
    assert overlap(SQUARE, longer)
    assert contains(SQUARE, longer)
    assert contains(longer, SQUARE)


def test_a_point_is_inside_on_the_edge_or_outside() -> None:
    for point, side in [
        ((5, 2), Side.INSIDE),
        ((5, 7), Side.OUTSIDE),
        ((5, 5), Side.EDGE),
        ((4, 10), Side.EDGE),
        ((0, 10), Side.EDGE),
        ((11, 5), Side.OUTSIDE),
        ((-1, 5), Side.OUTSIDE),
        ((-1, 10), Side.OUTSIDE),
    ]:
        with case(point, side):
            assert side_of(point, BAY) is side
