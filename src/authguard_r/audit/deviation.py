# SPDX-License-Identifier: Apache-2.0
"""How far an action deviates from its mission: measured and logged, authorizes nothing.

A field j is violated (d_j = 1) when a finding has one of its reason codes.
Source: `eq:action-deviation`. Spec page: docs/spec/reason-codes.md#protected-fields
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from fractions import Fraction

from authguard_r.core.mission import ProtectedField, RiskPolicy
from authguard_r.core.reasons import Reason

#: Where each run of reason codes begins, in the order of `Reason`; None: no field of a mission.
_FIRST_OF_FIELD: dict[Reason, ProtectedField | None] = {
    Reason.MALFORMED: None,
    Reason.KEY_INVALID: ProtectedField.MISSION,
    Reason.NOT_YET_VALID: ProtectedField.TIME,
    Reason.MISSION_UNKNOWN: ProtectedField.MISSION,
    Reason.ROBOT_MISMATCH: ProtectedField.ROBOT,
    Reason.META_MISMATCH: ProtectedField.MISSION,
    Reason.CAPABILITY_EXCEEDED: ProtectedField.ROBOT,
    Reason.ACTION_OUT_OF_SCOPE: ProtectedField.TYPE,
    Reason.TOOL_OUT_OF_SCOPE: ProtectedField.TOOL,
    Reason.OBJECT_OUT_OF_SCOPE: ProtectedField.OBJECT,
    Reason.SOURCE_OUT_OF_SCOPE: ProtectedField.SOURCE,
    Reason.DESTINATION_OUT_OF_SCOPE: ProtectedField.DESTINATION,
    Reason.ROUTE_OUT_OF_SCOPE: ProtectedField.ROUTE,
    Reason.PARAMETER_MISSING: ProtectedField.PARAMETERS,
    Reason.ORDER_VIOLATED: ProtectedField.ORDER,
    Reason.REPEAT_EXHAUSTED: ProtectedField.USE,
    Reason.STATE_FOREIGN: ProtectedField.STATE,
    Reason.PROVENANCE_DENIED: ProtectedField.PROVENANCE,
    Reason.APPROVAL_DENIED: ProtectedField.APPROVAL,
    Reason.LEASE_ENDED: ProtectedField.TIME,
    Reason.BOUND_EXCEEDED: ProtectedField.PARAMETERS,
    Reason.INPUT_TOO_LARGE: None,
    Reason.NO_ACTIVE_MISSION: ProtectedField.MISSION,
    Reason.TRANSITION_REFUSED: None,
}


def _fields() -> Iterable[tuple[Reason, ProtectedField]]:
    field: ProtectedField | None = None
    for reason in Reason:
        field = _FIRST_OF_FIELD.get(reason, field)
        if field is not None:
            yield reason, field


#: The one field that each code violates. A code that compares no action with a mission has none.
FIELD_OF: dict[Reason, ProtectedField] = dict(_fields())

#: w_j by field; a field that is absent weighs 1.
Weights = Mapping[ProtectedField, int]


def violated_fields(reasons: Iterable[Reason]) -> tuple[ProtectedField, ...]:
    """Return the fields that the codes violate, each once, in order."""
    found = {FIELD_OF.get(reason) for reason in reasons}
    return tuple(field for field in ProtectedField if field in found)


def deviation(reasons: Iterable[Reason], weights: Weights) -> Fraction:
    """Return D_M(a): the weighted share of the protected fields that are violated.

    Args:
        reasons: codes of one action's findings.
        weights: w_j, each above zero; a field that is absent weighs 1.

    Returns:
        0 exactly when no field is violated, 1 when all are.

    Source: `eq:action-deviation`
    """
    total = sum(weights.get(field, 1) for field in ProtectedField)
    return Fraction(sum(weights.get(field, 1) for field in violated_fields(reasons)), total)


def weights_of(mission: RiskPolicy, organization: tuple[RiskPolicy, ...]) -> Weights:
    """Return the signed w_j of D_M: the mission's, or else the organization's."""
    return next((p.field_weights for p in (mission, *organization) if p.field_weights), {})
