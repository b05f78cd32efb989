# SPDX-License-Identifier: Apache-2.0
"""Approvals and selections: what supervisors and choosers sign, opened and held to its signer.

Whether an answer fits a question is decided in the core (`core.checks.approval`), afresh, at use.
Spec page: docs/spec/approval.md

Internal: it may change in any release.
"""

from __future__ import annotations

from typing import Any

from msgspec import Struct

from authguard_r.core.approval import (
    Approval,
    ApprovalVerdict,
    PreApproval,
    VerifiedApproval,
    VerifiedPreApproval,
)
from authguard_r.core.encoding import Tag
from authguard_r.core.identifiers import (
    Base64Url,
    Count,
    Digest,
    GrantId,
    MissionId,
    Positive,
    RobotId,
)
from authguard_r.core.principals import Principal, Verifier
from authguard_r.core.quantities import Now
from authguard_r.core.standing import ApprovalRequest
from authguard_r.core.token import VerifiedMission, open_token

#: Roles whose holders may answer at all; the mission's policy narrows this.
APPROVER_ROLES = frozenset({"operator", "supervisor", "safety_officer"})


class Selection(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True):
    """A signed choice of one row of one grant, for one mission version.

    Args:
        mid: the mission.
        version: its version.
        mission: digest of the signed mission.
        grant: the grant.
        row: index of the row among its alternatives.
        nonce: fresh random bytes; a choice is taken in once, so that an old one undoes no new one.
        expires_ms: trusted time after which the choice is not taken in.
        issued_ms: when it was signed, by its signer's clock; 0 when it is not given.
    """

    mid: MissionId
    version: Positive
    mission: Digest
    grant: GrantId
    row: Count
    nonce: Base64Url
    expires_ms: Count
    issued_ms: Count = 0


def answer(
    verified: VerifiedMission,
    grant: GrantId,
    request: ApprovalRequest,
    *,
    rid: RobotId,
    verdict: ApprovalVerdict,
) -> Approval:
    """Return what an approver signs to answer a request; it lives as long as the request."""
    return Approval(
        mid=verified.mission.mid,
        version=verified.mission.version,
        mission=verified.digest,
        rid=rid,
        grant=grant,
        scope=request.scope,
        situation=request.situation,
        counter=request.counter,
        expires_ms=request.expires_ms,
        verdict=verdict,
    )


def approver_json(approver: Principal) -> dict[str, Any]:
    """Return how the log names an approver: a person, or a group with how many of whom signed."""
    named: dict[str, Any] = {"by": approver.id, "role": approver.role, "kind": "individual"}
    if approver.members:
        group = {"threshold": approver.threshold, "members": sorted(approver.members)}
        named |= {"kind": "threshold", **group}
    return named


def open_approval(data: bytes, *, verifier: Verifier, now: Now) -> VerifiedApproval:
    """Return an approval once its signature holds; whether it fits is decided at use.

    Raises:
        MalformedError: no canonical approval.
        AuthenticityError: certificate or signature does not hold.
    """
    approval, _, principal = open_token(
        data, Approval, tag=Tag.APPROVAL, roles=APPROVER_ROLES, verifier=verifier, now=now
    )
    return VerifiedApproval(approval=approval, approver=principal)


def open_preapproval(data: bytes, *, verifier: Verifier, now: Now) -> VerifiedPreApproval:
    """Return a pre-approval once its signature holds; whether it fits is decided at use.

    Raises:
        MalformedError: no canonical pre-approval.
        AuthenticityError: certificate or signature does not hold.
    """
    said, digest, principal = open_token(
        data, PreApproval, tag=Tag.PREAPPROVAL, roles=APPROVER_ROLES, verifier=verifier, now=now
    )
    return VerifiedPreApproval(preapproval=said, digest=digest, approver=principal)


def open_selection(data: bytes, *, verifier: Verifier, now: Now) -> tuple[Selection, Principal]:
    """Return a selection once its signature holds, with who signed it.

    Raises:
        MalformedError: no canonical selection.
        AuthenticityError: certificate or signature does not hold.
    """
    selection, _, principal = open_token(
        data, Selection, tag=Tag.SELECTION, roles=APPROVER_ROLES, verifier=verifier, now=now
    )
    return selection, principal
