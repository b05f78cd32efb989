# SPDX-License-Identifier: Apache-2.0
"""Approvals: what a supervisor signs, and to what exactly it is bound.

Source: section "Risk-Adaptive Approval", theorem "High-risk approval".
Spec page: docs/spec/approval.md
"""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

from msgspec import Meta, Struct

from authguard_r.core.identifiers import Count, Digest, GrantId, MissionId, Positive, RobotId
from authguard_r.core.mission import MAX_ROWS
from authguard_r.core.principals import Principal


class ApprovalVerdict(StrEnum):
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
    verdict: ApprovalVerdict


class PreApproval(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One principal's approval of a class of actions in advance: some rows of one grant.

    It covers tier 2 of `eq:threshold` only. On tier 3 each action needs approvals of its own.
    Source: section "Threshold Approval Cost" (narrow approval cache).

    Args:
        mid: the mission.
        version: its version.
        mission: digest of the signed mission.
        rid: the robot.
        grant: the grant.
        rows: indices of its rows, sorted.
        most_risk: the largest rho(a, s) that is covered.
        uses: releases that are covered in all; 0 withdraws what its signer said before.
        expires_ms: trusted time after which it is worth nothing.
        issued_ms: when it was signed; a later one of its signer for the grant replaces it.
    """

    mid: MissionId
    version: Positive
    mission: Digest
    rid: RobotId
    grant: GrantId
    rows: Annotated[tuple[Count, ...], Meta(min_length=1, max_length=MAX_ROWS)]
    most_risk: Count
    uses: Count
    expires_ms: Count
    issued_ms: Count


class VerifiedPreApproval(Struct, frozen=True, kw_only=True):
    """A pre-approval whose signature holds, its digest and who signed it. Made by `approvals`."""

    preapproval: PreApproval
    digest: Digest
    approver: Principal


class VerifiedApproval(Struct, frozen=True, kw_only=True):
    """An approval whose signature holds, with who signed it. Made by `approvals` only."""

    approval: Approval
    approver: Principal
