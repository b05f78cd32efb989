# SPDX-License-Identifier: Apache-2.0
"""The decision: `alg:authguard`, its steps numbered as in the paper.

    (1) certificate      verified with the token; its end is checked again here, and stops
    (2) signature        verified with the token: a `VerifiedMission` exists
    (3) schema and time  schema with the token; not_before <= t <= expiry here
    (4) registry         known, this version, active
    (5) robot            id, profile and site are this gate's own
    (6) policy           a in Pi_M(s, t): ceilings, then the first grant and row that fit
    (7) approval         enough principals behind this action in this situation
    (8) update, append   the enforcer's: `enforcement` commits what is decided here
    (9) accept           only when nothing at all was found

Pure, total and deterministic. Every violation of steps 3 to 7 is a finding; the first in paper
order is primary. Spec page: docs/spec/decision.md
"""

from __future__ import annotations

from authguard_r.core.action import Action
from authguard_r.core.approval import VerifiedApproval, VerifiedPreApproval
from authguard_r.core.checks import GRANT_CHECKS, MISSION_CHECKS, ROW_CHECKS, Case
from authguard_r.core.checks.approval import assess_need, check_approval, find_preapproval
from authguard_r.core.checks.mission import check_certificate
from authguard_r.core.checks.provenance import selectable_rows
from authguard_r.core.decision import Decision, Match, Verdict
from authguard_r.core.facts import SiteFacts
from authguard_r.core.finding import Finding, in_paper_order
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Standing
from authguard_r.core.state import AttestedState
from authguard_r.core.token import IndexedGrant, VerifiedMission


def decide(
    verified: VerifiedMission,
    action: Action,
    *,
    state: AttestedState | None,
    facts: SiteFacts,
    now: Now,
    standing: Standing | None,
    approvals: tuple[VerifiedApproval, ...] = (),
    preapprovals: tuple[VerifiedPreApproval, ...] = (),
) -> Decision:
    """Return whether the action is in Pi_M(s, t) and enough principals approved it.

    Args:
        verified: the mission; the only source of authority.
        action: the proposal; untrusted.
        state: attested state; a request never carries one.
        facts: the signed site and the gate's own identity.
        now: read once by the caller.
        standing: the registry's entry for this mission, read in the same turn.
        approvals: authentic answers; those that do not fit are not counted.
        preapprovals: authentic pre-approvals; likewise.

    Source: `alg:authguard`, `eq:auth-predicate`.
    """
    case = Case(
        verified=verified,
        action=action,
        kind=facts.vocabulary.get(action.type),
        state=state,
        facts=facts,
        now=now,
        standing=standing,
        approvals=approvals,
        preapprovals=preapprovals,
    )
    # (1) certificate, (2) signature, (3) schema: the token's; a certificate that ended stops
    if ended := check_certificate(case):
        return Decision(verdict=Verdict.REJECT, findings=ended, match=None, need=None)
    # (3) time, (4) registry, (5) robot, (6) ceilings
    found = [finding for check in MISSION_CHECKS for finding in check(case)]
    # (6) policy
    match = find_match(case)
    found += match.findings
    # (7) approval
    need = assess_need(case, grant := match.indexed.grant)
    missing, stands_in = check_approval(case, grant, need), None
    if missing and missing[0].reason is not Reason.APPROVAL_DENIED:
        stands_in = find_preapproval(case, grant, match.row, need)
    found += () if stands_in is not None else missing
    # (8) update and append: `enforcement`
    if not found:  # (9) accept
        used = None if stands_in is None else stands_in.digest
        return Decision(
            verdict=Verdict.ACCEPT, findings=(), match=match, need=need, preapproved=used
        )
    findings = in_paper_order(tuple(found))
    only_approval = all(f.reason is Reason.APPROVAL_REQUIRED for f in findings)
    verdict = Verdict.REQUEST_APPROVAL if only_approval else Verdict.REJECT
    return Decision(verdict=verdict, findings=findings, match=match, need=need)


def find_match(case: Case) -> Match:
    """Return the first grant in signed order without findings, else the one with fewest.

    Ties go to signed order. Only grants of the action's type can be without findings, so they are
    tried alone first. None is looked at for longer than it can still be the answer.
    """
    action, grants = case.action, case.verified.grants
    same = [grants[place] for place in case.verified.by_type.get(action.type, ())]
    for indexed in same:
        if (action.object, action.source, action.destination) in indexed.rows:
            match = _match(case, indexed, under=1)
            if match is not None:
                return match
    # the first of the type with a single finding: only an earlier grant can have as few
    one = next(filter(None, (_match(case, indexed, under=2) for indexed in same)), None)
    best, under = None, 2 if one is not None else 1 << 30  # no grant has so many
    for indexed in grants:
        if one is not None and indexed is one.indexed:
            return best or one
        match = _match(case, indexed, under=under)
        if match is not None:
            best, under = match, len(match.findings)
    if best is None:  # pragma: no cover - the schema demands one grant
        raise RuntimeError("a mission without grants was verified")
    return best


def _match(case: Case, indexed: IndexedGrant, *, under: int) -> Match | None:
    """Return the grant with its best row, or None when there are `under` findings or more."""
    own: list[Finding] = []
    for check in GRANT_CHECKS:
        own += check(case, indexed)
        if len(own) >= under:
            return None
    best: Match | None = None
    for row in selectable_rows(indexed.grant, case.standing):
        found = [*own]
        for row_check in ROW_CHECKS:
            found += row_check(case, row)
            if len(found) >= under:
                break
        else:
            best, under = Match(indexed=indexed, row=row, findings=tuple(found)), len(found)
    return best
