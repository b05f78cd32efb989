# SPDX-License-Identifier: Apache-2.0
"""The part of the state that a safety gate trusts."""

from __future__ import annotations

from authguard_r.core.identifiers import VariableId
from authguard_r.core.provenance import Label
from authguard_r.core.quantities import Now
from authguard_r.core.state import AttestedState, age_ms
from authguard_r.safety.config import SafetyConfig


def trusted_value(
    state: AttestedState | None, variable: VariableId, *, config: SafetyConfig, now: Now
) -> object | None:
    """Return a trusted value of the configuration's own robot, fresh and since its last motion."""
    if state is None or state.snapshot.robot != config.rid:
        return None
    found = state.snapshot.readings.get(variable)
    if found is None or found.label is not Label.TRUSTED_SENSOR:
        return None
    if found.fence < state.fence or not 0 <= age_ms(state, found, now) <= config.max_age_ms:
        return None
    return found.value
