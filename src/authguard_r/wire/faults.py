# SPDX-License-Identifier: Apache-2.0
"""Exceptions on their way through a socket: what the gate raised is what its client raises.

The family is what an exit code follows; the code, the message and the place are the exception's
own. Spec page: docs/spec/gate-protocol.md#frames
"""

from __future__ import annotations

from authguard_r.core.errors import (
    AuthenticityError,
    AuthGuardError,
    ClarificationError,
    EnvironmentFault,
    MalformedError,
    RefusedError,
)
from authguard_r.core.reasons import ORDER, Reason
from authguard_r.wire.messages import Fault, FaultFamily

#: Codes that only an environment at fault has, for a fault that names no family.
_ENVIRONMENT = frozenset(
    {
        Reason.FILE_UNAVAILABLE,
        Reason.SERVICE_UNAVAILABLE,
        Reason.SETUP_INVALID,
        Reason.STORE_UNAVAILABLE,
        Reason.STORE_FULL,
        Reason.STORE_READ_ONLY,
        Reason.STORE_CORRUPT,
        Reason.STORE_NEWER,
        Reason.CLOCK_BEHIND,
        Reason.CONTROLLER_FAILED,
        Reason.BUSY,
        Reason.INTERNAL_FAULT,
    }
)


def to_fault(error: AuthGuardError) -> Fault:
    """Return an exception as what a frame can carry."""
    return Fault(
        code=str(error.reason), message=error.message, where=error.where, family=_family(error)
    )


def from_fault(fault: Fault) -> AuthGuardError:
    """Return the exception of a fault.

    Args:
        fault: from the peer; a code that is unknown here keeps its name in the message.
    """
    known = fault.code in set(Reason)
    reason = Reason(fault.code) if known else Reason.INTERNAL_FAULT
    message = fault.message if known else f"`{fault.code}`: {fault.message}"
    family = fault.family if fault.family is not None else _family_of_code(reason)
    if family is FaultFamily.MALFORMED:
        return MalformedError(message, where=fault.where, reason=reason)
    if family is FaultFamily.AUTHENTICITY:
        return AuthenticityError(message, where=fault.where, reason=reason)
    if family is FaultFamily.CLARIFICATION:
        return ClarificationError(message, field=fault.where)
    if family is FaultFamily.REFUSED:
        return RefusedError(message, where=fault.where, reason=reason)
    return EnvironmentFault(message, where=fault.where, reason=reason)


def _family(error: AuthGuardError) -> FaultFamily:
    if isinstance(error, MalformedError):
        return FaultFamily.MALFORMED
    if isinstance(error, AuthenticityError):
        return FaultFamily.AUTHENTICITY
    if isinstance(error, ClarificationError):
        return FaultFamily.CLARIFICATION
    return FaultFamily.REFUSED if isinstance(error, RefusedError) else FaultFamily.ENVIRONMENT


def _family_of_code(reason: Reason) -> FaultFamily:
    """Return the family that most errors of a code are of."""
    if reason in _ENVIRONMENT:
        return FaultFamily.ENVIRONMENT
    if reason is Reason.CLARIFICATION_NEEDED:
        return FaultFamily.CLARIFICATION
    place = ORDER[reason]
    if place <= ORDER[Reason.WRONG_KIND] or reason is Reason.SCHEMA_INVALID:
        return FaultFamily.MALFORMED
    if place <= ORDER[Reason.ISSUER_MISMATCH]:
        return FaultFamily.AUTHENTICITY
    if ORDER[Reason.INPUT_TOO_LARGE] <= place <= ORDER[Reason.STATE_WRITING_REFUSED]:
        return FaultFamily.MALFORMED
    return FaultFamily.REFUSED
