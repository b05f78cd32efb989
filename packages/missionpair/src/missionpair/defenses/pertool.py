# SPDX-License-Identifier: Apache-2.0
"""A policy for each tool, in the manner of Progent: which values each argument may have.

It is written from the mission's grants, within the mission's ceilings. It checks each call alone: a
grant must allow the tool, and each argument must have a value that some grant of that tool allows.
It does not check rows (which thing goes where), state, order, counts, time or choices.
Spec page: docs/spec/defenses.md#pertool
"""

from __future__ import annotations

from collections.abc import Sequence

from msgspec import Struct

from authguard_r.core.action import Action
from authguard_r.core.identifiers import ParameterId
from authguard_r.core.mission import Grant, Mission
from missionpair.defenses import Claim, Defense
from missionpair.defenses._per_mission import PerMission
from missionpair.defenses._watched import Watched
from missionpair.execution import Denied, Permits
from missionpair.judging import Walk
from missionpair.stage import Stage
from missionpair.words import Category

NAME = "pertool"
#: Its codes: the tool is not allowed; an argument has a value that no grant of the tool has.
NOT_ALLOWED, NOT_A_VALUE = "TOOL_NOT_ALLOWED", "VALUE_NOT_ALLOWED"


class ToolPolicy(Struct, frozen=True):
    """What one tool may be called with.

    Args:
        objects: things; None stands for none.
        destinations: places; None stands for none.
        regions: places that a way may touch.
        bounds: the widest bounds of each parameter.
        needed: the parameters that every grant of it has.
    """

    objects: frozenset[str | None]
    destinations: frozenset[str | None]
    regions: frozenset[str]
    bounds: dict[ParameterId, tuple[int, int]]
    needed: frozenset[ParameterId]

    def allows(self, action: Action) -> bool:
        """True when every argument by itself may have its value."""
        return (
            action.object in self.objects
            and action.destination in self.destinations
            and self.regions.issuperset(action.route)
            and self.needed <= action.params.keys() <= self.bounds.keys()
            and all(
                self.bounds[name][0] <= value <= self.bounds[name][1]
                for name, value in action.params.items()
            )
        )


def make() -> Defense:
    """Return the policies."""
    held: PerMission[dict[tuple[str, str], ToolPolicy]] = PerMission(policies)
    claim = Claim(
        text="stops tools that the mission grants no use of, and values no grant of a tool has",
        blocks=(Category.GOAL, Category.OBJECT, Category.CAPABILITY, Category.PARAMETER),
        fields=frozenset({"type", "tool", "object", "destination", "route", "params"}),
    )
    return Watched(name=NAME, claim=claim, permits_for=lambda stage: _permits(held.of(stage)))


def policies(stage: Stage) -> dict[tuple[str, str], ToolPolicy]:
    """Return the policy of each kind of action with its tool that the mission grants."""
    grants: dict[tuple[str, str], list[Grant]] = {}
    mission = stage.scene.mission
    for grant in mission.actions:
        grants.setdefault((grant.type, grant.tool), []).append(grant)
    return {key: _policy(those, mission) for key, those in grants.items()}


def _policy(grants: Sequence[Grant], mission: Mission) -> ToolPolicy:
    rows = [row for grant in grants for row in grant.alternatives]
    bounds: dict[ParameterId, tuple[int, int]] = {}
    for limit in (limit for grant in grants for limit in grant.limits):
        low, high = bounds.get(limit.parameter, (limit.low, limit.high))
        bounds[limit.parameter] = (min(low, limit.low), max(high, limit.high))
    for limit in mission.limits:
        if limit.parameter in bounds:
            low, high = bounds[limit.parameter]
            bounds[limit.parameter] = (max(low, limit.low), min(high, limit.high))
    return ToolPolicy(
        objects=frozenset(row.object for row in rows) & {None, *mission.objects},
        destinations=frozenset(row.destination for row in rows) & {None, *mission.regions},
        regions=frozenset(region for row in rows for region in row.regions) & {*mission.regions},
        bounds=bounds,
        needed=frozenset.intersection(
            *(frozenset(limit.parameter for limit in grant.limits) for grant in grants)
        ),
    )


def _permits(allowed: dict[tuple[str, str], ToolPolicy]) -> Permits:
    def permits(action: Action, walk: Walk) -> Denied | None:  # noqa: ARG001 - the call alone
        policy = allowed.get((action.type, action.tool))
        if policy is None:
            return Denied(by=NAME, reasons=(NOT_ALLOWED,))
        return None if policy.allows(action) else Denied(by=NAME, reasons=(NOT_A_VALUE,))

    return permits
