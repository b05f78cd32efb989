# SPDX-License-Identifier: Apache-2.0
"""Defenses that are the product, with one second gate or another."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from authguard_r.core.ports import SafetyGate
from missionpair.briefing import Briefing
from missionpair.defenses import Claim, DefenseError
from missionpair.execution import ExecutedPlan, through_the_gate
from missionpair.stage import Stage


@dataclass
class Gated:
    """The product itself.

    Args:
        name: as `--defense` takes it.
        claim: what it stops.
        safety_gate: the second gate; None: the one that a stage has anyway.
        parameters: everything that shapes it.
        simulated: never: it is the thing itself.
    """

    name: str
    claim: Claim
    safety_gate: SafetyGate | None = None
    parameters: dict[str, Any] = field(default_factory=dict)
    simulated: bool = False

    def begin(self, *, seed: int) -> None:
        """Do nothing: what is remembered lies in the gate's own store."""

    def brief(self, briefing: Briefing) -> Briefing:
        """Return the same: a planner sees nothing of its gate."""
        return briefing

    def carry_out(self, stage: Stage, raw: bytes) -> ExecutedPlan:
        """Send the plan through the product.

        Raises:
            DefenseError: the stage has another second gate than this defense is about.
        """
        if self.safety_gate is not None and stage.safety_gate is not self.safety_gate:
            raise DefenseError(
                f"`{self.name}` needs a stage that was made with its own second gate: "
                "`yard.stage(..., safety_gate=defense.safety_gate)`"
            )
        return through_the_gate(stage, raw)
