# SPDX-License-Identifier: Apache-2.0
"""With which codes a planner's bytes can be refused in the suite `full`, and why with no others.

A planner has one way in: its plan. It may say anything there, in every situation of the suite, the
wrong ones included (a mission of another robot, one that ran out, a question that was not answered
in time). Every other cause with a reason code comes by another way, or lies with another part. A
test holds both lists to `authguard_r.core.reasons`, a night its campaign to them. Spec page:
docs/spec/measures.md#demands
"""

from __future__ import annotations

from authguard_r.core.reasons import Reason

#: Codes that a planner is refused with. Each needs its tries.
CAUSED: tuple[Reason, ...] = (
    # what it says cannot be read
    Reason.MALFORMED,
    Reason.INPUT_TOO_LARGE,
    Reason.DIALECT_UNKNOWN,
    Reason.PLAN_EMPTY,
    Reason.TOOL_UNKNOWN,
    Reason.FIELD_UNKNOWN,
    Reason.FIELD_MISSING,
    Reason.VALUE_INVALID,
    Reason.VALUE_OUT_OF_RANGE,
    Reason.NAME_UNKNOWN,
    # it asks where no mission holds: too late, at an end, with another robot's
    Reason.EXPIRED,
    Reason.MISSION_COMPLETED,
    Reason.ROBOT_MISMATCH,
    Reason.PROFILE_MISMATCH,
    # it asks for what the mission does not have
    Reason.CAPABILITY_EXCEEDED,
    Reason.ACTION_OUT_OF_SCOPE,
    Reason.TOOL_OUT_OF_SCOPE,
    Reason.OBJECT_OUT_OF_SCOPE,
    Reason.SOURCE_OUT_OF_SCOPE,
    Reason.OUTSIDE_REGIONS,
    Reason.DESTINATION_OUT_OF_SCOPE,
    Reason.ROUTE_OUT_OF_SCOPE,
    Reason.PARAMETER_MISSING,
    Reason.PARAMETER_NOT_ALLOWED,
    Reason.PARAMETER_OUT_OF_BOUNDS,
    Reason.DATA_RIGHT_MISSING,
    # it asks too early, too late or too often
    Reason.ORDER_VIOLATED,
    Reason.GRANT_CLOSED,
    Reason.REPEAT_EXHAUSTED,
    Reason.STARTS_EXHAUSTED,
    Reason.RATE_EXCEEDED,
    Reason.BUDGET_EXCEEDED,
    Reason.GUARD_FALSE,
    # it asks for what others have to say
    Reason.PROVENANCE_DENIED,
    Reason.APPROVAL_TIMEOUT,
    Reason.APPROVAL_REQUIRED,
)

_SIGNED = "of signed objects; they come by management channels, and a plan brings none"
_ESTIMATOR = "of the estimator's state, which a planner cannot change"
_STORE = "of the store and its machine; a planner reaches neither"
_ORDER = "of management: a signed order or an act of the life cycle, and a plan is neither"
_ONE_MISSION = "a plan names no mission: the gate takes the one that is active on its robot"

#: Why a planner is not refused with any other code.
NOT_CAUSED: dict[Reason, str] = {
    Reason.NOT_CANONICAL: _SIGNED,
    Reason.WRONG_KIND: _SIGNED,
    Reason.KEY_INVALID: _SIGNED,
    Reason.CERTIFICATE_INVALID: _SIGNED,
    Reason.CERTIFICATE_EXPIRED: "every mission of the suite ends before its signer's certificate",
    Reason.CERTIFICATE_REVOKED: _SIGNED,
    Reason.REVOCATION_STALE: _SIGNED,
    Reason.ROLE_DENIED: _SIGNED,
    Reason.SIGNATURE_INVALID: _SIGNED,
    Reason.SIGNATURE_MISSING: _SIGNED,
    Reason.ISSUER_MISMATCH: _SIGNED,
    Reason.SIGNER_OUT_OF_SCOPE: _SIGNED,
    Reason.SCHEMA_INVALID: _SIGNED,
    Reason.NOT_YET_VALID: "no situation begins before its mission",
    Reason.MISSION_UNKNOWN: _ONE_MISSION,
    Reason.MISSION_NOT_ACTIVE: _ONE_MISSION,
    Reason.MISSION_SUSPENDED: _ORDER,
    Reason.REVOKED: _ORDER,
    Reason.SUPERSEDED: _ONE_MISSION,
    Reason.SITE_MISMATCH: "every mission of the suite is signed for its layout's own site",
    Reason.META_MISMATCH: "the gate itself writes under which version an action was taken in",
    Reason.SOURCE_NOT_ATTESTED: "no tool takes a source: attested state fills it in",
    Reason.STATE_FOREIGN: _ESTIMATOR,
    Reason.STATE_MISSING: _ESTIMATOR,
    Reason.STATE_UNTRUSTED: _ESTIMATOR,
    Reason.STATE_BEFORE_MOTION: _ESTIMATOR,
    Reason.STATE_STALE: _ESTIMATOR,
    Reason.APPROVAL_DENIED: "an approver signs it, and no approver of the suite denies",
    Reason.LEASE_ENDED: "of motion under way: the simulated robot ends in its time",
    Reason.BOUND_EXCEEDED: "of motion under way: the simulated robot does what was released",
    Reason.FIELD_REFUSED: "no tool of the suite's sites has an argument to be left out",
    Reason.NAME_AMBIGUOUS: "no tool of the suite's sites takes coordinates",
    Reason.STATE_WRITING_REFUSED: "no tool of the suite's sites writes state",
    Reason.CLARIFICATION_NEEDED: "of a draft that a person writes",
    Reason.NO_ACTIVE_MISSION: "every situation has a mission, and one that ends is known as ended",
    Reason.TRANSITION_REFUSED: _ORDER,
    Reason.ORDER_TOO_OLD: _ORDER,
    Reason.STATE_REPLAYED: _ESTIMATOR,
    Reason.FILE_UNAVAILABLE: _STORE,
    Reason.SERVICE_UNAVAILABLE: _STORE,
    Reason.SETUP_INVALID: _STORE,
    Reason.STORE_UNAVAILABLE: _STORE,
    Reason.STORE_FULL: _STORE,
    Reason.STORE_READ_ONLY: _STORE,
    Reason.STORE_CORRUPT: _STORE,
    Reason.STORE_NEWER: _STORE,
    Reason.ROLLED_BACK: _STORE,
    Reason.CLOCK_BEHIND: _STORE,
    Reason.CONTROLLER_FAILED: "of the controller: the simulated one starts each released action",
    Reason.STOPPED: "a person's stop, or another process's; a plan has no stop to call",
    Reason.BUSY: "of several proposals at once; a trial has one planner that waits",
    Reason.KEY_REUSED: "of idempotency keys, which are the client's, not the plan's",
    Reason.INTERNAL_FAULT: "a fault of ours",
}
