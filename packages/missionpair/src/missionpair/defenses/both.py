# SPDX-License-Identifier: Apache-2.0
"""The product as it is shipped: the mission gate, then the safety gate; both have to accept."""

from __future__ import annotations

from missionpair.defenses import Claim, Defense
from missionpair.defenses._gated import Gated
from missionpair.words import Category


def make() -> Defense:
    """Return both gates."""
    claim = Claim(
        text="stops every action that the signed mission does not authorize, or that is not safe",
        blocks=tuple(Category),
    )
    return Gated(name="both", claim=claim)
