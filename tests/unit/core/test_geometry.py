# SPDX-License-Identifier: Apache-2.0
"""Exact integers against exact fractions: which regions an uncertain position may lie in.

The oracle (`authguard_reference.place`) measures distances in fractions and counts turns; ours
compares cross products and counts crossings. They share no line and must share every answer.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from itertools import combinations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from authguard_r.core.facts import RegionFacts, SiteFacts
from authguard_r.core.geometry import (
    Point,
    Polygon,
    may_lie_in,
    must_lie_in,
    polygon,
)
from authguard_r.core.identifiers import MAX_INTEGER
from authguard_r.core.provenance import Label
from authguard_r.core.state import Pose, Snapshot, place_of
from authguard_reference import place as oracle
from fixtures import scenarios
from fixtures.amount import amount
from fixtures.cases import case

Corners = tuple[Point, ...]
SQUARE: Corners = ((0, 0), (10, 0), (10, 10), (0, 10))
#: A U: the notch from (4, 4) to (6, 10) is outside.
NOTCHED: Corners = ((0, 0), (10, 0), (10, 10), (6, 10), (6, 4), (4, 4), (4, 10), (0, 10))


def ours(corners: Corners, point: Point, margin: int) -> bool:
    return may_lie_in(polygon("main", 1, corners), point, margin)


def theirs(corners: Corners, point: Point, margin: int) -> bool:
    return oracle.is_within(point, tuple(corners), margin)


# -- polygons --------------------------------------------------------------------------------------


def turn(a: Point, b: Point, c: Point) -> int:
    cross = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    return (cross > 0) - (cross < 0)


def on_segment(a: Point, b: Point, c: Point) -> bool:
    return (
        turn(a, b, c) == 0
        and min(a[0], b[0]) <= c[0] <= max(a[0], b[0])
        and min(a[1], b[1]) <= c[1] <= max(a[1], b[1])
    )


def meet(a: Point, b: Point, c: Point, d: Point) -> bool:
    if turn(a, b, c) * turn(a, b, d) < 0 and turn(c, d, a) * turn(c, d, b) < 0:
        return True
    return on_segment(a, b, c) or on_segment(a, b, d) or on_segment(c, d, a) or on_segment(c, d, b)


def is_simple(corners: Corners) -> bool:
    """True when sides meet at their common corners only."""
    if len(set(corners)) < len(corners):
        return False
    sides = list(zip(corners, corners[1:] + corners[:1], strict=True))
    for (one, (a, b)), (two, (c, d)) in combinations(enumerate(sides), 2):
        if two == one + 1:
            if on_segment(a, b, d) or on_segment(c, d, a):
                return False
        elif one == 0 and two == len(sides) - 1:
            if on_segment(a, b, c) or on_segment(c, d, b):
                return False
        elif meet(a, b, c, d):
            return False
    return True


def simple_polygons(pick: random.Random) -> Iterator[Corners]:
    """Yield simple polygons without end: small coordinates, so that touches are common."""
    while True:
        corners = tuple(
            (pick.randint(-12, 12), pick.randint(-12, 12)) for _ in range(pick.randint(3, 7))
        )
        if is_simple(corners):
            yield corners
        elif pick.random() < 0.05:
            wide, high = pick.randint(1, 3), pick.randint(-2, -1)
            yield tuple((x * wide - 6, y * high + 9) for x, y in pick.choice((SQUARE, NOTCHED)))


def beside(a: Point, b: Point, pick: random.Random) -> Point:
    """Return a whole point next to a segment: on it, or off by less than its neighbor is."""
    share = pick.random()
    return (
        round(a[0] + share * (b[0] - a[0])) + pick.randint(-1, 1),
        round(a[1] + share * (b[1] - a[1])) + pick.randint(-1, 1),
    )


def lattice(a: Point, b: Point) -> list[Point]:
    """Return the whole points of a segment."""
    steps = max(abs(b[0] - a[0]), abs(b[1] - a[1]), 1)
    spans = ((b[0] - a[0]), (b[1] - a[1]))
    return [
        (a[0] + spans[0] * n // steps, a[1] + spans[1] * n // steps)
        for n in range(steps + 1)
        if spans[0] * n % steps == 0 and spans[1] * n % steps == 0
    ]


def test_the_polygons_of_this_test_are_what_it_says() -> None:
    assert is_simple(SQUARE)
    assert is_simple(NOTCHED)
    assert not is_simple(((0, 0), (10, 10), (10, 0), (0, 10)))  # a bow tie
    assert not is_simple(((0, 0), (10, 0), (5, 0), (5, 5)))  # a side folded back
    assert not is_simple(((0, 0), (10, 0), (10, 10), (5, 0)))  # a corner on a side


# -- against the oracle ----------------------------------------------------------------------------


def test_ours_equals_the_oracle_on_random_polygons_points_and_margins() -> None:
    pick = random.Random(7)
    polygons = simple_polygons(pick)
    asked = touches = inside = outside = 0
    while asked < 24_000:
        corners = next(polygons)
        area = polygon("main", 1, corners)
        sides = list(zip(corners, corners[1:] + corners[:1], strict=True))
        points = [*corners, *lattice(*pick.choice(sides))]
        points += [beside(*pick.choice(sides), pick) for _ in range(8)]
        points += [(pick.randint(-16, 16), pick.randint(-16, 16)) for _ in range(4)]
        for point in points:
            margin = pick.choice((0, 0, 1, 2, 3, 5, 8))
            expected = oracle.is_within(point, tuple(corners), margin)
            assert may_lie_in(area, point, margin) is expected, (corners, point, margin)
            nearest = min(oracle.squared_distance(point, a, b) for a, b in sides)
            asked += 1
            touches += nearest == margin * margin
            inside += expected
            outside += not expected
    assert touches > 2_000  # exactly on the edge of the answer, where rounding would show
    assert min(inside, outside) > 5_000


def test_a_repeated_corner_changes_nothing() -> None:
    pick = random.Random(8)
    polygons = simple_polygons(pick)
    for _ in range(400):
        corners = next(polygons)
        at = pick.randrange(len(corners))
        doubled = (*corners[: at + 1], *corners[at:])
        point, margin = (pick.randint(-14, 14), pick.randint(-14, 14)), pick.randint(0, 3)
        assert ours(doubled, point, margin) is theirs(corners, point, margin)
        assert theirs(doubled, point, margin) is theirs(corners, point, margin)


coordinates = st.integers(-30, 30)
points = st.tuples(coordinates, coordinates)
simple = st.lists(points, min_size=3, max_size=7, unique=True).map(tuple).filter(is_simple)
LAW = settings(max_examples=amount(30, 150))


@LAW
@given(simple, points, st.integers(0, 10), st.integers(0, 6), st.booleans())
def test_where_a_polygon_begins_and_which_way_it_runs_does_not_matter(
    corners: Corners, point: Point, margin: int, start: int, backwards: bool
) -> None:
    start %= len(corners)
    other = corners[start:] + corners[:start]
    assert ours(other[::-1] if backwards else other, point, margin) is ours(corners, point, margin)


@LAW
@given(simple, points, st.integers(0, 10), st.integers(0, 3), st.booleans())
def test_turning_and_mirroring_everything_does_not_matter(
    corners: Corners, point: Point, margin: int, quarters: int, mirror: bool
) -> None:
    def moved(p: Point) -> Point:
        x, y = (-p[0], p[1]) if mirror else p
        for _ in range(quarters):
            x, y = -y, x
        return (x, y)

    turned = tuple(moved(corner) for corner in corners)
    assert ours(turned, moved(point), margin) is ours(corners, point, margin)


@LAW
@given(simple, points, st.integers(0, 10), st.integers(1, 10**9), points)
def test_scale_and_place_do_not_matter_up_to_the_largest_signed_integers(
    corners: Corners, point: Point, margin: int, scale: int, offset: Point
) -> None:
    far = 10**14
    moved = tuple((x * scale + far * offset[0], y * scale + far * offset[1]) for x, y in corners)
    assert all(abs(value) <= MAX_INTEGER for corner in moved for value in corner)
    there = (point[0] * scale + far * offset[0], point[1] * scale + far * offset[1])
    assert ours(moved, there, margin * scale) is ours(corners, point, margin)


@LAW
@given(simple, points, st.integers(0, 10), st.integers(0, 10))
def test_more_uncertainty_never_takes_a_region_away(
    corners: Corners, point: Point, margin: int, more: int
) -> None:
    if ours(corners, point, margin):
        assert ours(corners, point, margin + more)


@LAW
@given(simple, points)
def test_every_corner_and_every_whole_point_of_a_side_lies_in(
    corners: Corners, point: Point
) -> None:
    for a, b in zip(corners, corners[1:] + corners[:1], strict=True):
        assert all(ours(corners, on_side, 0) for on_side in lattice(a, b))
    assert ours(corners, point, 0) is theirs(corners, point, 0)


# -- the edge of the answer ------------------------------------------------------------------------


def test_the_edge_belongs_to_the_region_and_the_margin_is_a_circle() -> None:
    for point, margin, expected in [
        ((5, 5), 0, True),
        ((0, 0), 0, True),
        ((10, 5), 0, True),
        ((11, 5), 0, False),
        ((11, 5), 1, True),
        ((5, -1), 0, False),
        ((5, -1), 1, True),
        ((13, 14), 4, False),  # 3-4-5 to the corner at (10, 10)
        ((13, 14), 5, True),
        ((14, 14), 5, False),  # inside the grown box, outside the grown square
        ((-3, -4), 5, True),
        ((-3, -5), 5, False),
    ]:
        with case(point, margin, expected):
            assert ours(SQUARE, point, margin) is expected
            assert theirs(SQUARE, point, margin) is expected


def test_a_notch_is_outside() -> None:
    for point, margin, expected in [
        ((5, 8), 0, False),  # in the notch
        ((5, 8), 1, True),
        ((4, 8), 0, True),
        ((5, 4), 0, True),
        ((5, 10), 0, False),
        ((2, 10), 0, True),
        ((12, 10), 0, False),  # level with corners, beside the polygon
        ((-1, 4), 0, False),
        ((5, 3), 0, True),
    ]:
        with case(point, margin, expected):
            assert ours(NOTCHED, point, margin) is expected
            assert theirs(NOTCHED, point, margin) is expected


def test_a_rounding_error_at_a_wall_decides_nothing() -> None:
    """The products of these coordinates are near 1e31, where floats are 1e15 apart."""
    big = 3 * 10**15
    wall = ((0, 0), (big, 1), (big, -1))
    for y in (-1, 0, 1):
        assert ours(wall, (big, y), 0)
        assert not ours(wall, (big + 1, y), 0)
    assert not ours(wall, (big - 1, 1), 0)


def test_the_box_is_the_smallest_one() -> None:
    area = polygon("main", 2, ((3, -4), (9, 1), (-2, 6)))
    assert area == Polygon("main", 2, ((3, -4), (9, 1), (-2, 6)), (-2, -4), (9, 6))


# -- maps and floors -------------------------------------------------------------------------------


def snapshot(
    *, at: str = "main", floor: int = 1, x: int = 5, y: int = 5, margin: int = 0
) -> Snapshot:
    pose = Pose(
        map=at, floor=floor, x_mm=x, y_mm=y, margin_mm=margin, label=Label.TRUSTED_SENSOR, age_ms=0
    )
    return Snapshot(robot=scenarios.RID, epoch=1, seq=1, pose=pose)


def stacked() -> SiteFacts:
    """The same square on two floors and two maps."""
    known = scenarios.facts()
    regions = {
        f"{name}-{floor}": RegionFacts(polygon(name, floor, SQUARE), frozenset())
        for name in ("main", "annex")
        for floor in (-1, 1, 2)
    }
    return SiteFacts(
        digest=known.digest,
        robot=known.robot,
        regions=regions,
        objects={},
        vocabulary={},
    )


@pytest.mark.parametrize("floor", [-1, 1, 2])
@pytest.mark.parametrize("at", ["main", "annex"])
def test_a_pose_lies_in_regions_of_its_own_map_and_floor_only(at: str, floor: int) -> None:
    assert place_of(snapshot(at=at, floor=floor), stacked()) == {f"{at}-{floor}"}


@pytest.mark.parametrize(("at", "floor"), [("main", 0), ("main", 11), ("Main", 1), ("", 1)])
def test_a_pose_on_a_map_or_floor_that_nobody_drew_lies_nowhere(at: str, floor: int) -> None:
    assert place_of(snapshot(at=at, floor=floor), stacked()) == frozenset()
    assert place_of(snapshot(at=at, floor=floor, margin=10**6), stacked()) == frozenset()


def test_a_robot_that_is_not_localized_lies_nowhere() -> None:
    assert place_of(Snapshot(robot=scenarios.RID, epoch=1, seq=1), stacked()) == frozenset()


def test_the_place_equals_the_oracle_s_all_over_the_hospital() -> None:
    facts = scenarios.facts()
    plain = {
        "regions": {
            region: {
                "map": known.area.map,
                "floor": known.area.floor,
                "points": [list(point) for point in known.area.points],
            }
            for region, known in facts.regions.items()
        }
    }
    several = 0
    for x in range(-1000, 39_001, 1500):
        for y in range(-7000, 13_001, 1000):
            for floor, margin in ((1, 0), (1, 150), (1, 1000), (2, 150)):
                shot = snapshot(floor=floor, x=x, y=y, margin=margin)
                pose = {"map": "main", "floor": floor, "x_mm": x, "y_mm": y, "margin_mm": margin}
                found = place_of(shot, facts)
                assert found == oracle.place_of(pose, plain)
                several += len(found) > 1
    assert several > 100


def test_at_a_door_the_robot_may_be_on_both_sides() -> None:
    facts = scenarios.facts()
    assert place_of(snapshot(x=4000, y=3000), facts) == {"pharmacy", "public-corridor"}
    assert place_of(snapshot(x=4000, y=3151, margin=150), facts) == {"pharmacy"}
    assert place_of(snapshot(x=4000, y=3150, margin=150), facts) == {"pharmacy", "public-corridor"}


def test_a_pose_must_lie_where_all_of_its_margin_lies_and_the_oracle_says_so_too() -> None:
    dice = random.Random("must")
    inside = 0
    for _ in range(20_000):
        corners = (
            (0, 0),
            (dice.randint(2, 9), dice.randint(-2, 2)),
            (9, 9),
            (-1, dice.randint(3, 9)),
        )
        area, point = polygon("main", 1, corners), (dice.randint(-2, 10), dice.randint(-2, 10))
        margin = dice.randint(0, 3)
        got = must_lie_in(area, point, margin)
        assert got == oracle.is_deep(point, tuple(corners), margin)
        assert not got or may_lie_in(area, point, margin)
        inside += got
    assert inside > 2_000


ROOM, PART = ((0, 0), (100, 0), (100, 100), (0, 100)), ((20, 20), (60, 20), (60, 60), (20, 60))


@pytest.mark.parametrize(
    ("at", "margin", "wanted"),
    [
        ((40, 40), 5, {"part"}),
        ((40, 40), 19, {"part"}),
        ((40, 40), 20, {"part", "room"}),
        ((25, 40), 10, {"part", "room"}),
        ((80, 80), 5, {"room"}),
        ((64, 40), 5, {"part", "room"}),
        ((20, 40), 0, {"part", "room"}),
    ],
)
def test_only_the_inner_region_counts_once_no_doubt_is_left(
    at: Point, margin: int, wanted: set[str]
) -> None:
    regions = {
        "room": RegionFacts(polygon("main", 1, ROOM), frozenset()),
        "part": RegionFacts(polygon("main", 1, PART), frozenset(), frozenset({"room"})),
    }
    site = SiteFacts(
        digest=scenarios.facts().digest,
        robot=scenarios.facts().robot,
        regions=regions,
        objects={},
        vocabulary={},
    )
    label = Label.TRUSTED_SENSOR
    pose = Pose(
        map="main", floor=1, x_mm=at[0], y_mm=at[1], margin_mm=margin, label=label, age_ms=0
    )
    snapshot = Snapshot(robot=scenarios.RID, epoch=1, seq=1, pose=pose)
    assert place_of(snapshot, site) == wanted
    plain = {
        name: {
            "map": "main",
            "floor": 1,
            "points": [list(p) for p in known.area.points],
            "around": sorted(known.around),
        }
        for name, known in regions.items()
    }
    spoken = {"map": "main", "floor": 1, "x_mm": at[0], "y_mm": at[1], "margin_mm": margin}
    assert oracle.place_of(spoken, {"regions": plain}) == wanted
