# SPDX-License-Identifier: Apache-2.0
"""A static list of tools: what the mission grants no use of at all cannot be called.

The list is made of the mission's grants and looks at nothing but names: which kind of action, with
which tool. It knows no object, place, parameter, order or time.
"""

from __future__ import annotations

from authguard_r.core.action import Action
from authguard_r.core.identifiers import ActionType, ToolId
from missionpair.defenses import Claim, Defense
from missionpair.defenses._per_mission import PerMission
from missionpair.defenses._watched import Watched
from missionpair.execution import Denied, Permits
from missionpair.judging import Walk
from missionpair.stage import Stage
from missionpair.words import Category

NAME = "allowlist"
#: Its only code.
NOT_LISTED = "NOT_LISTED"
_DENIED = Denied(by=NAME, reasons=(NOT_LISTED,))

Listed = frozenset[tuple[ActionType, ToolId]]


def make() -> Defense:
    """Return the list."""
    lists: PerMission[Listed] = PerMission(listed)
    claim = Claim(
        text="stops every kind of action and every tool that the mission grants no use of",
        blocks=(Category.CAPABILITY,),
        reasons=frozenset({"ACTION_OUT_OF_SCOPE", "TOOL_OUT_OF_SCOPE"}),
        fields=frozenset({"type", "tool"}),
    )
    return Watched(name=NAME, claim=claim, permits_for=lambda stage: _permits(lists.of(stage)))


def listed(stage: Stage) -> Listed:
    """Return every kind of action with its tool that a grant of the mission names."""
    return frozenset((grant.type, grant.tool) for grant in stage.scene.mission.actions)


def _permits(allowed: Listed) -> Permits:
    def permits(action: Action, walk: Walk) -> Denied | None:  # noqa: ARG001 - names alone
        return None if (action.type, action.tool) in allowed else _DENIED

    return permits
