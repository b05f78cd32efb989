# SPDX-License-Identifier: Apache-2.0
"""One violated condition, with what was expected and what was found.

Source: section "Authorization Predicate" (reason code and evidence).
"""

from __future__ import annotations

from msgspec import Struct

from authguard_r.core.errors import AuthGuardError
from authguard_r.core.reasons import ORDER, STEP, Reason


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


def fault_finding(error: AuthGuardError) -> Finding:
    """Return an exception as the finding that ends a lease."""
    return Finding(error.where or "gate", error.reason, "a working part", error.message)
