# SPDX-License-Identifier: Apache-2.0
"""What the gate answers: a verdict, what speaks against the action, and what it was held against.

Only `core.decide` makes one. Source: `alg:authguard`. Spec page: docs/spec/decision.md
"""

from __future__ import annotations

from enum import StrEnum

from msgspec import Struct

from authguard_r.core.checks.approval import Need
from authguard_r.core.finding import Findings
from authguard_r.core.identifiers import Digest
from authguard_r.core.mission import Row
from authguard_r.core.reasons import Reason, may_pass_later
from authguard_r.core.token import IndexedGrant


class Verdict(StrEnum):
    """The three answers of `alg:authguard`."""

    ACCEPT = "accept"
    REJECT = "reject"
    REQUEST_APPROVAL = "request_approval"


class Match(Struct, frozen=True, kw_only=True):
    """The grant and row that fit best, and what still speaks against them."""

    indexed: IndexedGrant
    row: Row
    findings: Findings


class Decision(Struct, frozen=True, kw_only=True):
    """What the gate decided and why. Not a truth value: read `verdict`.

    Args:
        verdict: the answer.
        findings: every violated condition, primary first; empty exactly for `accept`.
        match: the grant and row that the action was held against; None when step 1 stopped.
        need: how many principals it takes, and what they must sign; None when step 1 stopped.
        preapproved: digest of the pre-approval that stands in for approvals; None: none does.
    """

    verdict: Verdict
    findings: Findings
    match: Match | None
    need: Need | None
    preapproved: Digest | None = None

    def __bool__(self) -> bool:
        raise TypeError("a decision has no truth value; compare `.verdict`")

    @property
    def reasons(self) -> tuple[Reason, ...]:
        """The codes of the findings, primary first, each once."""
        return tuple(dict.fromkeys(finding.reason for finding in self.findings))

    @property
    def retryable(self) -> bool:
        """True when the same proposal may pass later without a new signature."""
        return may_pass_later(self.reasons)
