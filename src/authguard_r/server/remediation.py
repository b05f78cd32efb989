# SPDX-License-Identifier: Apache-2.0
"""What a person can do about a refusal, for every reason there is.

For whoever reads the log, never for the planner; nothing here decides anything. That the refusal
was right, and nothing is to be done, is always an answer too. Spec page: docs/reference/cli.md
"""

from __future__ import annotations

from collections.abc import Iterable

from authguard_r.core.reasons import Reason

#: What to do, and the reasons that it is the answer to; each reason stands once.
_ANSWERS: tuple[tuple[str, tuple[Reason, ...]], ...] = (
    (
        "if the work needs it, sign a next version of the mission that grants it",
        (
            Reason.CAPABILITY_EXCEEDED,
            Reason.ACTION_OUT_OF_SCOPE,
            Reason.TOOL_OUT_OF_SCOPE,
            Reason.OBJECT_OUT_OF_SCOPE,
            Reason.DESTINATION_OUT_OF_SCOPE,
            Reason.ROUTE_OUT_OF_SCOPE,
            Reason.PARAMETER_NOT_ALLOWED,
            Reason.PARAMETER_OUT_OF_BOUNDS,
            Reason.DATA_RIGHT_MISSING,
        ),
    ),
    (
        "it was not where a grant begins: authguard status; a next version may add such a row",
        (Reason.SOURCE_OUT_OF_SCOPE, Reason.OUTSIDE_REGIONS),
    ),
    (
        "used up, over or not its turn yet: sign a next version, or a mission of its own",
        (
            Reason.ORDER_VIOLATED,
            Reason.GRANT_CLOSED,
            Reason.REPEAT_EXHAUSTED,
            Reason.STARTS_EXHAUSTED,
            Reason.BUDGET_EXCEEDED,
            Reason.EXPIRED,
            Reason.SUPERSEDED,
            Reason.REVOKED,
            Reason.MISSION_COMPLETED,
        ),
    ),
    (
        "wait, then let the planner propose it again",
        (Reason.RATE_EXCEEDED, Reason.NOT_YET_VALID, Reason.BUSY),
    ),
    (
        "sign a mission and make it active: authguard mission activate",
        (Reason.NO_ACTIVE_MISSION, Reason.MISSION_UNKNOWN, Reason.MISSION_NOT_ACTIVE),
    ),
    (
        "look why it was suspended or stopped, then: authguard resume",
        (Reason.MISSION_SUSPENDED, Reason.STOPPED, Reason.TRANSITION_REFUSED, Reason.ORDER_TOO_OLD),
    ),
    (
        "let the estimator of this robot run and be heard: authguard status",
        (
            Reason.SOURCE_NOT_ATTESTED,
            Reason.STATE_FOREIGN,
            Reason.STATE_MISSING,
            Reason.STATE_UNTRUSTED,
            Reason.STATE_BEFORE_MOTION,
            Reason.STATE_STALE,
            Reason.STATE_REPLAYED,
        ),
    ),
    (
        "the world is not as the mission demands: see to it there, not in the mission",
        (Reason.GUARD_FALSE, Reason.LEASE_ENDED, Reason.BOUND_EXCEEDED),
    ),
    (
        "no operator chose it: authguard mission choose, or a next version that says who may",
        (Reason.PROVENANCE_DENIED,),
    ),
    (
        "somebody in a role that the mission names has to answer while the request lives",
        (Reason.APPROVAL_DENIED, Reason.APPROVAL_TIMEOUT, Reason.APPROVAL_REQUIRED),
    ),
    (
        "say in the binding what it means, if that may be granted: authguard binding check",
        (
            Reason.TOOL_UNKNOWN,
            Reason.FIELD_UNKNOWN,
            Reason.FIELD_REFUSED,
            Reason.STATE_WRITING_REFUSED,
        ),
    ),
    (
        "if it is real, and not the planner's word alone, name it in the site, once",
        (Reason.NAME_UNKNOWN, Reason.NAME_AMBIGUOUS),
    ),
    (
        "the planner has to say it as its binding does: authguard normalize shows what is read",
        (
            Reason.MALFORMED,
            Reason.INPUT_TOO_LARGE,
            Reason.DIALECT_UNKNOWN,
            Reason.PLAN_EMPTY,
            Reason.FIELD_MISSING,
            Reason.VALUE_INVALID,
            Reason.VALUE_OUT_OF_RANGE,
            Reason.PARAMETER_MISSING,
            Reason.CLARIFICATION_NEEDED,
            Reason.META_MISMATCH,
            Reason.KEY_REUSED,
        ),
    ),
    (
        "compile and sign the mission for this robot and this site as they are now",
        (Reason.ROBOT_MISMATCH, Reason.PROFILE_MISMATCH, Reason.SITE_MISMATCH),
    ),
    (
        "have it signed by a key that may, certified and valid now: authguard keys show",
        (
            Reason.KEY_INVALID,
            Reason.CERTIFICATE_INVALID,
            Reason.CERTIFICATE_EXPIRED,
            Reason.CERTIFICATE_REVOKED,
            Reason.REVOCATION_STALE,
            Reason.ROLE_DENIED,
            Reason.SIGNATURE_INVALID,
            Reason.SIGNATURE_MISSING,
            Reason.ISSUER_MISMATCH,
            Reason.SIGNER_OUT_OF_SCOPE,
            Reason.SCHEMA_INVALID,
            Reason.NOT_CANONICAL,
            Reason.WRONG_KIND,
        ),
    ),
    (
        "find out what became of the store, then: authguard recover",
        (Reason.ROLLED_BACK,),
    ),
    (
        "look at the gate and its machine: authguard status, authguard doctor",
        (
            Reason.STORE_UNAVAILABLE,
            Reason.STORE_FULL,
            Reason.STORE_READ_ONLY,
            Reason.STORE_CORRUPT,
            Reason.STORE_NEWER,
            Reason.CLOCK_BEHIND,
            Reason.CONTROLLER_FAILED,
            Reason.INTERNAL_FAULT,
        ),
    ),
)
MENDS: dict[Reason, str] = {reason: mend for mend, reasons in _ANSWERS for reason in reasons}
#: Of an emergency, where a mission's answer would mislead: no mission grants or allows one.
_EMERGENCY: tuple[tuple[str, tuple[Reason, ...]], ...] = (
    (
        "the policy names no such capability: authguard emergency policy show",
        (Reason.ACTION_OUT_OF_SCOPE, Reason.CAPABILITY_EXCEEDED),
    ),
    (
        "the capability is for other callers: a safety officer signs who may call it",
        (Reason.ROLE_DENIED,),
    ),
    (
        "its guards do not hold: there is no such emergency now, and nothing is to be done",
        (Reason.GUARD_FALSE,),
    ),
    (
        "the robot is not where it works: it has to be brought out of there by hand",
        (Reason.OUTSIDE_REGIONS,),
    ),
    (
        "it does not work without an active mission: a safety officer signs what works without",
        (Reason.NO_ACTIVE_MISSION,),
    ),
    (
        "an operator's stop stands: look why, then authguard resume, or activate a mission",
        (Reason.STOPPED,),
    ),
    (
        "this caller used or tried it as often in an hour as it may: find out why it is called so",
        (Reason.RATE_EXCEEDED,),
    ),
    (
        "another was under way, or the robot did not stand in time: call again",
        (Reason.BUSY,),
    ),
    (
        "a safety officer signs one for this robot as it is: authguard emergency policy make",
        (
            Reason.EXPIRED,
            Reason.NOT_YET_VALID,
            Reason.ROBOT_MISMATCH,
            Reason.PROFILE_MISMATCH,
            Reason.SITE_MISMATCH,
            Reason.CERTIFICATE_REVOKED,
        ),
    ),
)
EMERGENCY_MENDS: dict[Reason, str] = {
    **MENDS,
    **{reason: mend for mend, reasons in _EMERGENCY for reason in reasons},
}


def mends_of(codes: Iterable[object], *, emergency: bool = False) -> list[str]:
    """Return what can be done about these reasons, each once; a code that is none says nothing.

    Args:
        codes: as a record holds them.
        emergency: it was an emergency that was refused.
    """
    mends = EMERGENCY_MENDS if emergency else MENDS
    known = {str(reason): mend for reason, mend in mends.items()}
    return list(dict.fromkeys(known[str(code)] for code in codes if str(code) in known))
