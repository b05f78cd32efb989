# SPDX-License-Identifier: Apache-2.0
"""Every reason a refusal can have, in paper order, and the step of `alg:authguard` it belongs to.

The order of the members is the order in which findings are reported: the first is primary.
Spec page: docs/spec/reason-codes.md. A test holds that page and this list together.
"""

from __future__ import annotations

from enum import StrEnum


class Reason(StrEnum):
    """A refusal's code. The paper's spelling where it has one; ours follows its manner."""

    # (0) before there is an object to judge
    MALFORMED = "MALFORMED"
    NOT_CANONICAL = "NOT_CANONICAL"
    WRONG_KIND = "WRONG_KIND"
    # (1) certificate
    KEY_INVALID = "KEY_INVALID"
    CERTIFICATE_INVALID = "CERTIFICATE_INVALID"
    CERTIFICATE_EXPIRED = "CERTIFICATE_EXPIRED"
    CERTIFICATE_REVOKED = "CERTIFICATE_REVOKED"
    REVOCATION_STALE = "REVOCATION_STALE"
    ROLE_DENIED = "ROLE_DENIED"
    # (2) signature
    SIGNATURE_INVALID = "SIGNATURE_INVALID"
    SIGNATURE_MISSING = "SIGNATURE_MISSING"
    ISSUER_MISMATCH = "ISSUER_MISMATCH"
    SIGNER_OUT_OF_SCOPE = "SIGNER_OUT_OF_SCOPE"
    # (3) schema and time
    SCHEMA_INVALID = "SCHEMA_INVALID"
    NOT_YET_VALID = "NOT_YET_VALID"
    EXPIRED = "EXPIRED"
    # (4) registry
    MISSION_UNKNOWN = "MISSION_UNKNOWN"
    MISSION_NOT_ACTIVE = "MISSION_NOT_ACTIVE"
    MISSION_SUSPENDED = "MISSION_SUSPENDED"
    MISSION_COMPLETED = "MISSION_COMPLETED"
    REVOKED = "REVOKED"
    SUPERSEDED = "SUPERSEDED"
    # (5) robot
    ROBOT_MISMATCH = "ROBOT_MISMATCH"
    PROFILE_MISMATCH = "PROFILE_MISMATCH"
    SITE_MISMATCH = "SITE_MISMATCH"
    # (6) membership in the policy, in the order of `eq:auth-predicate`
    META_MISMATCH = "META_MISMATCH"
    CAPABILITY_EXCEEDED = "CAPABILITY_EXCEEDED"
    ACTION_OUT_OF_SCOPE = "ACTION_OUT_OF_SCOPE"
    TOOL_OUT_OF_SCOPE = "TOOL_OUT_OF_SCOPE"
    OBJECT_OUT_OF_SCOPE = "OBJECT_OUT_OF_SCOPE"
    SOURCE_OUT_OF_SCOPE = "SOURCE_OUT_OF_SCOPE"
    SOURCE_NOT_ATTESTED = "SOURCE_NOT_ATTESTED"
    OUTSIDE_REGIONS = "OUTSIDE_REGIONS"
    DESTINATION_OUT_OF_SCOPE = "DESTINATION_OUT_OF_SCOPE"
    ROUTE_OUT_OF_SCOPE = "ROUTE_OUT_OF_SCOPE"
    PARAMETER_MISSING = "PARAMETER_MISSING"
    PARAMETER_NOT_ALLOWED = "PARAMETER_NOT_ALLOWED"
    PARAMETER_OUT_OF_BOUNDS = "PARAMETER_OUT_OF_BOUNDS"
    DATA_RIGHT_MISSING = "DATA_RIGHT_MISSING"
    ORDER_VIOLATED = "ORDER_VIOLATED"
    GRANT_CLOSED = "GRANT_CLOSED"
    REPEAT_EXHAUSTED = "REPEAT_EXHAUSTED"
    STARTS_EXHAUSTED = "STARTS_EXHAUSTED"
    RATE_EXCEEDED = "RATE_EXCEEDED"
    BUDGET_EXCEEDED = "BUDGET_EXCEEDED"
    STATE_FOREIGN = "STATE_FOREIGN"
    STATE_MISSING = "STATE_MISSING"
    STATE_UNTRUSTED = "STATE_UNTRUSTED"
    STATE_BEFORE_MOTION = "STATE_BEFORE_MOTION"
    STATE_STALE = "STATE_STALE"
    GUARD_FALSE = "GUARD_FALSE"
    PROVENANCE_DENIED = "PROVENANCE_DENIED"
    # (7) approval
    APPROVAL_DENIED = "APPROVAL_DENIED"
    APPROVAL_TIMEOUT = "APPROVAL_TIMEOUT"
    APPROVAL_REQUIRED = "APPROVAL_REQUIRED"
    # the lease, while the robot moves
    LEASE_ENDED = "LEASE_ENDED"
    BOUND_EXCEEDED = "BOUND_EXCEEDED"
    # normalizing: nothing was decided
    INPUT_TOO_LARGE = "INPUT_TOO_LARGE"
    DIALECT_UNKNOWN = "DIALECT_UNKNOWN"
    PLAN_EMPTY = "PLAN_EMPTY"
    TOOL_UNKNOWN = "TOOL_UNKNOWN"
    FIELD_UNKNOWN = "FIELD_UNKNOWN"
    FIELD_MISSING = "FIELD_MISSING"
    FIELD_REFUSED = "FIELD_REFUSED"
    VALUE_INVALID = "VALUE_INVALID"
    VALUE_OUT_OF_RANGE = "VALUE_OUT_OF_RANGE"
    NAME_UNKNOWN = "NAME_UNKNOWN"
    NAME_AMBIGUOUS = "NAME_AMBIGUOUS"
    STATE_WRITING_REFUSED = "STATE_WRITING_REFUSED"
    CLARIFICATION_NEEDED = "CLARIFICATION_NEEDED"
    # the enforcer and its world
    NO_ACTIVE_MISSION = "NO_ACTIVE_MISSION"
    TRANSITION_REFUSED = "TRANSITION_REFUSED"
    ORDER_TOO_OLD = "ORDER_TOO_OLD"
    STATE_REPLAYED = "STATE_REPLAYED"
    FILE_UNAVAILABLE = "FILE_UNAVAILABLE"
    SERVICE_UNAVAILABLE = "SERVICE_UNAVAILABLE"
    SETUP_INVALID = "SETUP_INVALID"
    STORE_UNAVAILABLE = "STORE_UNAVAILABLE"
    STORE_FULL = "STORE_FULL"
    STORE_READ_ONLY = "STORE_READ_ONLY"
    STORE_CORRUPT = "STORE_CORRUPT"
    STORE_NEWER = "STORE_NEWER"
    ROLLED_BACK = "ROLLED_BACK"
    CLOCK_BEHIND = "CLOCK_BEHIND"
    CONTROLLER_FAILED = "CONTROLLER_FAILED"
    STOPPED = "STOPPED"
    BUSY = "BUSY"
    KEY_REUSED = "KEY_REUSED"
    INTERNAL_FAULT = "INTERNAL_FAULT"


