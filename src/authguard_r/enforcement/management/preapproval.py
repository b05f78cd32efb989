# SPDX-License-Identifier: Apache-2.0
"""Consent to a class of actions before a request: accepted, replaced and withdrawn.

Source: section "Threshold Approval Cost". Spec page: docs/spec/approval.md#pre-approval
"""

from __future__ import annotations

from msgspec.structs import replace

from authguard_r.core.approval import PreApproval, VerifiedPreApproval
from authguard_r.core.checks.people import people_behind
from authguard_r.core.identifiers import GrantId
from authguard_r.core.lifecycle import TERMINAL, Status
from authguard_r.core.mission import Grant
from authguard_r.core.principals import Principal
from authguard_r.core.quantities import to_timestamp
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Standing
from authguard_r.core.token import VerifiedMission
from authguard_r.enforcement.management.parts import (
    ManagementParts,
    entry,
    refuse,
    replayed,
    require_newest,
    require_signed_since,
)
from authguard_r.store.transactions import Transaction
from authguard_r.wire.gate_limits import LIMITS

#: Where the store holds when an action of a grant was denied last, by mission and grant.
_DENIED = "preapproval-denied"


def preapprove(act: Transaction, token: bytes, *, parts: ManagementParts) -> Standing:
    """Take in a signed pre-approval; it replaces what its signer said of the grant before.

    Raises:
        AuthGuardError: malformed, not authentic, not this signer's to give, wider than a
            pre-approval may be, or older than one that was taken in; nothing was changed.
    """
    item = parts.inputs.verify_preapproval(act, token)
    said = item.preapproval
    standing = act.standing(said.mid)
    if standing is None or (standing.digest, standing.version) != (said.mission, said.version):
        raise refuse(Reason.MISSION_UNKNOWN, "no such mission version is here")
    if standing.status in {*TERMINAL, Status.ISSUED}:
        raise replayed(standing)
    verified = parts.inputs.mission(act, standing.digest)
    grant = next((g for g in verified.mission.actions if g.id == said.grant), None)
    if grant is None:
        text = f"expected one of {', '.join(g.id for g in verified.mission.actions)}"
        raise refuse(Reason.ACTION_OUT_OF_SCOPE, text, "preapproval.grant")
    _require_narrow(act, said, verified, grant, parts)
    _require_eligible(item.approver, said, verified, grant, parts)
    _require_new(act, item)
    text = token.decode("ascii").strip()
    kept = parts.inputs.preapprovals.keep(act, item, text, act.now)
    left = {**standing.preapproved, item.digest: said.uses}
    held = replace(standing, preapproved={one: left.get(one, 0) for one in kept})
    act.hold(held)
    opened: dict[str, object] = {
        "verb": "preapprove",
        "by": item.approver.id,
        "role": item.approver.role,
        "preapproval": item.digest,
        "grant": grant.id,
        "rows": list(said.rows),
        "most_risk": said.most_risk,
        "uses": said.uses,
    }
    act.record(entry(act, said.mid, opened, {"token": text}))
    return held


def withdraw_denied(
    act: Transaction, standing: Standing, grant: GrantId, *, parts: ManagementParts
) -> Standing:
    """Return the standing without pre-approvals of a grant, of which an action was denied.

    Only what is signed after the denial counts again.
    """
    kept = parts.inputs.preapprovals.drop(act, standing.mid, grant, act.now)
    act.put(_DENIED, f"{standing.mid}/{grant}", str(act.now.utc_ms).encode("ascii"))
    return replace(standing, preapproved={one: standing.preapproved.get(one, 0) for one in kept})


def _require_new(act: Transaction, item: VerifiedPreApproval) -> None:
    """Require what was signed after what it replaces, after a denial, and not ahead of time."""
    said = item.preapproval
    if said.uses and said.issued_ms > act.now.utc_ms + LIMITS.skew_ms:
        text = f"signed at {to_timestamp(said.issued_ms)}: the clock that signed it runs ahead"
        raise refuse(Reason.NOT_YET_VALID, text, "preapproval.issued_ms")
    denied_ms = int(act.get(_DENIED, f"{said.mid}/{said.grant}") or 0)
    key = f"{said.mid}/{said.grant}/{item.approver.id}/preapproval"
    require_newest(act, key, said.issued_ms, over_ms=denied_ms)
    require_signed_since(act, said.issued_ms, where="preapproval.issued_ms")


def _require_narrow(
    act: Transaction,
    said: PreApproval,
    verified: VerifiedMission,
    grant: Grant,
    parts: ManagementParts,
) -> None:
    """Require rows of the grant, the second line of `eq:threshold` at most, few uses and an end."""
    if [*said.rows] != sorted({*said.rows}) or said.rows[-1] >= len(grant.alternatives):
        last, got = len(grant.alternatives) - 1, ", ".join(map(str, said.rows))
        text = f"`{grant.id}` has rows 0 to {last}; expected some of them, sorted, got {got}"
        raise refuse(Reason.SCHEMA_INVALID, text, "preapproval.rows")
    policies = (verified.mission.risk_policy, *parts.facts.risk)
    tau_2 = min(policy.tau_2 for policy in policies)
    if said.most_risk >= tau_2:
        text = (
            f"expected a risk below {tau_2} (tau_2), got {said.most_risk}: from there on each "
            "action needs approvals of its own (`authguard approvals approve`)"
        )
        raise refuse(Reason.VALUE_OUT_OF_RANGE, text, "preapproval.most_risk")
    if said.uses > grant.starts:
        text = f"expected at most the {grant.starts} starts of `{grant.id}`, got {said.uses}"
        raise refuse(Reason.VALUE_OUT_OF_RANGE, text, "preapproval.uses")
    if not act.now.utc_ms <= said.expires_ms <= verified.expiry_ms:
        text = f"expected an end that is to come, until {verified.mission.expiry} at most"
        raise refuse(Reason.VALUE_OUT_OF_RANGE, text, "preapproval.expires_ms")


def _require_eligible(
    signer: Principal,
    said: PreApproval,
    verified: VerifiedMission,
    grant: Grant,
    parts: ManagementParts,
) -> None:
    """Require a signer who may answer a request of these rows, and is not the issuer."""
    rows = [grant.alternatives[number] for number in said.rows]
    ends = [(row.source, row.destination, *row.regions) for row in rows]
    places = [place for row in ends for place in row if place is not None]
    if not signer.scope.covers(said.rid, places):
        text = f"`{signer.id}` has no say about this robot there"
        raise refuse(Reason.SIGNER_OUT_OF_SCOPE, text, "preapproval.rows")
    if said.rid != parts.facts.robot.rid:
        text = f"expected `{parts.facts.robot.rid}`, got `{said.rid}`"
        raise refuse(Reason.ROBOT_MISMATCH, text, "preapproval.rid")
    for policy in (verified.mission.risk_policy, *parts.facts.risk):
        if signer.role not in policy.roles:
            text = f"expected a role of {', '.join(policy.roles)}, got `{signer.role}`"
            raise refuse(Reason.ROLE_DENIED, text, "preapproval")
    if people_behind(verified.issuer, [signer]) < 2:
        text = f"`{signer.id}` may be behind the mission's own signature"
        raise refuse(Reason.ISSUER_MISMATCH, text, "preapproval")
