# SPDX-License-Identifier: Apache-2.0
"""How decisions and reports are spelled in JSON: the shapes that others rely on.

One spelling for the command line and for the answers of a gate. Spec page: docs/reference/cli.md
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import msgspec

from authguard_r.audit.deviation import Weights, violated_fields
from authguard_r.core.action import Action
from authguard_r.core.decision import Decision
from authguard_r.core.finding import Finding
from authguard_r.core.reasons import may_pass_later
from authguard_r.core.safety import SafetyDecision
from authguard_r.core.standing import Outcome
from authguard_r.core.token import VerifiedMission
from authguard_r.enforcement.report import (
    EQUAL,
    NOT_EVALUATED,
    Judged,
    Report,
    average_deviation,
    plan_deviation,
)
from authguard_r.wire.disclosure import Disclosure, disclosed
from authguard_r.wire.fault_finding import fault_finding


def action_json(action: Action) -> dict[str, Any]:
    """Return the contract's shape of an action; every key is there."""
    meta = action.meta
    return {
        "type": action.type,
        "object": action.object,
        "source": action.source,
        "destination": action.destination,
        "route": list(action.route),
        "params": dict(action.params),
        "tool": action.tool,
        "provenance": {field: str(label) for field, label in action.provenance.items()},
        "meta": {
            "planner": None if meta is None else meta.planner,
            "mission": None if meta is None else meta.mission,
            "mission_version": None if meta is None else meta.mission_version,
            "timestamp": None if meta is None else meta.timestamp,
            "evidence": None if meta is None else meta.evidence,
        },
    }


def mission_json(verified: VerifiedMission) -> dict[str, Any]:
    """Return how a decision names its mission."""
    return {
        "mid": verified.mission.mid,
        "version": verified.mission.version,
        "digest": verified.digest,
    }


def finding_json(finding: Finding) -> dict[str, Any]:
    """Return the contract's shape of a finding."""
    return {
        "field": finding.field,
        "reason": str(finding.reason),
        "expected": finding.expected,
        "got": finding.got,
        "step": finding.step,
    }


def decision_json(judged: Judged, *, authoritative: bool) -> dict[str, Any]:
    """Return the contract's shape of a decision."""
    decision = judged.decision
    return {
        **_verdict_json(decision),
        "influenced_by": [],
        "grant": None if decision.match is None else decision.match.indexed.grant.id,
        "risk": None if decision.need is None else decision.need.risk,
        "deviation": float(judged.deviation),
        "violated_fields": list(violated_fields(decision.reasons)),
        "weights": dict(judged.weights) or EQUAL,
        "mission": mission_json(judged.verified),
        "action_digest": judged.action_digest,
        "authoritative": authoritative,
        "action": action_json(judged.action),
        "safety": safety_json(judged.safety),
    }


def plan_json(judged: Sequence[Judged], weights: Weights) -> dict[str, Any]:
    """Return how far a plan deviates, by these weights, or by the signed ones where none is given.

    Source: `eq:plan-deviation`
    """
    weighed = weights or next((item.weights for item in judged), {})
    reasons = tuple(item.decision.reasons for item in judged)
    return {
        "max": float(plan_deviation(reasons, weighed)),
        "average": float(average_deviation(reasons, weighed)),
        "weights": dict(weighed) or EQUAL,
    }


def _verdict_json(decision: Decision) -> dict[str, Any]:
    return {
        "outcome": str(decision.verdict),
        "reasons": [str(reason) for reason in decision.reasons],
        "findings": [finding_json(finding) for finding in decision.findings],
        "required_approvals": None if decision.need is None else decision.need.required,
        "retryable": decision.retryable,
    }


def safety_json(safety: SafetyDecision | None) -> Any:
    """Return the second gate's verdict, or that it was not asked."""
    if safety is None:
        return NOT_EVALUATED
    return {
        "safe": safety.safe,
        "findings": [msgspec.to_builtins(finding) for finding in safety.findings],
        "repair": None if safety.repair is None else action_json(safety.repair),
    }


def report_json(report: Report) -> dict[str, Any]:
    """Return the report of one proposal."""
    judged = report.judged
    whole = {} if judged is None else decision_json(judged, authoritative=True)
    influences = [msgspec.to_builtins(item) for item in report.influences]
    return {**whole, **_brief_json(report), "influenced_by": influences}


def _brief_json(report: Report) -> dict[str, Any]:
    """Return the part of a report that `disclosed` chooses from."""
    judged, refusal, outcome = report.judged, report.refusal, report.outcome
    if judged is None:
        body: dict[str, Any] = {
            "outcome": "reject",
            "reasons": [] if refusal is None else [str(refusal.reason)],
            "findings": []
            if refusal is None
            else [fault_finding(str(refusal.reason), refusal.where, refusal.message)],
            "retryable": refusal is not None and may_pass_later((refusal.reason,)),
            "refusal": None if refusal is None else msgspec.to_builtins(refusal),
        }
    else:
        body = _verdict_json(judged.decision)
    body["released"] = judged is not None and judged.released
    body["executed"] = outcome not in {None, Outcome.NOT_STARTED}
    body["execution"] = {
        "outcome": None if outcome is None else str(outcome),
        "reasons": [finding_json(finding) for finding in report.reasons],
        "recorded": report.outcome_recorded,
    }
    body["seq"] = report.seq
    if report.repairs is not None:
        body["repairs"] = report.repairs.seq
    return body


def told_json(report: Report, level: Disclosure) -> dict[str, Any]:
    """Return what the planner may know of a report; only that is spelled."""
    if level is Disclosure.FULL:
        return report_json(report)
    told = disclosed(_brief_json(report), level)
    safety = None if report.judged is None else report.judged.safety
    if safety is not None and not safety.safe:  # else a planner would hear of no reason at all
        told["safety"] = {"safe": False, "hazards": [str(f.hazard) for f in safety.findings]}
    return told
