# SPDX-License-Identifier: Apache-2.0
"""A symbolic world in time: rooms, doors, things, one robot, and people near it.

Motion takes time along straight lines between approach points and doors; everything else takes
the time its tool takes. `delta` is the paper's transition function: None stands for bottom.
Source: `eq:transition`. How-to: docs/howto/simulator.md
"""

from __future__ import annotations

from collections import deque
from itertools import pairwise
from math import cos, isqrt, sin

import msgspec

from authguard_r.core.action import Action
from authguard_r.core.geometry import may_lie_in, polygon
from authguard_r.core.identifiers import ObjectId, ParameterId, RegionId
from authguard_r.sim.effects import effect, recorded
from authguard_r.sim.state import WorldState
from authguard_r.site.model import Door, Site
from authguard_r.site.words import standard_words

Point = tuple[int, int]

SPEED = ParameterId("speed_mm_s")
DURATION = ParameterId("duration_ms")
DISTANCE = ParameterId("distance_mm")
ANGLE = ParameterId("angle_urad")
LINEAR = ParameterId("linear_mm_s")
LATERAL = ParameterId("lateral_mm_s")
TURNING = ParameterId("turn_urad_s")

#: What the gripper holds when it holds nothing.
NOTHING = "nothing"
#: Milliseconds that a grip takes; looking around and speaking are over at once.
GRIP_MS = 2_000
#: Types that move the robot along a way.
DRIVEN = frozenset({"back_up", "dock", "drive", "navigate", "survey", "walk"})
#: Types that take no time at all.
INSTANT = frozenset({"announce", "find", "hold", "read_metadata", "scan_obstacles"})
#: Default speed, in millimeters per second.
USUAL_SPEED_MM_S = 500
FULL_TURN_URAD = 6_283_185
#: Battery, per mille of full, used by a meter of motion.
BATTERY_PER_METER = 1


def initial_state(site: Site, home: RegionId, *, battery_permille: int = 870) -> WorldState:
    """Return the world with every object at home, every door open, no person near."""
    region = site.regions[home]
    return WorldState(
        x_mm=region.approach[0],
        y_mm=region.approach[1],
        map=region.map,
        floor=region.floor,
        region=home,
        holding=None,
        places={item: model.home for item, model in site.objects.items()},
        doors={door.variable: True for door in site.doors if door.variable is not None},
        battery_permille=battery_permille,
        speed_mm_s=0,
        human_distance_mm=5_000,
    )


def taken(state: WorldState, item: ObjectId) -> WorldState:
    """Return the world with a thing in the gripper, wherever it lay."""
    places = {thing: place for thing, place in state.places.items() if thing != item}
    return msgspec.structs.replace(state, holding=item, places=places)


def delta(site: Site, state: WorldState, action: Action) -> WorldState | None:
    """Return the state after the action was carried out to its end, or None when it cannot be.

    Physics only: it knows neither missions nor safety. Source: `eq:transition`.
    """
    if action.type in DRIVEN:
        path = plan_path(site, state, action)
        return None if path is None else _moved(site, state, action, path)
    if action.type == "turn":
        heading = (state.heading_urad + action.params.get(ANGLE, 0)) % FULL_TURN_URAD
        return msgspec.structs.replace(state, heading_urad=heading)
    if action.type == "pick":
        return _picked(state, action)
    if action.type == "place":
        return _placed(state, action)
    if action.type in site.vocabulary and action.type not in standard_words():
        return state  # what a site's own word does, nobody said: the world stays as it is
    return effect(state, action)


def speed_of(action: Action) -> int:
    """Return how fast the robot goes while the action moves it, in millimeters per second."""
    if action.type == "drive":
        return hypot_mm(action.params.get(LINEAR, 0), action.params.get(LATERAL, 0))
    usual = 0 if action.type == "navigate" else USUAL_SPEED_MM_S
    return max(0, action.params.get(SPEED, usual))


def hypot_mm(x: int, y: int) -> int:
    """Return the length of a vector, rounded down to a millimeter."""
    return isqrt(x * x + y * y)


def plan_path(site: Site, state: WorldState, action: Action) -> tuple[Point, ...] | None:
    """Return the corners of the way, from where the robot is, or None without a way.

    The route's regions are passed in order; between them the way with the fewest doors is taken.
    A walk or a drive goes straight, and is no way when it ends in no region.
    """
    if action.type in {"back_up", "drive", "walk"}:
        return _straight(site, state, action)
    if action.destination is None:
        return None
    stops = [*action.route, action.destination]
    points: list[Point] = [(state.x_mm, state.y_mm)]
    here = state.region
    for stop in stops:
        way = _regions_between(site, state, here, stop)
        if way is None:
            return None
        for door in way:
            points += _lane(site, here, points[-1], door.at)
            points.append(door.at)
            here = door.between[1] if door.between[0] == here else door.between[0]
    target = site.regions[action.destination].approach
    return (*points, *_lane(site, here, points[-1], target), target)


