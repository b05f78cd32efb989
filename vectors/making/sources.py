# SPDX-License-Identifier: Apache-2.0
"""Decisions on who set which field, on pre-approvals, and deviations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from random import Random
from typing import Any

from authguard_r.core.approval import ApprovalVerdict, PreApproval, VerifiedPreApproval
from authguard_r.core.encoding import Tag, digest_of
from authguard_r.core.mission import SCHEMA, Limit
from authguard_r.core.provenance import Chooser, Label, SourceField, allowed_of
from fixtures import decision_cases, scenarios
from fixtures.decision_cases import Case

Json = dict[str, Any]
Build = Callable[[Random], Case]
_SIGNED = (Label.OPERATOR, Label.SUPERVISOR)
#: Every label but a camera's.
_NO_CAMERA = tuple(sorted(label for label in Label if label is not Label.CAMERA))


def narrowed(field: SourceField, *labels: Label, by: str = "mission", **said: Label) -> Build:
    """Return a case whose action has these labels, and whose mission or site narrows one field."""

    def build(rnd: Random) -> Case:
        kinds = ("record_video",) if field is SourceField.RECORDING else ("navigate",)
        case = decision_cases._plain(rnd, *kinds)
        row = next(r for r in case.grant.alternatives if r.source == case.action.source)
        case = decision_cases._with_grant(case, alternatives=(row,))
        route = row.regions[:1] if field is SourceField.ROUTE else ()
        case = decision_cases._with_action(case, provenance=said, route=route)
        if by == "site":
            sources = allowed_of({field: labels})
            return replace(case, facts=decision_cases.set_(case.facts, sources=sources))
        return decision_cases._with_mission(case, schema=SCHEMA, sources={field: labels})

    return build


def chosen(chooser: Chooser, *labels: Label, **said: Label) -> Build:
    """Return a case of two rows that differ in their destination, which the mission narrows."""

    def build(rnd: Random) -> Case:
        case = decision_cases._with_grant(decision_cases._two_rows(rnd), chooser=chooser)
        case = decision_cases._with_action(case, provenance=said)
        sources = {SourceField.DESTINATION: labels} if labels else {}
        return decision_cases._with_mission(case, schema=SCHEMA, sources=sources)

    return build


def fixed(rnd: Random) -> Case:
    """Every parameter has one signed value, so that nobody but the signer set it."""
    case = narrowed(SourceField.PARAMETERS, *_SIGNED, params=Label.CAMERA)(rnd)
    limits = tuple(Limit(parameter=p, low=n, high=n) for p, n in sorted(case.action.params.items()))
    return decision_cases._with_grant(case, limits=limits)


def by_officer(case: Build) -> Build:
    """Return a case whose mission a safety officer issued."""
    return lambda rnd: replace(case(rnd), issuer_role="safety_officer")


_RECORDING, _THRESHOLD = SourceField.RECORDING, SourceField.APPROVAL_THRESHOLD
#: Each case with what is refused of it; nothing where it is accepted.
SOURCES: dict[str, tuple[Build, bool]] = {
    "a way that a camera's text may have set, where none may": (
        narrowed(SourceField.ROUTE, *_NO_CAMERA, route=Label.CAMERA),
        False,
    ),
    "a way of the model's, where a camera's alone may not": (
        narrowed(SourceField.ROUTE, *_NO_CAMERA, route=Label.MODEL),
        True,
    ),
    "a way without a label, where one is left out": (
        narrowed(SourceField.ROUTE, *_NO_CAMERA),
        False,
    ),
    "a label of the operator's that nobody signed": (
        narrowed(SourceField.ROUTE, *_SIGNED, route=Label.OPERATOR),
        False,
    ),
    "a type by a planner that has seen a camera's text": (
        narrowed(SourceField.TYPE, Label.MODEL, type=Label.CAMERA),
        False,
    ),
    "a tool by a planner that has seen a camera's text": (
        narrowed(SourceField.TOOL, Label.MODEL, tool=Label.CAMERA),
        False,
    ),
    "a speed by a planner that has heard a voice": (
        narrowed(SourceField.PARAMETERS, Label.MODEL, params=Label.AUDIO),
        False,
    ),
    "a speed that has one signed value": (fixed, True),
    "the site narrows it": (
        narrowed(SourceField.ROUTE, *_NO_CAMERA, by="site", route=Label.CAMERA),
        False,
    ),
    "a recording that an operator permits, where a supervisor has to": (
        narrowed(_RECORDING, Label.SUPERVISOR),
        False,
    ),
    "a recording that a safety officer permits": (
        by_officer(narrowed(_RECORDING, Label.SUPERVISOR)),
        True,
    ),
    "thresholds of an operator's, where a supervisor has to set them": (
        narrowed(_THRESHOLD, Label.SUPERVISOR),
        False,
    ),
    "a choice of the planner's that it may make": (chosen(Chooser.PLANNER), True),
    "a choice of the planner's with a label that is left out": (
        chosen(Chooser.PLANNER, *_NO_CAMERA, destination=Label.CAMERA),
        False,
    ),
    "a choice of the planner's with a label that is left in": (
        chosen(Chooser.PLANNER, *_NO_CAMERA, destination=Label.MODEL),
        True,
    ),
    "a wide set gives the planner no choice that its grant does not": (
        chosen(Chooser.OPERATOR, *sorted(Label), destination=Label.MODEL),
        False,
    ),
}


def preapproved(left: int = 2, **changes: Any) -> Build:
    """Return a case that asks one further person, who approved in advance; something changed."""

    def build(rnd: Random) -> Case:
        case = decision_cases.everywhere(decision_cases._approval_base(rnd))
        tau = {"tau_1": 1, "tau_2": changes.get("tau_2", 1_000), "t": 2}
        policy = decision_cases.set_(case.mission.risk_policy, **tau)
        case = decision_cases._with_mission(case, risk_policy=policy)
        said = PreApproval(
            mid=case.mission.mid,
            version=case.mission.version,
            mission=digest_of(Tag.MISSION, case.mission),
            rid=scenarios.RID,
            grant=case.grant.id,
            rows=changes.get("rows", tuple(range(len(case.grant.alternatives)))),
            most_risk=changes.get("most_risk", 999),
            uses=2,
            expires_ms=case.now.utc_ms + changes.get("left_ms", 0),
            issued_ms=case.now.utc_ms - 1,
        )
        approver = decision_cases.set_(
            case.approvals[0].approver, role=changes.get("role", "supervisor")
        )
        hashed = digest_of(Tag.PREAPPROVAL, said)
        given = VerifiedPreApproval(preapproval=said, digest=hashed, approver=approver)
        assert case.standing is not None
        request = case.standing.requests[case.grant.id]
        other = decision_cases.set_(request, scope=decision_cases.DIGEST, denied=True)
        requests = {case.grant.id: other} if changes.get("denied") else {}
        left_now = {hashed: left}
        standing = decision_cases.set_(case.standing, requests=requests, preapproved=left_now)
        return replace(case, standing=standing, approvals=(), preapprovals=(given,))

    return build


def answered(rnd: Random) -> Case:
    """Return a case whose approver approved in advance, was asked all the same, and denies."""
    case = preapproved(denied=True)(rnd)
    need, grant = decision_cases.decide_case(case).need, case.grant.id
    assert need is not None
    assert case.standing is not None
    request = decision_cases.set_(
        case.standing.requests[grant], scope=need.scope, situation=need.situation, denied=False
    )
    approver = case.preapprovals[0].approver
    denial = decision_cases._answer(case, request, approver.id, verdict=ApprovalVerdict.DENY)
    standing = decision_cases.set_(case.standing, requests={grant: request})
    return replace(case, standing=standing, approvals=(denial,))


PREAPPROVALS: dict[str, tuple[Build, bool]] = {
    "a pre-approval in its last millisecond": (preapproved(), True),
    "a pre-approval used once of twice": (preapproved(left=1), True),
    "a pre-approval used up": (preapproved(left=0), False),
    "a pre-approval that is over": (preapproved(left_ms=-1), False),
    "a pre-approval of a row that is not there": (preapproved(rows=(9,)), False),
    "a pre-approval of less risk": (preapproved(most_risk=1), False),
    "a pre-approval of somebody who may not answer": (preapproved(role="estimator"), False),
    "a pre-approval while an action of its grant is denied": (preapproved(denied=True), False),
    "tier 3 asks each time": (preapproved(tau_2=1), False),
}

#: Codes of findings with weights of fields, and D_M as numerator and denominator.
DEVIATIONS: list[tuple[list[str], Json, list[int]]] = [
    ([], {}, [0, 1]),
    (["DESTINATION_OUT_OF_SCOPE"], {}, [1, 15]),
    (["DESTINATION_OUT_OF_SCOPE"], {"destination": 6}, [3, 10]),
    (["SOURCE_OUT_OF_SCOPE", "SOURCE_NOT_ATTESTED"], {}, [1, 15]),
    (["OBJECT_OUT_OF_SCOPE", "DESTINATION_OUT_OF_SCOPE"], {"object": 2, "time": 3}, [1, 6]),
    (["EXPIRED", "REVOKED", "ROBOT_MISMATCH"], {}, [1, 5]),
    (["APPROVAL_REQUIRED"], {"approval": 100}, [50, 57]),
]


def deviations() -> list[Json]:
    """Return how far findings deviate, by weights."""
    return [
        {"reasons": reasons, "weights": weights, "deviation": share}
        for reasons, weights, share in DEVIATIONS
    ]
