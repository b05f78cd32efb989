# SPDX-License-Identifier: Apache-2.0
"""Conditions on attested state: present, of this robot, from a trusted sensor, fresh, true.

Absent is not compliant. Types are compared before values: `true` is not 1, "3" is not 3.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

from authguard_r.core.finding import Finding
from authguard_r.core.identifiers import RobotId
from authguard_r.core.mission import Comparison, Guard
from authguard_r.core.provenance import Label
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.core.state import AttestedState, Pose, Reading, age_ms

#: The comparisons have the names of Python's own.
_HOLDS: dict[Comparison, Callable[[Any, Any], bool]] = {c: getattr(operator, c) for c in Comparison}


def guard_finding(
    guard: Guard, state: AttestedState | None, rid: RobotId, now: Now
) -> Finding | None:
    """Return why the guard does not hold, or None when it does.

    Args:
        guard: the signed condition.
        state: what an estimator attested, None when nothing was.
        rid: the robot that the state must speak of.
        now: the instant at which freshness is measured.
    """
    field = f"state.{guard.variable}"
    reading = state.snapshot.readings.get(guard.variable) if state is not None else None
    unfit = unfit_finding(field, reading, state, rid=rid, now=now, max_age_ms=guard.max_age_ms)
    if unfit is not None or reading is None:
        return unfit
    if _holds(guard, reading.value):
        return None
    expected = f"{guard.comparison} {guard.value}"
    return Finding(field, Reason.GUARD_FALSE, expected, str(reading.value))


def unfit_finding(
    field: str,
    reading: Reading | Pose | None,
    state: AttestedState | None,
    *,
    rid: RobotId,
    now: Now,
    max_age_ms: int,
) -> Finding | None:
    """Return why a value may not be relied on, or None when it may."""
    if state is not None and state.snapshot.robot != rid:
        return Finding(field, Reason.STATE_FOREIGN, rid, state.snapshot.robot)
    if state is None or reading is None:
        return Finding(field, Reason.STATE_MISSING, "an attested value", "none")
    if reading.label is not Label.TRUSTED_SENSOR:
        return Finding(field, Reason.STATE_UNTRUSTED, Label.TRUSTED_SENSOR, reading.label)
    if reading.fence < state.fence:
        wanted, got = f"at least fence {state.fence}", f"fence {reading.fence}"
        return Finding(field, Reason.STATE_BEFORE_MOTION, wanted, got)
    age = age_ms(state, reading, now)
    if not 0 <= age <= max_age_ms:
        return Finding(field, Reason.STATE_STALE, f"at most {max_age_ms} ms old", f"{age} ms")
    return None


def _holds(guard: Guard, value: object) -> bool:
    ordered = type(value) is int or guard.comparison in {Comparison.EQ, Comparison.NE}
    same = type(value) is type(guard.value)
    return same and ordered and _HOLDS[guard.comparison](value, guard.value)
