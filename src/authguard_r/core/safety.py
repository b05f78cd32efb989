# SPDX-License-Identifier: Apache-2.0
"""What the second gate answers, in words of its own.

Kept apart from `Reason` on purpose: the two gates share no vocabulary, so that neither can be
read as the other. Source: `eq:execute`, section "Design Principle".
"""

from __future__ import annotations

from enum import StrEnum

from msgspec import Struct

from authguard_r.core.action import Action


class Hazard(StrEnum):
    """Why an action is unsafe."""

    SPEED = "SPEED"
    FORCE = "FORCE"
    PAYLOAD = "PAYLOAD"
    KEEP_OUT = "KEEP_OUT"
    HUMAN_PROXIMITY = "HUMAN_PROXIMITY"
    NOT_EXECUTABLE = "NOT_EXECUTABLE"
    STATE_UNKNOWN = "STATE_UNKNOWN"
    RULE = "RULE"


class SafetyFinding(Struct, frozen=True):
    """One hazard: which, where in the action, what would be safe, what was asked."""

    hazard: Hazard
    field: str
    expected: str
    got: str


class SafetyDecision(Struct, frozen=True, kw_only=True):
    """The second gate's verdict.

    Args:
        safe: no hazard was found.
        findings: every hazard, in the order of the rules.
        repair: an action that the gate would call safe; it is a new proposal, never released
            by itself.
        memory: what the gate is to be given back: while it is not known whether the action took
            place, and from when it succeeded; empty of a gate that remembers nothing.
    """

    safe: bool
    findings: tuple[SafetyFinding, ...] = ()
    repair: Action | None = None
    memory: tuple[bytes, bytes] = (b"", b"")

    def __bool__(self) -> bool:
        raise TypeError("a safety decision has no truth value; read `.safe`")
