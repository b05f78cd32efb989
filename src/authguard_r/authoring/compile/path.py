# SPDX-License-Identifier: Apache-2.0
"""Ways from door to door, as far as a question or a finding needs them.

No authority rests on a way: a row lists its regions one by one, and those are what is signed.
"""

from __future__ import annotations

from collections import deque

from authguard_r.core.identifiers import RegionId
from authguard_r.site.model import Site

#: Tags of regions that a way is never led through unasked.
SENSITIVE_TAGS = frozenset({"hazardous", "private", "restricted"})


def quiet_path(site: Site, start: RegionId, end: RegionId) -> tuple[RegionId, ...]:
    """Return the shortest way that passes no private, restricted or hazardous region.

    The ends may be such regions. Empty when there is no such way.
    """
    ways: deque[tuple[RegionId, ...]] = deque([(start,)])
    seen = {start}
    while ways:
        way = ways.popleft()
        if way[-1] == end:
            return way
        if way[-1] != start and not SENSITIVE_TAGS.isdisjoint(site.regions[way[-1]].tags):
            continue
        for region in _neighbors(site, way[-1]):
            if region not in seen:
                seen.add(region)
                ways.append((*way, region))
    return ()


def reachable(site: Site, start: RegionId) -> frozenset[RegionId]:
    """Return every region that doors lead to at all, the start included."""
    found, left = {start}, [start]
    while left:
        new = [region for region in _neighbors(site, left.pop()) if region not in found]
        found.update(new)
        left += new
    return frozenset(found)


def _neighbors(site: Site, region: RegionId) -> list[RegionId]:
    """Return the regions behind the doors, the one it is part of, and its own parts."""
    pairs = [door.between for door in site.doors if region in door.between]
    found = {b if a == region else a for a, b in pairs}
    found |= {name for name, model in site.regions.items() if model.within == region}
    parent = site.regions[region].within
    return sorted(found if parent is None else found | {parent})
