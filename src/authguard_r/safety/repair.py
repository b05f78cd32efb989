# SPDX-License-Identifier: Apache-2.0
"""The safe repair of an unsafe action: slower, or by a shorter route, and nothing else.

A repair is a proposal. The enforcer decides it like any other, and only when the client asked for
that. Source: `fig:architecture`. Spec page: docs/spec/safety.md#repair
"""

from __future__ import annotations

from itertools import pairwise

from msgspec.structs import replace

from authguard_r.core.action import Action
from authguard_r.core.facts import SiteFacts
from authguard_r.core.geometry import Point, Polygon, comes_within, edges_of
from authguard_r.core.identifiers import RegionId
from authguard_r.core.safety import Hazard, SafetyFinding
from authguard_r.safety.config import SPEED, SPEEDS

#: What the envelope's findings put before the largest allowed value.
AT_MOST = "at most "
_TOO_FAST = frozenset({Hazard.SPEED, Hazard.HUMAN_PROXIMITY})
_Edge = tuple[Point, Point]


def repair_of(
    action: Action,
    found: tuple[SafetyFinding, ...],
    *,
    keep_out: tuple[RegionId, ...],
    facts: SiteFacts,
) -> Action | None:
    """Return the action slowed down and without the keep-out regions of its route.

    Args:
        action: what was proposed; untrusted.
        found: every hazard that the envelope found in it.
        keep_out: the signed regions that no route may pass.
        facts: the signed site.

    Returns:
        The action with a lower speed, a shorter route, or both; labels and meta are left out.
        None when there is another hazard, or when no such action is a way that the robot can take.
        The result is not known to be safe or authorized: both gates have to say so.
    """
    fast = [finding for finding in found if finding.hazard in _TOO_FAST]
    passed = [finding for finding in found if _is_passed(finding)]
    if len(fast) + len(passed) < len(found):
        return None
    params, route = dict(action.params), action.route
    if fast:
        most = min(int(finding.expected.removeprefix(AT_MOST)) for finding in fast)
        if params.get(SPEED, most) <= most:  # no speed to lower, or a negative one
            return None
        params[SPEED] = most
    if passed:
        route = tuple(region for region in route if region not in keep_out)
        if not _is_way(action, route, facts):
            return None
    return replace(action, params=params, route=route, provenance={}, meta=None)


def is_narrower(repair: Action, action: Action) -> bool:
    """True when a repair is the action with fewer regions on its route and lower speeds.

    The enforcer proposes no other repair, whichever safety gate offers it. Only a speed that the
    envelope bounds may change, and only toward zero with its sign: a lower number is not safer for
    every parameter, and -5000 is faster than 500.
    """
    asked = iter(action.route)
    shorter = all(region in asked for region in repair.route)  # in the same order
    slower = repair.params.keys() == action.params.keys() and all(
        value == action.params[name] or (name in SPEEDS and _is_slower(value, action.params[name]))
        for name, value in repair.params.items()
    )
    emptied = bool(action.route) and not repair.route
    same = replace(repair, params=action.params, route=action.route, provenance={}, meta=None)
    return shorter and slower and not emptied and same == replace(action, provenance={}, meta=None)


def _is_slower(speed: int, asked: int) -> bool:
    """True when a speed is between zero and the speed that was asked for."""
    return min(asked, 0) <= speed <= max(asked, 0)


def _is_passed(finding: SafetyFinding) -> bool:
    return finding.hazard is Hazard.KEEP_OUT and finding.field.startswith("route[")


def _is_way(action: Action, route: tuple[RegionId, ...], facts: SiteFacts) -> bool:
    """True when the route still names a region, and each stop touches the next one.

    An empty route would leave the way open, also for the regions that were left out.
    """
    if not route or action.source is None or action.destination is None:
        return False
    stops = (action.source, *route, action.destination)
    if any(stop not in facts.regions for stop in stops):
        return False
    areas = [facts.regions[stop].area for stop in stops]
    return all(one == other or touch(one, other) for one, other in pairwise(areas))


def touch(one: Polygon, other: Polygon) -> bool:
    """True when two regions of one floor share a stretch of their outlines; a corner is no stretch.

    Wrong reading: true does not mean that there is a door, or that it is open. The site's facts
    have outlines and no doors.
    """
    return (one.map, one.floor) == (other.map, other.floor) and any(
        _share(mine, theirs) for mine in _facing(one, other) for theirs in _facing(other, one)
    )


def _facing(area: Polygon, other: Polygon) -> list[_Edge]:
    """Return the edges that reach the other's bounding box: of long outlines only a few do."""
    return [
        (a, b)
        for a, b in edges_of(area)
        if all(
            min(a[axis], b[axis]) <= other.high[axis] and other.low[axis] <= max(a[axis], b[axis])
            for axis in (0, 1)
        )
    ]


def _share(mine: _Edge, theirs: _Edge) -> bool:
    """True when two edges have more than one point in common."""
    common = {point for point in mine if comes_within(*theirs, point, 0)}
    return len(common | {point for point in theirs if comes_within(*mine, point, 0)}) > 1
