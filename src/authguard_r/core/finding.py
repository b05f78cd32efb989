# SPDX-License-Identifier: Apache-2.0
"""One violated condition, with what was expected and what was found.

Source: section "Authorization Predicate" (reason code and evidence).
"""

from __future__ import annotations

from fractions import Fraction

from msgspec import Struct

from authguard_r.core.reasons import ORDER, PROTECTED, STEP, Reason


class Finding(Struct, frozen=True):
    """A violated condition.

    Args:
        field: the place in the action, the mission or the state.
        reason: the code.
        expected: what would have passed.
        got: what was there, with its source label where the field carries authority.
    """

    field: str
    reason: Reason
    expected: str
    got: str

    @property
    def step(self) -> int:
        """The step of `alg:authguard` that found it."""
        return STEP[self.reason]


Findings = tuple[Finding, ...]


def in_paper_order(findings: Findings) -> Findings:
    """Return the findings with the primary one first, without repeats."""
    unique = dict.fromkeys(findings)
    return tuple(sorted(unique, key=lambda f: (ORDER[f.reason], f.field)))


def deviation(findings: Findings, weights: dict[Reason, int]) -> Fraction:
    """Return D_M(a): the weighted share of protected fields that are violated.

    Args:
        findings: of one action; reasons outside the protected fields do not count.
        weights: positive weight by reason; a reason that is absent weighs 1.

    Returns:
        0 exactly when no protected field is violated, 1 when all are.

    Source: `eq:action-deviation`; docs/adr/0003-authorization-indicator.md
    """
    violated = {finding.reason for finding in findings}
    total = sum(weights.get(reason, 1) for reason in PROTECTED)
    return Fraction(sum(weights.get(r, 1) for r in PROTECTED if r in violated), total)
