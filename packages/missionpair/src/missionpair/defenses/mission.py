# SPDX-License-Identifier: Apache-2.0
"""The mission gate alone: the product with a second gate that calls everything safe.

It shows what authorization does by itself. The product cannot be configured so: the assembler of
the gate, here the attack side, puts the second gate in.
"""

from __future__ import annotations

from missionpair.defenses import Claim, Defense
from missionpair.defenses._gated import Gated
from missionpair.execution import Everything
from missionpair.words import Category

#: One for all: stages that were made with it can be used again.
_EVERYTHING = Everything()


def make() -> Defense:
    """Return the mission gate alone."""
    claim = Claim(
        text="stops every action that the signed mission does not authorize, safe or not",
        blocks=tuple(Category),
    )
    return Gated(name="mission", claim=claim, safety_gate=_EVERYTHING)
