# SPDX-License-Identifier: Apache-2.0
"""The geometry of a floor: rooms along corridors, wings, loops, and rooms behind rooms.

Every room is a rectangle whose robot halts in its middle, every door is in the middle of the wall
that is nearest to it; so a robot that drives from door to door never comes near a third place.
"""

from __future__ import annotations

from itertools import pairwise
from random import Random
from typing import NamedTuple

from missionpair.layouts.words import Scale


class Room(NamedTuple):
    """A rectangle: two corners in millimeters, and what it is for."""

    part: str
    x: int
    y: int
    right: int
    top: int

    @property
    def middle(self) -> tuple[int, int]:
        """Where a robot halts."""
        return (self.x + self.right) // 2, (self.y + self.top) // 2


class Doorway(NamedTuple):
    """A door between two rooms, by number, at a point; closable ones say whether they are open."""

    first: int
    second: int
    x: int
    y: int
    closable: bool


class FloorPlan(NamedTuple):
    """A floor: rooms in a fixed order, the corridor first and the dock second."""

    rooms: tuple[Room, ...]
    openings: tuple[Doorway, ...]


class _GrowingFloor:
    """A floor that grows."""

    def __init__(self, rng: Random) -> None:
        self.rng = rng
        self.rooms: list[Room] = []
        self.openings: list[Doorway] = []

    def room(self, part: str, x: int, y: int, width: int, height: int) -> int:
        self.rooms.append(Room(part, x, y, x + width, y + height))
        return len(self.rooms) - 1

    def door(self, first: int, second: int, at: tuple[int, int], *, closable: bool = False) -> None:
        self.openings.append(Doorway(first, second, *at, closable))

    def closable(self) -> bool:
        return self.rng.random() < 0.2


def draw_plan(rng: Random, scale: Scale) -> FloorPlan:
    """Return a floor with at least eight rooms beside its corridor and its dock.

    Args:
        rng: the only source of chance.
        scale: how large rooms are.
    """
    floor, lane = _GrowingFloor(rng), scale.lane
    above = _row(rng, scale, rng.randint(4, 6), is_even=rng.random() < 0.5)
    below = _row(rng, scale, rng.randint(4, 6), is_even=False)
    length = max(_length(above), _length(below))
    floor.room("lane", 0, 0, length, lane)
    dock = rng.choice(scale.widths)
    floor.room("dock", -dock, 0, dock, lane)
    floor.door(0, 1, (0, lane // 2))
    upper = _rooms(floor, above, lane, upward=True)
    lower = _rooms(floor, below, 0, upward=False)
    if len({depth for _, _, depth in above}) == 1:
        _link(floor, upper)
        if rng.random() < 0.75:
            _service(floor, upper, length, scale)
    else:
        _behind(floor, rng.choice(upper), scale, upward=True)
    if rng.random() < 0.5:
        _behind(floor, rng.choice(lower), scale, upward=False)
    if rng.random() < 0.5:
        _wing(floor, length, scale)
    return FloorPlan(tuple(floor.rooms), tuple(floor.openings))


#: Rooms of one side of a corridor: where each begins, its width and its depth.
_Row = list[tuple[int, int, int]]


def _row(rng: Random, scale: Scale, count: int, *, is_even: bool) -> _Row:
    found: _Row = []
    x, depth = 0, rng.choice(scale.depths)
    for _ in range(count):
        width = rng.choice(scale.widths)
        found.append((x, width, depth if is_even else rng.choice(scale.depths)))
        x += width + (0 if is_even or rng.random() < 0.6 else scale.lane // 2)
    return found


def _length(row: _Row) -> int:
    return row[-1][0] + row[-1][1]


def _rooms(floor: _GrowingFloor, row: _Row, edge: int, *, upward: bool) -> list[int]:
    """Build the rooms of one side, each with a door to the corridor."""
    found = []
    for x, width, depth in row:
        number = floor.room("room", x, edge if upward else edge - depth, width, depth)
        floor.door(0, number, (floor.rooms[number].middle[0], edge), closable=floor.closable())
        found.append(number)
    return found


def _link(floor: _GrowingFloor, rooms: list[int]) -> None:
    """Join some neighbors of one depth by a door: a loop through the corridor."""
    for left, right in pairwise(rooms):
        touch = floor.rooms[left].right == floor.rooms[right].x
        if touch and floor.rng.random() < 0.4:
            at = (floor.rooms[left].right, floor.rooms[left].middle[1])
            floor.door(left, right, at, closable=floor.closable())


def _service(floor: _GrowingFloor, rooms: list[int], length: int, scale: Scale) -> None:
    """Build a second corridor behind a row: every door to it closes another loop."""
    top = floor.rooms[rooms[0]].top
    number = floor.room("service", 0, top, length, scale.lane)
    joined = [room for room in rooms if floor.rng.random() < 0.6]
    for room in joined if len(joined) > 1 else rooms[:2]:
        floor.door(room, number, (floor.rooms[room].middle[0], top))


def _behind(floor: _GrowingFloor, front: int, scale: Scale, *, upward: bool) -> None:
    """Build a room that can be reached through another one alone."""
    before = floor.rooms[front]
    width, depth = before.right - before.x, floor.rng.choice(scale.depths)
    edge = before.top if upward else before.y
    number = floor.room("room", before.x, edge if upward else edge - depth, width, depth)
    floor.door(front, number, (before.middle[0], edge), closable=floor.closable())


def _wing(floor: _GrowingFloor, length: int, scale: Scale) -> None:
    """Build a corridor off the end of the first one, with rooms on its far side."""
    count, lane = floor.rng.randint(2, 3), scale.lane
    heights = [floor.rng.choice(scale.widths) for _ in range(count)]
    bottom = lane - sum(heights)
    wing = floor.room("wing", length, bottom, lane, sum(heights))
    floor.door(0, wing, (length, lane // 2))
    y = bottom
    for height in heights:
        number = floor.room("room", length + lane, y, floor.rng.choice(scale.depths), height)
        floor.door(wing, number, (length + lane, floor.rooms[number].middle[1]))
        y += height
