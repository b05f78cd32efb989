# SPDX-License-Identifier: Apache-2.0
"""Transforms lead from a child to a frame, or it is said why not: on plain numbers.

Spec page: docs/spec/ros-position.md#transforms
"""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from authguard_r.integrations.ros.position import MS, DoubtCause
from authguard_r.integrations.ros.transforms import (
    MAX_FRAMES,
    FramePath,
    Frames,
    Placed,
    Quaternion,
    Vector,
    fault_of,
)

HERE = Placed(Vector(0.0, 0.0, 0.0), Quaternion(0.0, 0.0, 0.0, 1.0))


def placed(x: float, y: float, turn: float = 0.0) -> Placed:
    return Placed(Vector(x, y, 0.0), Quaternion(0.0, 0.0, math.sin(turn / 2), math.cos(turn / 2)))


def put(
    frames: Frames, child: str, parent: str, where: Placed = HERE, ms: int = 1, who: bytes = b"a"
) -> DoubtCause | None:
    return frames.put(child, parent, where, who=who, stamp_ns=ms * MS, arrived_ns=ms * MS)


def way(frames: Frames) -> FramePath | DoubtCause:
    return frames.way("map", "base")


def test_a_way_is_composed_and_as_old_as_its_oldest_part() -> None:
    frames = Frames()
    assert put(frames, "odom", "map", placed(10, 0, math.pi / 2), ms=3) is None
    assert put(frames, "foot", "odom", placed(2, 1), ms=7) is None
    assert frames.put_static("base", "foot", placed(0.5, 0)) is None
    found = way(frames)
    assert isinstance(found, FramePath)
    assert (found.at.x, found.at.y) == (pytest.approx(9), pytest.approx(2.5))
    assert (found.oldest_ns, found.newest_ns) == (3 * MS, 7 * MS)


numbers = st.floats(-100, 100)


@given(numbers, numbers, st.floats(-math.pi, math.pi), numbers, numbers)
def test_a_turn_is_the_plane_s(x: float, y: float, turn: float, a: float, b: float) -> None:
    frames = Frames()
    put(frames, "odom", "map", placed(x, y, turn))
    put(frames, "base", "odom", placed(a, b, 1.0))
    found = way(frames)
    assert isinstance(found, FramePath)
    wanted = complex(x, y) + complex(a, b) * complex(math.cos(turn), math.sin(turn))
    assert abs(complex(found.at.x, found.at.y) - wanted) < 1e-9
    assert found.at.z == 0.0


def test_no_way_a_circle_and_a_way_that_nothing_moves_on_are_none() -> None:
    frames = Frames()
    assert way(frames) is DoubtCause.NO_WAY
    put(frames, "base", "odom")
    assert way(frames) is DoubtCause.NO_WAY
    assert frames.on_way("map", "base") == {"base", "odom"}
    put(frames, "odom", "base")
    assert way(frames) is DoubtCause.CYCLE
    assert frames.on_way("map", "base") == {"base", "odom"}
    still = Frames()
    still.put_static("base", "map", HERE)
    assert way(still) is DoubtCause.NO_WAY


def test_a_child_has_one_publisher_and_one_parent() -> None:
    frames = Frames()
    put(frames, "base", "map")
    assert put(frames, "base", "map", ms=2, who=b"b") is DoubtCause.ANOTHER
    assert way(frames) is DoubtCause.NO_WAY
    put(frames, "base", "map", ms=3)
    assert put(frames, "base", "odom", ms=4) is DoubtCause.ANOTHER
    frames.put_static("base", "map", HERE)
    assert put(frames, "base", "map", ms=5) is DoubtCause.ANOTHER


def test_what_never_changes_changes_not() -> None:
    frames = Frames()
    assert frames.put_static("base", "map", HERE) is None
    assert frames.put_static("base", "map", HERE) is None
    assert frames.put_static("base", "map", placed(1, 0)) is DoubtCause.ANOTHER
    assert way(frames) is DoubtCause.NO_WAY
    assert frames.put_static("base", "map", placed(math.nan, 0)) is DoubtCause.NOT_FINITE


def test_a_repetition_makes_nothing_fresh_and_another_place_at_one_time_is_none() -> None:
    frames = Frames()
    put(frames, "base", "map", ms=1)
    assert frames.put("base", "map", HERE, who=b"a", stamp_ns=MS, arrived_ns=900 * MS) is None
    found = way(frames)
    assert isinstance(found, FramePath)
    assert found.newest_ns == MS
    assert put(frames, "base", "map", placed(1, 0), ms=1) is DoubtCause.STILL
    assert way(frames) is DoubtCause.NO_WAY
    put(frames, "base", "map", ms=9)
    assert put(frames, "base", "map", ms=8) is DoubtCause.BACK
    assert way(frames) is DoubtCause.NO_WAY


def test_a_place_that_is_none_is_not_kept() -> None:
    frames = Frames()
    put(frames, "base", "map")
    assert put(frames, "base", "map", placed(math.inf, 0), ms=2) is DoubtCause.NOT_FINITE
    assert way(frames) is DoubtCause.NO_WAY
    crooked = Placed(Vector(0, 0, 0), Quaternion(0, 0, 0.1, 1))
    assert put(frames, "base", "map", crooked, ms=3) is DoubtCause.NOT_UNIT
    assert fault_of(crooked) is DoubtCause.NOT_UNIT
    assert fault_of(HERE) is None


def test_no_more_frames_are_kept_than_a_robot_has() -> None:
    frames = Frames()
    for number in range(MAX_FRAMES):
        assert put(frames, f"f{number}", "map") is None
    assert put(frames, "base", "map") is DoubtCause.TOO_MUCH
    assert frames.put_static("base", "map", HERE) is DoubtCause.TOO_MUCH
    assert put(frames, "f0", "map", ms=2) is None
