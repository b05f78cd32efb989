# SPDX-License-Identifier: Apache-2.0
"""A layout as who writes missions sees it: places by what they are for, ways, things."""

from __future__ import annotations

from collections import deque

from missionpair.layouts.words import DomainWords
from missionpair.pair import Layout


class Ground:
    """One layout with its domain's words.

    Args:
        layout: the site and the tools, as plain data.
        words: the domain's.
    """

    def __init__(self, layout: Layout, words: DomainWords) -> None:
        self.layout = layout
        self.words = words
        site = layout.site
        self.home: str = next(iter(site["robots"].values()))["home"]
        self.tags: dict[str, str] = {r: model["tags"][0] for r, model in site["regions"].items()}
        self.homes: dict[str, str] = {o: model["home"] for o, model in site["objects"].items()}
        self.lane: str = next(iter(site["regions"]))
        named = {**site["regions"], **site["objects"]}
        self._names: dict[str, str] = {key: model["names"][0] for key, model in named.items()}
        self._next: dict[str, list[str]] = {region: [] for region in site["regions"]}
        for door in site["doors"]:
            first, second = door["between"]
            self._next[first].append(second)
            self._next[second].append(first)
        self._ways: dict[tuple[str, str], tuple[str, ...]] = {}

    def name(self, identifier: str) -> str:
        """Return what people call a place or a thing."""
        return self._names[identifier]

    def rooms(self, *tags: str) -> list[str]:
        """Return the rooms with one of the tags; corridors and the dock do not count."""
        lanes = {*map(self._slug_of, self.words.lanes), self.home}
        return [r for r, tag in self.tags.items() if tag in tags and r not in lanes]

    def things_at(self, region: str) -> list[str]:
        """Return what belongs there."""
        return [thing for thing, home in self.homes.items() if home == region]

    def stores(self) -> list[str]:
        """Return the places where at least two things are kept."""
        return [r for r in self.rooms("staff", "public") if len(self.things_at(r)) > 1]

    def way(self, start: str, end: str, via: tuple[str, ...] = ()) -> tuple[str, ...]:
        """Return every place on the way with the fewest doors, both ends included."""
        found: list[str] = [start]
        for stop in (*via, end):
            found += self._way(found[-1], stop)[1:]
        return tuple(dict.fromkeys(found))

    def nearest(self, start: str, rooms: list[str], count: int = 4) -> list[str]:
        """Return the rooms that are nearest to a place, by straight lines along the walls."""
        x, y = self.approach(start)

        def far(room: str) -> int:
            right, top = self.approach(room)
            return abs(right - x) + abs(top - y)

        return sorted(rooms, key=far)[:count]

    def approach(self, region: str) -> tuple[int, int]:
        """Return where a robot halts there, in millimeters."""
        x, y = self.layout.site["regions"][region]["approach"]
        return x, y

    def doors(self, region: str) -> list[str]:
        """Return the variables that say whether a door of the place is open."""
        held = self.layout.site["doors"]
        return [d["variable"] for d in held if region in d["between"] and "variable" in d]

    def _slug_of(self, name: str) -> str:
        return next((key for key, spelled in self._names.items() if spelled == name), "")

    def _way(self, start: str, end: str) -> tuple[str, ...]:
        """Return the places on the way, breadth first, as the robot's own planner finds it."""
        if (start, end) not in self._ways:
            queue: deque[tuple[str, ...]] = deque([(start,)])
            seen = {start}
            while queue and queue[0][-1] != end:
                way = queue.popleft()
                for there in self._next[way[-1]]:
                    if there not in seen:
                        seen.add(there)
                        queue.append((*way, there))
            self._ways[start, end] = queue[0]
        return self._ways[start, end]
