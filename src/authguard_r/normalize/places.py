# SPDX-License-Identifier: Apache-2.0
"""Which region a planner's position means: exactly one, or it is refused.

A position on the edge of two regions, or where two overlap, is refused, not guessed. Where the
author says that one region lies within another, the inner one is meant. What is dispatched is the
region's own `approach`, never the planner's point: all positions in one region are one action. Spec
page: docs/spec/binding.md#positions
"""

from __future__ import annotations

from authguard_r.core.errors import MalformedError
from authguard_r.core.geometry import Point, may_lie_in, polygon
from authguard_r.core.identifiers import RegionId
from authguard_r.core.reasons import Reason
from authguard_r.site.model import Site, ancestors


class Places:
    """The regions of a site, to be found by position.

    Args:
        site: the site model.
    """

    def __init__(self, site: Site) -> None:
        self._areas = tuple(
            (region, polygon(model.map, model.floor, model.points))
            for region, model in site.regions.items()
        )
        self.maps = frozenset(area.map for _, area in self._areas)
        self._outer = {region: frozenset(ancestors(site, region)) for region in site.regions}

    def region_at(self, point: Point, frame: str | None, *, where: str) -> RegionId:
        """Return the one region in which a position lies, the innermost of nested ones.

        Args:
            point: millimeters; from the planner, untrusted.
            frame: the map whose frame the point is in; None: any map of the site.
            where: the place, for messages.

        Raises:
            MalformedError: in no region (`NAME_UNKNOWN`), or in several or on an edge that two
                share (`NAME_AMBIGUOUS`).
        """
        found = [
            region
            for region, area in self._areas
            if frame in {None, area.map} and may_lie_in(area, point, 0)
        ]
        outer = frozenset[RegionId]().union(*(self._outer[region] for region in found))
        inner = [region for region in found if region not in outer]
        if len(inner) == 1:
            return inner[0]
        shown = f"({point[0]}, {point[1]}) mm"
        if not found:
            raise MalformedError(
                f"no region is at {shown}", where=where, reason=Reason.NAME_UNKNOWN
            )
        raise MalformedError(
            f"expected a position in one region, got {shown} in {', '.join(sorted(inner))}",
            where=where,
            reason=Reason.NAME_AMBIGUOUS,
        )
