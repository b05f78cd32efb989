# SPDX-License-Identifier: Apache-2.0
"""How much of a refusal a planner sees, and a report cut down to that."""

from __future__ import annotations

from enum import StrEnum
from typing import Any

#: What a planner always sees.
_TOLD = (
    "outcome",
    "reasons",
    "retryable",
    "required_approvals",
    "released",
    "executed",
    "seq",
    "repairs",
)


class Disclosure(StrEnum):
    """How much of a refusal the planner sees.

    `codes`: reasons only. `fields`: the field of each finding too, not what was expected there.
    `full`: everything that the operator sees, but for the smallest change.
    """

    CODES = "codes"
    FIELDS = "fields"
    FULL = "full"


def disclosed(report: dict[str, Any], level: Disclosure) -> dict[str, Any]:
    """Return what the planner may know of a report, or of a decision that was not carried out."""
    if level is Disclosure.FULL:
        return report
    told = {key: report[key] for key in _TOLD if key in report}
    if "execution" in report:
        execution = report["execution"]
        told["execution"] = {**execution, "reasons": [f["reason"] for f in execution["reasons"]]}
    if level is Disclosure.FIELDS:
        findings = report.get("findings", ())
        told["findings"] = [{key: f[key] for key in ("field", "reason", "step")} for f in findings]
        told["refusal"] = report.get("refusal")
    return told
