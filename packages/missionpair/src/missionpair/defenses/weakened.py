# SPDX-License-Identifier: Apache-2.0
"""Both gates with one check taken out: what a fault of the gate is worth, and how soon it is found.

The product cannot be configured so; taking code out of it is the attacker's side of the house.
Option `without=CHECK`, a name such as `check_destination`. How-to:
docs/howto/missionpair-defenses.md
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import dataclass

from missionpair.ablation import CHECKS, without
from missionpair.defenses import Claim, Defense, DefenseError
from missionpair.defenses._gated import Gated
from missionpair.execution import ExecutedPlan
from missionpair.stage import Stage


@dataclass
class Weakened(Gated):
    """The product without one check.

    Args:
        missing: the check's name.
    """

    missing: str = ""

    def installed(self) -> AbstractContextManager[None]:
        """Return what makes the gate so, for as long as it is entered."""
        return without(self.missing)

    def carry_out(self, stage: Stage, raw: bytes) -> ExecutedPlan:
        """Send the plan through the product without the check."""
        with self.installed():
            return super().carry_out(stage, raw)


def make(*, without: str = "") -> Defense:
    """Return the gates without a check.

    Raises:
        DefenseError: no check has this name; says which there are.
    """
    if without not in CHECKS:
        raise DefenseError(f"`weakened` needs `without=`, one of {', '.join(CHECKS)}")
    return Weakened(
        name=f"weakened-{without.removeprefix('check_')}",
        claim=Claim(text=f"stops everything but what `{without}` alone stops"),
        parameters={"without": without},
        missing=without,
    )
