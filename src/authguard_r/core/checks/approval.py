# SPDX-License-Identifier: Apache-2.0
"""Step 7: are enough principals behind this very action, in this very situation?

Source: `eq:threshold`, `alg:authguard` (ApprovalValid), theorem "High-risk approval".
"""

from __future__ import annotations

from msgspec import Struct

from authguard_r.core.action import scope_of
from authguard_r.core.approval import ApprovalVerdict, VerifiedApproval, VerifiedPreApproval
from authguard_r.core.checks.case import Case
from authguard_r.core.checks.guards import guard_finding
from authguard_r.core.checks.people import people_behind
from authguard_r.core.encoding import Tag, digest_of
from authguard_r.core.finding import Finding, Findings
from authguard_r.core.identifiers import Digest
from authguard_r.core.mission import Grant, RiskPolicy, Row
from authguard_r.core.principals import Principal
from authguard_r.core.reasons import Reason
from authguard_r.core.risk import Tier, required, rho, tier_of
from authguard_r.core.standing import ApprovalRequest


class Need(Struct, frozen=True, kw_only=True):
    """How many principals are needed, on which line of `eq:threshold`, and what binds approvals."""

    risk: int
    required: int
    tier: int
    scope: Digest | None = None
    situation: Digest | None = None


class Situation(Struct, frozen=True, kw_only=True):
    """What an approver judged: which guards held, and the line of `eq:threshold`."""

    guards: tuple[bool, ...]
    tier: int


def assess_need(case: Case, grant: Grant) -> Need:
    """Return Req(a, s), and what approvals must carry when there must be any; computed afresh."""
    count, tier, score = max([_strictness(case, policy) for policy in _policies(case)])
    if count <= 1:
        return Need(risk=score, required=count, tier=tier)
    guards = (*case.verified.mission.guards, *grant.guards)
    rid = case.facts.robot.rid
    truth = tuple(guard_finding(g, case.state, rid, case.now) is None for g in guards)
    return Need(
        risk=score,
        required=count,
        tier=tier,
        scope=digest_of(Tag.SCOPE, scope_of(case.action)),
        situation=digest_of(Tag.SITUATION, Situation(guards=truth, tier=tier)),
    )


def _policies(case: Case) -> tuple[RiskPolicy, ...]:
    """Return the mission's policy and the organization's; each has to be satisfied."""
    return (case.verified.mission.risk_policy, *case.facts.risk)


def _strictness(case: Case, policy: RiskPolicy) -> tuple[int, int, int]:
    """Return how many principals one policy wants, and from which tier and score."""
    score = rho(case.action, policy, state=case.state, facts=case.facts, now=case.now)
    tier = tier_of(policy, score)
    return required(policy, tier), int(tier), score


def check_approval(case: Case, grant: Grant, need: Need) -> Findings:
    """(7) Req(a, s) people, the issuer's included, approved it; none denied."""
    if need.required <= 1:
        return ()
    request = case.standing.requests.get(grant.id) if case.standing is not None else None
    if request is None or (request.scope, request.situation) != (need.scope, need.situation):
        return _ask(case, need)
    fitting = [a for a in case.approvals if _fits(a, case, grant, request)]
    if request.denied or any(a.approval.verdict is ApprovalVerdict.DENY for a in fitting):
        return (_finding(Reason.APPROVAL_DENIED, need.required, "a principal denied"),)
    if case.now.utc_ms > request.expires_ms:
        return (_finding(Reason.APPROVAL_TIMEOUT, need.required, "the request ran out"),)
    behind = people_behind(case.verified.issuer, [a.approver for a in fitting])
    if behind >= need.required:
        return ()
    return (_finding(Reason.APPROVAL_REQUIRED, need.required, f"{behind} of them"),)


def find_preapproval(case: Case, grant: Grant, row: Row, need: Need) -> VerifiedPreApproval | None:
    """Return a pre-approval that stands in for the approvals that step 7 asks; None without one.

    The caller has asked step 7: this very action was not denied.
    """
    standing = case.standing
    request = standing.requests.get(grant.id) if standing is not None else None
    if need.tier != Tier.ELEVATED or (request is not None and request.denied):
        return None
    return next((p for p in case.preapprovals if _covers(p, case, grant, row, need)), None)


def _covers(item: VerifiedPreApproval, case: Case, grant: Grant, row: Row, need: Need) -> bool:
    """True when it is for this grant, row and risk of this mission, and is not used up."""
    said, mission = item.preapproval, case.verified.mission
    bound = (
        (said.mid, said.grant, said.rid) == (mission.mid, grant.id, case.facts.robot.rid)
        and (said.version, said.mission) == (mission.version, case.verified.digest)
        and grant.alternatives.index(row) in said.rows
        and need.risk <= said.most_risk
    )
    left = case.standing.preapproved.get(item.digest, 0) if case.standing is not None else 0
    in_time = case.now.utc_ms <= min(said.expires_ms, item.approver.usable_until_ms)
    behind = people_behind(case.verified.issuer, [item.approver])
    enough = left > 0 and behind >= need.required
    return bound and in_time and enough and _may_answer(item.approver, case)


def _may_answer(approver: Principal, case: Case) -> bool:
    """True when every policy names the role, and the certificate covers robot and places."""
    return (
        all(approver.role in policy.roles for policy in _policies(case))
        and approver.id != case.verified.mission.issuer
        and approver.scope.covers(case.facts.robot.rid, case.action.places)
    )


def _ask(case: Case, need: Need) -> Findings:
    """Ask, unless people were asked as often as the mission allows (L6)."""
    place, most = "budgets.prompts", case.verified.mission.budgets.prompts
    asked = case.standing.prompts if case.standing is not None else 0
    if asked >= most:
        return (Finding(place, Reason.BUDGET_EXCEEDED, f"at most {most}", str(asked + 1)),)
    return (_finding(Reason.APPROVAL_REQUIRED, need.required, "no open request"),)


def _fits(item: VerifiedApproval, case: Case, grant: Grant, request: ApprovalRequest) -> bool:
    """True when the approval is bound to this request in every field and its signer may answer."""
    approval, mission = item.approval, case.verified.mission
    bound = (
        (approval.mid, approval.grant) == (mission.mid, grant.id)
        and (approval.version, approval.mission) == (mission.version, case.verified.digest)
        and approval.rid == case.facts.robot.rid
        and (approval.scope, approval.situation) == (request.scope, request.situation)
        and approval.counter == request.counter
    )
    until = min(request.expires_ms, approval.expires_ms, item.approver.usable_until_ms)
    in_time = case.now.utc_ms <= until
    return bound and in_time and _may_answer(item.approver, case)


def _finding(reason: Reason, count: int, got: str) -> Finding:
    return Finding("approvals", reason, f"{count} principals, the issuer included", got)