def _lane(site: Site, region: RegionId, start: Point, end: Point) -> tuple[Point, Point]:
    """Return the corners of a way that keeps to the middle of a region, clear of its walls."""
    model = site.regions[region]
    xs, ys = [x for x, _ in model.points], [y for _, y in model.points]
    if max(xs) - min(xs) >= max(ys) - min(ys):
        return (start[0], model.approach[1]), (end[0], model.approach[1])
    return (model.approach[0], start[1]), (model.approach[0], end[1])


def path_length_mm(path: tuple[Point, ...]) -> int:
    """Return the length of a way, each leg rounded up to a millimeter."""
    return sum(isqrt((bx - ax) ** 2 + (by - ay) ** 2) + 1 for (ax, ay), (bx, by) in pairwise(path))


def duration_ms(site: Site, state: WorldState, action: Action) -> int | None:
    """Return how long the action takes, or None when it cannot be carried out."""
    asked = action.params.get(DURATION)
    if action.type in DRIVEN:
        path, speed = plan_path(site, state, action), speed_of(action)
        if path is None or (speed <= 0 and asked is None):
            return None
        return int(asked) if asked is not None else path_length_mm(path) * 1_000 // speed + 1
    if asked is not None:
        return int(asked)
    return 0 if action.type in INSTANT else GRIP_MS


def _moved(
    site: Site, state: WorldState, action: Action, path: tuple[Point, ...]
) -> WorldState | None:
    used = path_length_mm(path) * BATTERY_PER_METER // 1_000
    region = action.destination or region_at(site, state, path[-1])
    if used > state.battery_permille or region is None:
        return None
    if action.type == "navigate" and speed_of(action) <= 0:
        return None
    end = site.regions[region]
    turned = action.params.get(TURNING, 0) * action.params.get(DURATION, 0) // 1_000
    after = msgspec.structs.replace(
        state,
        x_mm=path[-1][0],
        y_mm=path[-1][1],
        map=end.map,
        floor=end.floor,
        region=region,
        battery_permille=state.battery_permille - used,
        speed_mm_s=0,
        heading_urad=(state.heading_urad + turned) % FULL_TURN_URAD,
    )
    return recorded(after, action) if action.type == "survey" else after


def _straight(site: Site, state: WorldState, action: Action) -> tuple[Point, ...] | None:
    """Return the straight way of a walk or a drive along the robot's heading."""
    ahead, aside = action.params.get(DISTANCE, 0), 0
    if action.type == "back_up":
        ahead = -abs(ahead)
    if action.type == "drive":
        seconds = action.params.get(DURATION, 0)
        ahead = action.params.get(LINEAR, 0) * seconds // 1_000
        aside = action.params.get(LATERAL, 0) * seconds // 1_000
    angle = state.heading_urad / 1_000_000
    end = (
        state.x_mm + round(ahead * cos(angle) - aside * sin(angle)),
        state.y_mm + round(ahead * sin(angle) + aside * cos(angle)),
    )
    return None if region_at(site, state, end) is None else ((state.x_mm, state.y_mm), end)


def region_at(site: Site, state: WorldState, point: Point) -> RegionId | None:
    """Return the first region of the robot's floor that holds the point, None outside all."""
    for region, model in site.regions.items():
        same = model.map == state.map and model.floor == state.floor
        if same and may_lie_in(polygon(model.map, model.floor, model.points), point, 0):
            return region
    return None


def _picked(state: WorldState, action: Action) -> WorldState | None:
    item = action.object
    if item is None or state.holding is not None or state.places.get(item) != state.region:
        return None
    return taken(state, item)


def _placed(state: WorldState, action: Action) -> WorldState | None:
    item = action.object
    if item is None or state.holding != item or action.destination != state.region:
        return None
    places = {**state.places, item: state.region}
    return msgspec.structs.replace(state, holding=None, places=places)


def _regions_between(
    site: Site, state: WorldState, start: RegionId, goal: RegionId
) -> tuple[Door, ...] | None:
    """Return the doors of a shortest way through open doors, breadth first."""
    if start not in site.regions or goal not in site.regions:
        return None
    queue: deque[tuple[RegionId, tuple[Door, ...]]] = deque([(start, ())])
    seen = {start}
    while queue:
        here, way = queue.popleft()
        if here == goal:
            return way
        for door in site.doors:
            if here not in door.between or not _open(state, door):
                continue
            there = door.between[1] if door.between[0] == here else door.between[0]
            if there not in seen:
                seen.add(there)
                queue.append((there, (*way, door)))
    return None


def _open(state: WorldState, door: Door) -> bool:
    return door.variable is None or state.doors.get(door.variable, False)
