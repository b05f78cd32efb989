# SPDX-License-Identifier: Apache-2.0
"""What the second gate reads of state: trusted, fresh, and from after the robot's last motion."""

from __future__ import annotations

import msgspec
import pytest

from authguard_r.core.identifiers import VariableId
from authguard_r.core.provenance import Label
from authguard_r.core.quantities import Now
from authguard_r.core.state import AttestedState, Reading
from authguard_r.safety.config import default_config
from authguard_r.safety.state_reading import trusted_value
from fixtures import scenarios

DISTANCE = VariableId("human_distance_mm")
CONFIG = default_config(scenarios.site(), scenarios.RID)
NOW = Now(scenarios.START_MS, scenarios.NOW.mono_ms)


def read(value: Reading, *, fence: int = 0) -> object | None:
    state = scenarios.state()
    snapshot = msgspec.structs.replace(state.snapshot, readings={DISTANCE: value})
    made: AttestedState = scenarios.attested(snapshot, fence=fence)
    return trusted_value(made, DISTANCE, config=CONFIG, now=NOW)


def reading(**changes: object) -> Reading:
    plain = Reading(value=5_000, label=Label.TRUSTED_SENSOR, age_ms=0)
    return msgspec.structs.replace(plain, **changes)


@pytest.mark.parametrize(("has", "asked", "counts"), [(0, 0, True), (3, 3, True), (4, 3, True)])
def test_a_value_from_after_the_last_motion_is_read(has: int, asked: int, counts: bool) -> None:
    assert (read(reading(fence=has), fence=asked) == 5_000) is counts


@pytest.mark.parametrize(
    "value",
    [
        reading(fence=2),
        reading(fence=3, label=Label.CAMERA),
        reading(fence=3, age_ms=CONFIG.max_age_ms + 1),
    ],
    ids=["from before", "camera", "old"],
)
def test_what_is_from_before_it_or_old_or_not_trusted_is_not(value: Reading) -> None:
    assert read(value, fence=3) is None
