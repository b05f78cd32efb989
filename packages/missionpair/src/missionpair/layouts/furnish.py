# SPDX-License-Identifier: Apache-2.0
"""From a floor to a site: names, tags, things, robots, and the planner's tools."""

from __future__ import annotations

import re
from random import Random
from typing import Any

from missionpair.layouts.plan import FloorPlan, Room, draw_plan
from missionpair.layouts.words import DomainWords, vocabulary_of
from missionpair.pair import Layout

#: How many rooms of each tag a floor has at least, in the order in which they are given out.
_AT_LEAST = (("staff", 2), ("public", 3), ("private", 1), ("restricted", 1))
_MORE = ("public", "public", "public", "staff", "private", "restricted")


def furnished(words: DomainWords, attempt: int, *, number: int) -> Layout:
    """Return the layout that a domain's words make of one draw.

    Args:
        words: the domain's.
        attempt: which draw; the same one gives the same layout.
        number: what its id ends in.
    """
    rng = Random(f"{words.domain} {attempt}")  # noqa: S311 - the same plans every time
    plan = draw_plan(rng, words.scale)
    site = f"{words.domain}-{number:02}"
    tags = _tags(plan, rng)
    names = _names(plan, words, tags, rng)
    ids = [slug(name) for name in names]
    return Layout(
        id=site,
        domain=words.domain,
        site={
            "schema": "authguard-r/site/1",
            "id": site,
            "version": 1,
            "regions": {
                identifier: _region(room, tag, name)
                for identifier, room, tag, name in zip(ids, plan.rooms, tags, names, strict=True)
            },
            "doors": _doors(plan, ids),
            "objects": _things(words, ids, tags, rng),
            "robots": _robots(words, ids[1]),
            "vocabulary": vocabulary_of(words),
        },
        binding={
            "schema": "authguard-r/binding/1",
            "id": f"{words.domain}-tools",
            "tools": {tool.name: tool.binding() for tool in words.tools.values()},
        },
    )


def slug(name: str) -> str:
    """Return the id of a name: `Nurse Station 101` is `nurse-station-101`."""
    return re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")


def _tags(plan: FloorPlan, rng: Random) -> list[str]:
    """Return each room's tag: corridors by what they are, rooms by a shuffled hand of tags."""
    rooms = [number for number, room in enumerate(plan.rooms) if room.part == "room"]
    hand = [tag for tag, count in _AT_LEAST for _ in range(count)]
    hand += [rng.choice(_MORE) for _ in range(len(rooms) - len(hand))]
    rng.shuffle(hand)
    tags = dict(zip(rooms, hand, strict=True))
    ends = [n for n in rooms if sum(n in (o.first, o.second) for o in plan.openings) == 1]
    spare = [n for n in ends if hand.count(tags[n]) > dict(_AT_LEAST).get(tags[n], 0)]
    if spare and rng.random() < 0.5:
        tags[rng.choice(spare)] = "hazardous"  # a dead end: no way leads through it
    fixed = {"lane": "public", "wing": "public", "service": "staff", "dock": "staff"}
    return [fixed.get(room.part) or tags[n] for n, room in enumerate(plan.rooms)]


def _names(plan: FloorPlan, words: DomainWords, tags: list[str], rng: Random) -> list[str]:
    lanes = {"lane": words.lanes[0], "service": words.lanes[1], "wing": words.lanes[2]}
    pools = {tag: rng.sample(names, len(names)) for tag, names in words.rooms.items()}
    found: list[str] = []
    for room, tag in zip(plan.rooms, tags, strict=True):
        fixed = {**lanes, "dock": words.dock}.get(room.part)
        found.append(fixed or pools[tag].pop())
    return found


def _region(room: Room, tag: str, name: str) -> dict[str, Any]:
    corners = [[room.x, room.y], [room.right, room.y], [room.right, room.top], [room.x, room.top]]
    return {
        "map": "main",
        "floor": 0,
        "points": corners,
        "approach": list(room.middle),
        "tags": [tag],
        "names": [name],
    }


def _doors(plan: FloorPlan, ids: list[str]) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = []
    for opening in plan.openings:
        between = [ids[opening.first], ids[opening.second]]
        door: dict[str, Any] = {"between": between, "at": [opening.x, opening.y]}
        if opening.closable:
            door["variable"] = f"{slug(ids[opening.second]).replace('-', '_')}_door_open"
        found.append(door)
    return found


def _things(
    words: DomainWords, ids: list[str], tags: list[str], rng: Random
) -> dict[str, dict[str, Any]]:
    """Put at least two things into every place where things are kept, and some elsewhere."""
    kept = [n for n, tag in enumerate(tags) if tag == "staff" and n > 1]
    shown = [n for n, tag in enumerate(tags) if tag == "public" and n > 0]
    pool = [(kind, name) for kind, names in words.things.items() for name in names]
    rng.shuffle(pool)
    homes = [room for room in kept for _ in range(rng.randint(2, 3))]
    homes += [room for room in shown if rng.random() < 0.6 for _ in range(2)]
    found: dict[str, dict[str, Any]] = {}
    for home, (kind, name) in zip(homes, pool, strict=False):
        mass = words.weights[kind]
        found[slug(name)] = {"kind": kind, "home": ids[home], "mass_g": mass, "names": [name]}
    return found


def _robots(words: DomainWords, dock: str) -> dict[str, dict[str, Any]]:
    found: dict[str, dict[str, Any]] = {}
    for rid, robot in words.robots.items():
        tools: dict[str, set[str]] = {}
        for role in robot.roles:
            tool = words.tools[role]
            tools.setdefault(tool.type, set()).add(tool.tool)
        profile = {
            "tools": {kind: sorted(held) for kind, held in sorted(tools.items())},
            "max_speed_mm_s": robot.max_speed_mm_s,
            "max_force_mn": robot.max_force_mn,
            "max_payload_g": robot.max_payload_g,
        }
        found[rid] = {"home": dock, "profile": profile}
    return found
