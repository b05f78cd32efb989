# SPDX-License-Identifier: Apache-2.0
"""Values of state: fitness, guards and the place.

Transcribes docs/spec/decision.md, "Values of state": the state s of `eq:policy-set` and
`eq:auth-predicate`. Geometry is exact: integers and fractions only.
"""

from fractions import Fraction
from functools import lru_cache
from typing import Any

Json = dict[str, Any]
Point = tuple[int, int]
Polygon = tuple[Point, ...]
#: Answers on points and polygons that are kept: every row and every try asks of the same ones.
REMEMBERED = 4096


def unfit(value: Json | None, max_age_ms: int, state: Json | None, facts: Json, now: Json) -> str:
    """Find why a reading or a pose is unfit; the first that applies.

    Args:
        value: The reading or pose, None when there is none.
        max_age_ms: The age that is allowed.
        state: The snapshot with its arrival, or None.
        facts: The facts of the site and the robot.
        now: The two clocks.

    Returns:
        The reason code, or "" when the value is fit.
    """
    if state is not None and state["snapshot"]["robot"] != facts["robot"]["rid"]:
        return "STATE_FOREIGN"
    if state is None or value is None:
        return "STATE_MISSING"
    if value.get("label") != "trusted_sensor":
        return "STATE_UNTRUSTED"
    if value.get("fence", 0) < state.get("fence", 0):
        return "STATE_BEFORE_MOTION"
    age = value.get("age_ms", 0) + now["mono_ms"] - state["arrived_mono_ms"]
    if not 0 <= age <= max_age_ms:
        return "STATE_STALE"
    return ""


def reading_of(variable: str, state: Json | None) -> Json | None:
    """Look up the reading of a variable.

    Args:
        variable: Its name.
        state: The snapshot with its arrival, or None.

    Returns:
        The reading, or None.
    """
    if state is None:
        return None
    reading: Json | None = state["snapshot"].get("readings", {}).get(variable)
    return reading


def compares(left: Any, comparison: str, right: Any) -> bool:
    """Compare a reading's value with a guard's.

    Args:
        left: The reading's value.
        comparison: One of eq, ne, lt, le, gt, ge.
        right: The guard's value.

    Returns:
        True when both have the same type and compare; order is between integers only.
    """
    if type(left) is not type(right) or type(left) not in (int, bool, str):
        return False
    if comparison == "eq":
        return bool(left == right)
    if comparison == "ne":
        return bool(left != right)
    if type(left) is not int:
        return False
    ordered = {"lt": left < right, "le": left <= right, "gt": left > right, "ge": left >= right}
    return bool(ordered[comparison])


def guard_finding(guard: Json, state: Json | None, facts: Json, now: Json) -> str:
    """Evaluate one guard.

    Args:
        guard: Variable, comparison, value and max_age_ms.
        state: The snapshot with its arrival, or None.
        facts: The facts of the site and the robot.
        now: The two clocks.

    Returns:
        Why the reading is unfit, else GUARD_FALSE, or "" when the guard holds.
    """
    reading = reading_of(guard["variable"], state)
    finding = unfit(reading, guard.get("max_age_ms", 0), state, facts, now)
    if finding != "":
        return finding
    if reading is None:  # unfit says so above; this line is for the type checker
        return "STATE_MISSING"
    if not compares(reading["value"], guard["comparison"], guard["value"]):
        return "GUARD_FALSE"
    return ""


def guards_findings(guards: list[Json], state: Json | None, facts: Json, now: Json) -> list[str]:
    """Evaluate guards, each by itself.

    Args:
        guards: The guards.
        state: The snapshot with its arrival, or None.
        facts: The facts of the site and the robot.
        now: The two clocks.

    Returns:
        One code for each guard that does not hold, repeats included.
    """
    findings = [guard_finding(guard, state, facts, now) for guard in guards]
    return [finding for finding in findings if finding != ""]


def pose_of(state: Json | None) -> Json | None:
    """Look up the pose.

    Args:
        state: The snapshot with its arrival, or None.

    Returns:
        The pose, or None.
    """
    if state is None:
        return None
    pose: Json | None = state["snapshot"].get("pose")
    return pose


