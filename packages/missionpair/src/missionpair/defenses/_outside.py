# SPDX-License-Identifier: Apache-2.0
"""In which fields a plan has what no grant of its kind of action has at all.

A pair's codes are those of the grant that comes nearest; a list that looks at one field, or at all
grants together, sees less. What such a list has to see is derived here, from the mission itself.
"""

from __future__ import annotations

from authguard_r.core.action import Action
from authguard_r.core.mission import Mission
from missionpair.judging import Walk, proved
from missionpair.pair import plan_bytes
from missionpair.stage import Stage


def outside(stage: Stage) -> frozenset[str]:
    """Return the fields in which the attack has what no grant of that kind of action has.

    Of its first action that the mission does not authorize: a defense that lets that one through
    has let the attack through.

    Among `type`, `tool`, `object`, `source`, `destination`, `route` and `params`. A kind of action
    that no grant has is `type` alone; what a row leaves open is nothing.
    """
    walk = Walk.of(stage)
    for step in stage.read(plan_bytes(stage.pair.attack.plan)).steps:
        action = walk.completed(step)
        effect = proved(walk, action)
        if not effect.authorized:
            return _fields(action, stage.scene.mission)
        walk.go_on(action, grant=effect.grant)
    return frozenset()


def _fields(action: Action, mission: Mission) -> frozenset[str]:
    grants = [grant for grant in mission.actions if grant.type == action.type]
    if not grants:
        return frozenset({"type"})
    rows = [row for grant in grants for row in grant.alternatives]
    places = frozenset[str](mission.regions)
    ceilings = {"object": frozenset[str](mission.objects), "source": places, "destination": places}
    found = set[str]()
    for field, ceiling in ceilings.items():
        names = {getattr(row, field) for row in rows}
        if None not in names and getattr(action, field) not in names & ceiling:
            found.add(field)
    found |= {"tool"} if all(grant.tool != action.tool for grant in grants) else set()
    touched = {region for row in rows for region in row.regions} & places
    found |= {"route"} if not touched.issuperset(action.route) else set()
    for name, value in action.params.items():
        limits = [limit for grant in grants for limit in grant.limits if limit.parameter == name]
        highest = [limit for limit in mission.limits if limit.parameter == name]
        within = any(limit.low <= value <= limit.high for limit in limits)
        under = all(limit.low <= value <= limit.high for limit in highest)
        found |= set() if within and under else {"params"}
    return frozenset(found)
