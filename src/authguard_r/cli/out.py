# SPDX-License-Identifier: Apache-2.0
"""How answers look: one JSON object, or text for people. The shapes are a contract.

Spec page: docs/reference/cli.md
"""

from __future__ import annotations

import json
import sys
from typing import Any

from authguard_r.approvals.organization import VerifiedPolicy
from authguard_r.authoring.compile.change import already_there
from authguard_r.core.decision import Decision, Verdict
from authguard_r.core.errors import (
    ClarificationError,
    shown,
)
from authguard_r.core.finding import Finding
from authguard_r.core.standing import Outcome
from authguard_r.enforcement.report import Judged, Report
from authguard_r.provenance.context import Influence
from authguard_r.provenance.mentions import MentionMatch


def emit_clarification(error: ClarificationError, *, as_json: bool) -> int:
    """Print the questions that only a person can answer, with what the site knows for each."""
    asked = (error, *error.others)
    if as_json:
        questions = [
            {"field": e.field, "question": e.question, "candidates": list(e.candidates)}
            for e in asked
        ]
        told = {"code": str(error.reason), "message": error.message, "where": error.where}
        answer = {"error": told, "clarification": questions[0], "clarifications": questions}
        sys.stdout.write(json.dumps(answer) + "\n")
    else:
        for e in asked:
            sys.stderr.write(f"{e.reason}: {e.message} (at {e.where})\n")
            sys.stderr.writelines(f"  {shown(candidate)}\n" for candidate in e.candidates)
        fields = " ".join(f"--answer {shown(e.where)}=VALUE" for e in asked)
        sys.stderr.write(f"nothing was written; to answer, add: {fields}\n")
    return 3


def decision_lines(judged: Judged) -> list[str]:
    """Return a decision for people."""
    action = judged.action
    shown = " ".join(
        f"{name}={value}"
        for name, value in (
            ("object", action.object),
            ("from", action.source),
            ("to", action.destination),
            ("by", ",".join(action.route) or None),
            *action.params.items(),
        )
        if value is not None
    )
    lines = [f"{judged.decision.verdict.upper():17} {action.type} {shown}"]
    lines += [f"  {_finding_line(finding)}" for finding in judged.decision.findings]
    there = already_there(action.object, action.source, action.destination)
    if there and judged.decision.verdict is Verdict.REJECT:
        lines.append(f"  {there}")
    if judged.safety is not None and not judged.safety.safe:
        lines += [
            f"  safety gate: {f.hazard} at {f.field}: expected {f.expected}, got {f.got}"
            for f in judged.safety.findings
        ]
    return lines


def risk_policy_json(risk: VerifiedPolicy | None) -> dict[str, Any] | None:
    """Return how an answer names the organization's policy that it was worked out with."""
    if risk is None:
        return None
    own = risk.policy
    return {
        "organization": own.organization,
        "version": own.version,
        "digest": risk.digest,
        "signer": risk.signer,
    }


def report_lines(report: Report) -> list[str]:
    """Return the result of one proposal, for people."""
    if report.judged is None:
        refusal = report.refusal
        if refusal is None:
            return ["REJECT"]
        return [f"{'REJECT':17} {refusal.reason}: {refusal.message} (at {refusal.where})"]
    lines = [] if report.repairs is None else [*report_lines(report.repairs), "repaired:"]
    lines += decision_lines(report.judged)
    if report.outcome is not None:
        lines.append(f"  -> {report.outcome}")
    lines += [f"  because {_finding_line(finding)}" for finding in report.reasons]
    lines += [
        f"  influenced by {item.channel} ({item.label}): it {_mentions(item)} `{item.value}`"
        for item in report.influences
        if report.judged.decision.verdict is not Verdict.ACCEPT
    ]
    return lines


def _mentions(item: Influence) -> str:
    if item.how is MentionMatch.UNREAD:
        return "is too long to be read and may mention"
    return "mentions" if item.how is MentionMatch.EXACT else f"mentions ({item.how})"


def _finding_line(finding: Finding) -> str:
    return (
        f"({finding.step}) {finding.reason} at {finding.field}: "
        f"expected {finding.expected}, got {finding.got}"
    )


def verdict_code(decision: Decision) -> int:
    """Return the exit code of a decision."""
    return {Verdict.ACCEPT: 0, Verdict.REJECT: 1, Verdict.REQUEST_APPROVAL: 3}[decision.verdict]


def report_code(report: Report) -> int:
    """Return the exit code of one proposal."""
    if report.judged is None:
        return 4 if report.refusal is not None and report.refusal.where.startswith("input") else 1
    code = verdict_code(report.judged.decision)
    if code == 0 and report.outcome is not Outcome.SUCCEEDED:
        return 1
    return code
