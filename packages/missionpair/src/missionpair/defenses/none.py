# SPDX-License-Identifier: Apache-2.0
"""Nothing: every plan that can be read and carried out goes straight to the robot."""

from __future__ import annotations

from missionpair.defenses import Claim, Defense
from missionpair.defenses._watched import Watched


def make() -> Defense:
    """Return no defense at all."""
    return Watched(name="none", claim=Claim(text="stops nothing"))
