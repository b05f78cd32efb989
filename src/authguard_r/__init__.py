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
"""

from __future__ import annotations

from authguard_r.assembly import Gate, assemble, simulate
from authguard_r.core.action import Action
from authguard_r.core.decision import Decision
from authguard_r.core.mission import Mission
from authguard_r.core.token import VerifiedMission, sign_object, verify_mission
from authguard_r.enforcement import evaluate

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
