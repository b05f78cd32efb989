# SPDX-License-Identifier: Apache-2.0
"""Cedar, asked about every action: policies written from the mission, with the same scope.

It decides one request at a time and remembers none: what a mission says of order, counts, budgets,
choices and approvals, and whether it is still in force, is not in its policies (`_cedar_text`).
Option `context=full`: the caller remembers these for it and passes them, as an integrator can who
builds a registry beside it (`_cedar_context`). Needs the package cedarpy.
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
from missionpair.defenses._cedar_context import context_of
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
_JSON = msgspec.json.Encoder()


def make(*, context: str = "action") -> Defense:
    """Return Cedar.

    Raises:
        DefenseError: the package is not there, or no such context.
    """
    if context not in {"action", "full"}:
        raise DefenseError(f"`{NAME}` takes `context=action` or `context=full`, not `{context}`")
    full = context == "full"
    try:
        cedarpy = import_module(PACKAGE)
    except ImportError as error:
        raise DefenseError(f"`{NAME}` needs the package {PACKAGE}: {MEND}") from error
    asks: PerMission[Callable[[Action, Walk], Denied | None]] = PerMission(
        lambda stage: _asker(cedarpy, stage, full=full)
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
    parameters = {"cedarpy": _version(), "context": context}
    name = f"{NAME}-full" if full else NAME
    return Watched(name=name, claim=claim, permits_for=asks.of, parameters=parameters)


@cache
def _version() -> str:
    return version(PACKAGE)


def _asker(cedarpy: Any, stage: Stage, *, full: bool) -> Callable[[Action, Walk], Denied | None]:
    """Return what asks about one action; the mission's policies are read once."""
    mission, facts = stage.scene.mission, stage.sim.gate.facts
    written = policies(mission, facts, full=full)
    checked = cedarpy.validate_policies(written, schema(mission, facts, full=full))
    if not checked.validation_passed:
        raise DefenseError(f"`{NAME}` cannot say this mission: {checked.errors[0]}")
    held = cedarpy.PolicySet.from_str(written)
    entities = cedarpy.Entities.from_json_str("[]")
    denied = Denied(by=f"{NAME}-full" if full else NAME, reasons=(DENY,))

    def permits(action: Action, walk: Walk) -> Denied | None:
        asked = request(walk, action)
        if full:
            asked["context"] |= context_of(walk, action, mission)
        asked["context"] = _JSON.encode(asked["context"]).decode()
        return None if cedarpy.is_authorized(asked, held, entities).allowed else denied

    return permits
