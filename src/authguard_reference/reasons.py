# SPDX-License-Identifier: Apache-2.0
"""The reason codes in their normative order (steps of `alg:authguard`).

PROTECTED are the fields j of `eq:action-deviation`.
"""

from collections.abc import Iterable

ORDER: list[str] = [
    "MALFORMED",
    "NOT_CANONICAL",
    "WRONG_KIND",
    "KEY_INVALID",
    "CERTIFICATE_INVALID",
    "CERTIFICATE_EXPIRED",
    "CERTIFICATE_REVOKED",
    "REVOCATION_STALE",
    "ROLE_DENIED",
    "SIGNATURE_INVALID",
    "SIGNATURE_MISSING",
    "ISSUER_MISMATCH",
    "SIGNER_OUT_OF_SCOPE",
    "SCHEMA_INVALID",
    "NOT_YET_VALID",
    "EXPIRED",
    "MISSION_UNKNOWN",
    "MISSION_NOT_ACTIVE",
    "MISSION_SUSPENDED",
    "MISSION_COMPLETED",
    "REVOKED",
    "SUPERSEDED",
    "ROBOT_MISMATCH",
    "PROFILE_MISMATCH",
    "SITE_MISMATCH",
    "META_MISMATCH",
    "CAPABILITY_EXCEEDED",
    "ACTION_OUT_OF_SCOPE",
    "TOOL_OUT_OF_SCOPE",
    "OBJECT_OUT_OF_SCOPE",
    "SOURCE_OUT_OF_SCOPE",
    "SOURCE_NOT_ATTESTED",
    "OUTSIDE_REGIONS",
    "DESTINATION_OUT_OF_SCOPE",
    "ROUTE_OUT_OF_SCOPE",
    "PARAMETER_MISSING",
    "PARAMETER_NOT_ALLOWED",
    "PARAMETER_OUT_OF_BOUNDS",
    "DATA_RIGHT_MISSING",
    "ORDER_VIOLATED",
    "GRANT_CLOSED",
    "REPEAT_EXHAUSTED",
    "STARTS_EXHAUSTED",
    "RATE_EXCEEDED",
    "BUDGET_EXCEEDED",
    "STATE_FOREIGN",
    "STATE_MISSING",
    "STATE_UNTRUSTED",
    "STATE_BEFORE_MOTION",
    "STATE_STALE",
    "GUARD_FALSE",
    "PROVENANCE_DENIED",
    "APPROVAL_DENIED",
    "APPROVAL_TIMEOUT",
    "APPROVAL_REQUIRED",
    "LEASE_ENDED",
    "BOUND_EXCEEDED",
    "INPUT_TOO_LARGE",
    "DIALECT_UNKNOWN",
    "PLAN_EMPTY",
    "TOOL_UNKNOWN",
    "FIELD_UNKNOWN",
    "FIELD_MISSING",
    "FIELD_REFUSED",
    "VALUE_INVALID",
    "VALUE_OUT_OF_RANGE",
    "NAME_UNKNOWN",
    "NAME_AMBIGUOUS",
    "STATE_WRITING_REFUSED",
    "CLARIFICATION_NEEDED",
    "NO_ACTIVE_MISSION",
    "TRANSITION_REFUSED",
    "STATE_REPLAYED",
    "STORE_UNAVAILABLE",
    "STORE_FULL",
    "STORE_READ_ONLY",
    "STORE_CORRUPT",
    "STORE_NEWER",
    "CLOCK_BEHIND",
    "CONTROLLER_FAILED",
    "STOPPED",
    "BUSY",
    "KEY_REUSED",
    "INTERNAL_FAULT",
]

PROTECTED: list[str] = [
    "CERTIFICATE_EXPIRED",
    *ORDER[ORDER.index("NOT_YET_VALID") : ORDER.index("APPROVAL_REQUIRED") + 1],
]


def in_order(codes: Iterable[str]) -> list[str]:
    """Put codes into the normative order, each once.

    Args:
        codes: Reason codes in any order, repeats allowed.

    Returns:
        The same codes, unique, in ORDER.
    """
    found = set(codes)
    return [code for code in ORDER if code in found]
