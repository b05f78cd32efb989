# SPDX-License-Identifier: Apache-2.0
"""AuthGuard-R: a robot driven by a language model does what an operator signed, action by action.

The ten names that most users need. In-process use is advisory: a planner in the same process can
reach around any library (docs/explanation/architecture.md).

    Mission          what is signed                      (core.mission)
    Action           what is proposed                    (core.action)
    verify_mission   a token's bytes to a VerifiedMission
    VerifiedMission  a mission whose signature holds
    sign_object      any object to a signed token
    evaluate         what both gates would say: a what-if
    Decision         what the gate says and why
    Gate             one robot's gate, whole
    assemble         a gate from its parts
    simulate         a gate over the symbolic robot

A name is read from its module when it is first used: importing one part of the package, as the
stop lane does, must not bring in the store and the decision with it.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from authguard_r.core.action import Action
    from authguard_r.core.decision import Decision
    from authguard_r.core.mission import Mission
    from authguard_r.core.token import VerifiedMission, sign_object, verify_mission
    from authguard_r.enforcement.enforcer import evaluate
    from authguard_r.operations.simulation import simulate
    from authguard_r.server.wiring import Gate, assemble

__all__ = [
    "Action",
    "Decision",
    "Gate",
    "Mission",
    "VerifiedMission",
    "assemble",
    "evaluate",
    "sign_object",
    "simulate",
    "verify_mission",
]

_HOMES = {
    "Action": "core.action",
    "Decision": "core.decision",
    "Gate": "server.wiring",
    "Mission": "core.mission",
    "VerifiedMission": "core.token",
    "assemble": "server.wiring",
    "evaluate": "enforcement.enforcer",
    "sign_object": "core.token",
    "simulate": "operations.simulation",
    "verify_mission": "core.token",
}


def __getattr__(name: str) -> object:
    """Return one of the ten names from the module in which it lives."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