ORDER: dict[Reason, int] = {reason: place for place, reason in enumerate(Reason)}

_FIRST_OF_STEP: dict[Reason, int] = {
    Reason.MALFORMED: 0,
    Reason.KEY_INVALID: 1,
    Reason.SIGNATURE_INVALID: 2,
    Reason.SCHEMA_INVALID: 3,
    Reason.MISSION_UNKNOWN: 4,
    Reason.ROBOT_MISMATCH: 5,
    Reason.META_MISMATCH: 6,
    Reason.APPROVAL_DENIED: 7,
    Reason.LEASE_ENDED: 9,
    Reason.INPUT_TOO_LARGE: 0,
    Reason.NO_ACTIVE_MISSION: 4,
    Reason.STATE_REPLAYED: 8,
}


STEP: dict[Reason, int] = {
    reason: [step for first, step in _FIRST_OF_STEP.items() if ORDER[first] <= ORDER[reason]][-1]
    for reason in Reason
}

#: What `decide` itself can find, registry, robot, policy and approvals included
#: (docs/adr/0003-authorization-indicator.md).
DECIDED: tuple[Reason, ...] = (
    Reason.CERTIFICATE_EXPIRED,
    *tuple(Reason)[ORDER[Reason.NOT_YET_VALID] : ORDER[Reason.APPROVAL_REQUIRED] + 1],
)

#: Reasons that can pass without a new signature: the same proposal may be tried again later.
RETRYABLE: tuple[Reason, ...] = (
    Reason.NOT_YET_VALID,
    Reason.REVOCATION_STALE,
    Reason.MISSION_NOT_ACTIVE,
    Reason.MISSION_SUSPENDED,
    Reason.SOURCE_NOT_ATTESTED,
    Reason.ORDER_VIOLATED,
    Reason.RATE_EXCEEDED,
    Reason.STATE_MISSING,
    Reason.STATE_BEFORE_MOTION,
    Reason.STATE_STALE,
    Reason.GUARD_FALSE,
    Reason.APPROVAL_TIMEOUT,
    Reason.APPROVAL_REQUIRED,
    Reason.SERVICE_UNAVAILABLE,
    Reason.STORE_UNAVAILABLE,
    Reason.STORE_FULL,
    Reason.CLOCK_BEHIND,
    Reason.CONTROLLER_FAILED,
    Reason.BUSY,
)


def may_pass_later(reasons: tuple[Reason, ...]) -> bool:
    """Say whether a refusal for these may pass later: newer state may settle the others, too."""
    return Reason.STATE_BEFORE_MOTION in reasons or bool(reasons and {*reasons} <= {*RETRYABLE})
