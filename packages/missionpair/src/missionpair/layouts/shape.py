# SPDX-License-Identifier: Apache-2.0
"""What is left of a site when every id, name and millimeter is taken away.

Two sites of different shape are no renaming of each other: the shape is invariant under it.
"""

from __future__ import annotations

from collections import Counter
from hashlib import sha256
from typing import Any


def shape_of(site: dict[str, Any]) -> str:
    """Return the shape: rooms by tag, things and doors, distinguished by what is around them.

    Colors are refined until a room's color says everything about the rooms that it leads to; equal
    sites under any renaming have equal shapes, in every order of their parts.
    """
    doors = [(*door["between"], "variable" in door) for door in site["doors"]]
    held: dict[str, list[str]] = {region: [] for region in site["regions"]}
    for thing in site["objects"].values():
        held[thing["home"]].append(thing["kind"])
    homes = Counter(robot["home"] for robot in site["robots"].values())
    colors = {
        region: _digest((model["tags"], sorted(held[region]), homes[region]))
        for region, model in site["regions"].items()
    }
    for _ in range(len(colors)):
        colors = {
            region: _digest((color, sorted(_around(region, doors, colors))))
            for region, color in colors.items()
        }
    types = sorted((kind, sorted(model["fields"])) for kind, model in site["vocabulary"].items())
    return _digest((sorted(colors.values()), types))


def _around(
    region: str, doors: list[tuple[str, str, bool]], colors: dict[str, str]
) -> list[tuple[str, bool]]:
    there = [(second, shut) for first, second, shut in doors if first == region]
    there += [(first, shut) for first, second, shut in doors if second == region]
    return [(colors[other], shut) for other, shut in there]


def _digest(value: object) -> str:
    return sha256(repr(value).encode()).hexdigest()
