# SPDX-License-Identifier: Apache-2.0
"""When a refused proposal may pass later without a new signature."""

from __future__ import annotations

import pytest

from authguard_r.core.reasons import Reason, may_pass_later


@pytest.mark.parametrize(
    ("reasons", "may"),
    [
        ((), False),
        ((Reason.GUARD_FALSE,), True),
        ((Reason.GUARD_FALSE, Reason.RATE_EXCEEDED), True),
        ((Reason.OBJECT_OUT_OF_SCOPE,), False),
        ((Reason.GUARD_FALSE, Reason.OBJECT_OUT_OF_SCOPE), False),
        # on state from before the motion the gate may have found the wrong place or grant
        ((Reason.SOURCE_OUT_OF_SCOPE, Reason.STATE_BEFORE_MOTION), True),
        ((Reason.STATE_BEFORE_MOTION,), True),
    ],
)
def test_a_refusal_may_pass_later_if_all_its_reasons_may_or_its_state_was_old(
    reasons: tuple[Reason, ...], may: bool
) -> None:
    assert may_pass_later(reasons) is may
