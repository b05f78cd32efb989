# SPDX-License-Identifier: Apache-2.0
"""Approvals: what a supervisor signs, and to what exactly it is bound.

Source: section "Risk-Adaptive Approval", theorem "High-risk approval".
Spec page: docs/spec/approval.md
"""

from __future__ import annotations

from enum import StrEnum

from msgspec import Struct

from authguard_r.core.identifiers import Count, Digest, GrantId, MissionId, Positive, RobotId
from authguard_r.core.token import Principal


class Verdict(StrEnum):
    """An approver's answer. One eligible `deny` outweighs any number of approvals."""

    APPROVE = "approve"
    DENY = "deny"


class Approval(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One principal's answer to one request.

    Args:
        mid: the mission.
        version: its version.
        mission: digest of the signed mission.
        rid: the robot.
        grant: the grant that asked.
        scope: digest of the action's effect.
        situation: digest of the guards' truth and the risk tier when asked.
        counter: the request's number; used once.
        expires_ms: trusted time after which it is worth nothing.
        verdict: approve or deny.
    """

    mid: MissionId
    version: Positive
    mission: Digest
    rid: RobotId
    grant: GrantId
    scope: Digest
    situation: Digest
    counter: Positive
    expires_ms: Count
    verdict: Verdict


class VerifiedApproval(Struct, frozen=True, kw_only=True):
    """An approval whose signature holds, with who signed it. Made by `approvals` only."""

    approval: Approval
    approver: Principal