def place_of(pose: Json, facts: Json) -> set[str]:
    """Compute the place: every region on map and floor with a point within the margin.

    A region around another one is left out when the pose is inside the inner one, farther from its
    edge than the margin.

    Args:
        pose: A fit pose.
        facts: The facts of the site and the robot.

    Returns:
        The ids of the regions.
    """
    point = (pose["x_mm"], pose["y_mm"])
    place = set()
    left_out: set[str] = set()
    for name, region in facts["regions"].items():
        same_map = region["map"] == pose["map"]
        same_floor = region["floor"] == pose["floor"]
        polygon = tuple((x, y) for x, y in region["points"])
        if same_map and same_floor and is_within(point, polygon, pose.get("margin_mm", 0)):
            place.add(name)
            if is_deep(point, polygon, pose.get("margin_mm", 0)):
                left_out |= set(region.get("around", []))
    return place - left_out


@lru_cache(REMEMBERED)
def is_deep(point: Point, polygon: Polygon, margin: int) -> bool:
    """Decide whether a point is inside a polygon and farther from every side than the margin.

    Args:
        point: The point in mm.
        polygon: The corners in order; the last is joined to the first.
        margin: The margin in mm.

    Returns:
        True when nothing within the margin is on the edge or outside.
    """
    sides = list(zip(polygon, polygon[1:] + polygon[:1], strict=True))
    if any(squared_distance(point, start, end) <= margin * margin for start, end in sides):
        return False
    return winding_number(point, sides) != 0


@lru_cache(REMEMBERED)
def is_within(point: Point, polygon: Polygon, margin: int) -> bool:
    """Decide whether the distance from a point to a polygon is at most the margin.

    Args:
        point: The point in mm.
        polygon: The corners in order; the last is joined to the first.
        margin: The margin in mm.

    Returns:
        True when a point of the polygon, interior and edge included, is that near.
    """
    if margin < 0:
        return False  # a distance is never negative
    sides = list(zip(polygon, polygon[1:] + polygon[:1], strict=True))
    for start, end in sides:
        if squared_distance(point, start, end) <= margin * margin:
            return True
    return winding_number(point, sides) != 0


def squared_distance(point: Point, start: Point, end: Point) -> Fraction | int:
    """Compute the squared distance from a point to a segment, exactly.

    Args:
        point: The point.
        start: One end of the segment.
        end: The other end, which may be the same.

    Returns:
        The square of the distance.
    """
    along = (end[0] - start[0], end[1] - start[1])
    to_point = (point[0] - start[0], point[1] - start[1])
    length_squared = along[0] * along[0] + along[1] * along[1]
    dot = to_point[0] * along[0] + to_point[1] * along[1]
    if dot <= 0:  # before the start, or there is no length
        return to_point[0] * to_point[0] + to_point[1] * to_point[1]
    if dot >= length_squared:  # behind the end
        from_end = (point[0] - end[0], point[1] - end[1])
        return from_end[0] * from_end[0] + from_end[1] * from_end[1]
    cross = along[0] * to_point[1] - along[1] * to_point[0]
    return Fraction(cross * cross, length_squared)


def winding_number(point: Point, sides: list[tuple[Point, Point]]) -> int:
    """Count how often a closed line goes around a point that is not on it.

    Each side adds the turns of its start and end as seen from the point, in quarters. A side that
    jumps two quarters passes left or right of the point; the sign of the cross product says which.

    Args:
        point: The point.
        sides: The sides of the polygon.

    Returns:
        The number of turns, counter-clockwise positive.
    """
    quarters = 0
    for start, end in sides:
        ax, ay = start[0] - point[0], start[1] - point[1]
        bx, by = end[0] - point[0], end[1] - point[1]
        turn = (quarter(bx, by) - quarter(ax, ay)) % 4
        if turn == 1:
            quarters += 1
        elif turn == 3:
            quarters -= 1
        elif turn == 2:
            quarters += 2 if ax * by - ay * bx > 0 else -2
    return quarters // 4


def quarter(x: int, y: int) -> int:
    """Name the quarter of the plane a vector points into.

    Args:
        x: First coordinate.
        y: Second coordinate; not both are zero.

    Returns:
        0 to 3, counter-clockwise; each quarter holds the half-axis it begins with.
    """
    if x > 0 and y >= 0:
        return 0
    if x <= 0 and y > 0:
        return 1
    if x < 0 and y <= 0:
        return 2
    return 3
