# SPDX-License-Identifier: Apache-2.0
"""Cedar, asked about every action: policies written from the mission, with the same scope.

It decides one request at a time and remembers none: what a mission says of order, counts, budgets,
choices and approvals, and whether it is still in force, is not in its policies. What is: see
`_cedar_text`. Needs the package cedarpy.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from importlib import import_module
from importlib.metadata import version
from typing import Any

import msgspec

from authguard_r.core.action import Action
from missionpair.defenses import Claim, Defense, DefenseError
from missionpair.defenses._cedar_text import policies, request, schema
from missionpair.defenses._per_mission import PerMission
from missionpair.defenses._watched import Watched
from missionpair.execution import Denied
from missionpair.judging import Walk
from missionpair.stage import Stage
from missionpair.words import Category

NAME = "cedar"
#: What is needed, and how it is had.
PACKAGE = "cedarpy"
MEND = "install it (`pip install cedarpy`), or the group `bench` (`uv sync --group bench`)"
#: Its only code: no policy permits it, or one forbids it.
DENY = "DENY"
_DENIED = Denied(by=NAME, reasons=(DENY,))
_JSON = msgspec.json.Encoder()


def make() -> Defense:
    """Return Cedar.

    Raises:
        DefenseError: the package is not there.
    """
    try:
        cedarpy = import_module(PACKAGE)
    except ImportError as error:
        raise DefenseError(f"`{NAME}` needs the package {PACKAGE}: {MEND}") from error
    asks: PerMission[Callable[[Action, Walk], Denied | None]] = PerMission(
        lambda stage: _asker(cedarpy, stage)
    )
    claim = Claim(
        text="stops what is outside the mission's rows, limits, guards and time, or its robot",
        blocks=(
            Category.GOAL,
            Category.OBJECT,
            Category.AREA,
            Category.CAPABILITY,
            Category.PARAMETER,
            Category.CROSS_ROBOT,
        ),
        reasons=frozenset(
            {
                "ACTION_OUT_OF_SCOPE",
                "TOOL_OUT_OF_SCOPE",
                "OBJECT_OUT_OF_SCOPE",
                "SOURCE_OUT_OF_SCOPE",
                "DESTINATION_OUT_OF_SCOPE",
                "ROUTE_OUT_OF_SCOPE",
                "PARAMETER_OUT_OF_BOUNDS",
                "PARAMETER_NOT_ALLOWED",
                "PARAMETER_MISSING",
                "DATA_RIGHT_MISSING",
                "ROBOT_MISMATCH",
                "GUARD_FALSE",
            }
        ),
    )
    return Watched(name=NAME, claim=claim, permits_for=asks.of, parameters={"cedarpy": _version()})


@cache
def _version() -> str:
    return version(PACKAGE)


def _asker(cedarpy: Any, stage: Stage) -> Callable[[Action, Walk], Denied | None]:
    """Return what asks about one action; the mission's policies are read once."""
    mission, facts = stage.scene.mission, stage.sim.gate.facts
    written = policies(mission, facts)
    checked = cedarpy.validate_policies(written, schema(mission, facts))
    if not checked.validation_passed:
        raise DefenseError(f"`{NAME}` cannot say this mission: {checked.errors[0]}")
    held = cedarpy.PolicySet.from_str(written)
    entities = cedarpy.Entities.from_json_str("[]")

    def permits(action: Action, walk: Walk) -> Denied | None:
        asked = request(walk, action)
        asked["context"] = _JSON.encode(asked["context"]).decode()
        return None if cedarpy.is_authorized(asked, held, entities).allowed else _DENIED

    return permits
