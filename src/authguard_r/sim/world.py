# SPDX-License-Identifier: Apache-2.0
"""A symbolic world in time: rooms, doors, things, one robot, and people near it.

Motion takes time along straight lines between approach points and doors; everything else takes
the time its tool takes. `delta` is the paper's transition function: None stands for bottom.
Source: `eq:transition`. How-to: docs/howto/simulator.md
"""

from __future__ import annotations

from collections import deque
from itertools import pairwise
from math import isqrt

import msgspec
from msgspec import Struct

from authguard_r.core.action import Action
from authguard_r.core.identifiers import ObjectId, ParameterId, RegionId, VariableId
from authguard_r.site.model import Door, Site

Point = tuple[int, int]

SPEED = ParameterId("speed_mm_s")
DURATION = ParameterId("duration_ms")
MAX_BYTES = ParameterId("max_bytes")

#: What the gripper holds when it holds nothing.
NOTHING = "nothing"
#: Milliseconds that a grip takes; looking around and speaking are over at once.
GRIP_MS = 2_000
#: Battery, per mille of full, used by a meter of motion.
BATTERY_PER_METER = 1


class WorldState(Struct, frozen=True, kw_only=True):
    """Everything that is true of the world; only the estimator may speak of it to a gate.

    Args:
        x_mm: the robot's position.
        y_mm: the robot's position.
        map: the map it is on.
        floor: the floor it is on.
        region: the region it was last sent to or stands in.
        holding: object in the gripper, None when empty.
        places: where every other object lies.
        doors: by variable, whether it is open.
        battery_permille: charge.
        speed_mm_s: speed right now.
        human_distance_mm: distance to the nearest person.
        recorded_bytes: sensor data recorded so far.
        recordings: regions that were recorded, in order.
    """

    x_mm: int
    y_mm: int
    map: str
    floor: int
    region: RegionId
    holding: ObjectId | None
    places: dict[ObjectId, RegionId]
    doors: dict[VariableId, bool]
    battery_permille: int
    speed_mm_s: int
    human_distance_mm: int
    recorded_bytes: int = 0
    recordings: tuple[RegionId, ...] = ()


def initial_state(site: Site, home: RegionId, *, battery_permille: int = 870) -> WorldState:
    """Return the world with every object at home, every door open, nobody near."""
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


def delta(site: Site, state: WorldState, action: Action) -> WorldState | None:
    """Return the state after the action was carried out to its end, or None when it cannot be.

    Physics only: it knows neither missions nor safety. Source: `eq:transition`.
    """
    if action.type == "navigate":
        path = plan_path(site, state, action)
        return None if path is None else _moved(site, state, action, path)
    if action.type == "pick":
        return _picked(state, action)
    if action.type == "place":
        return _placed(state, action)
    if action.type in {"record_video", "take_photo"}:
        size = action.params.get(MAX_BYTES, 0)
        return msgspec.structs.replace(
            state,
            recorded_bytes=state.recorded_bytes + size,
            recordings=(*state.recordings, state.region),
        )
    if action.type in {"wait", "scan_obstacles", "announce"}:
        return state
    return None


def plan_path(site: Site, state: WorldState, action: Action) -> tuple[Point, ...] | None:
    """Return the corners of the way, from where the robot is, or None when there is none.

    The route's regions are passed in order; between them the way with the fewest doors is taken.
    """
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
    if action.type == "navigate":
        path = plan_path(site, state, action)
        speed = action.params.get(SPEED, 0)
        if path is None or speed <= 0:
            return None
        return path_length_mm(path) * 1_000 // int(speed) + 1
    asked = action.params.get(DURATION)
    if asked is not None:
        return int(asked)
    return GRIP_MS if action.type in {"pick", "place"} else 0


def _moved(
    site: Site, state: WorldState, action: Action, path: tuple[Point, ...]
) -> WorldState | None:
    used = path_length_mm(path) * BATTERY_PER_METER // 1_000
    if used > state.battery_permille or action.destination is None:
        return None
    if action.params.get(SPEED, 0) <= 0:
        return None
    end = site.regions[action.destination]
    return msgspec.structs.replace(
        state,
        x_mm=path[-1][0],
        y_mm=path[-1][1],
        map=end.map,
        floor=end.floor,
        region=action.destination,
        battery_permille=state.battery_permille - used,
        speed_mm_s=0,
    )


def _picked(state: WorldState, action: Action) -> WorldState | None:
    item = action.object
    if item is None or state.holding is not None or state.places.get(item) != state.region:
        return None
    places = {thing: place for thing, place in state.places.items() if thing != item}
    return msgspec.structs.replace(state, holding=item, places=places)


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
