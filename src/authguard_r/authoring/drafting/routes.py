# SPDX-License-Identifier: Apache-2.0
"""The way between two regions: through doors, and through nothing private that was not named."""

from __future__ import annotations

from collections import deque

from authguard_r.site.model import Site


def shortest(site: Site, start: str, goal: str, *, avoid: frozenset[str]) -> tuple[str, ...] | None:
    """Return the regions of a way with the fewest doors, both ends included, or None.

    Args:
        site: the model; of two equal ways the one whose doors it lists first is taken.
        start: where it begins.
        goal: where it ends.
        avoid: tags of regions that the way may not lead through; the ends may have them.
    """
    queue: deque[tuple[str, ...]] = deque([(start,)])
    seen = {start}
    while queue:
        way = queue.popleft()
        if way[-1] == goal:
            return way
        for door in site.doors:
            if way[-1] not in door.between:
                continue
            there = door.between[1] if door.between[0] == way[-1] else door.between[0]
            if there in seen or (there != goal and avoid.intersection(site.regions[there].tags)):
                continue
            seen.add(there)
            queue.append((*way, there))
    return None
