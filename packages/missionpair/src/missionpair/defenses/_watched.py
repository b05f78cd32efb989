# SPDX-License-Identifier: Apache-2.0
"""Defenses that look at each action on its way into the world, and have no part of the product."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from authguard_r.core.action import Action
from authguard_r.core.ports import SafetyGate
from missionpair.briefing import Briefing
from missionpair.defenses import Claim
from missionpair.execution import Denied, ExecutedPlan, Permits, past_the_gate
from missionpair.judging import Walk
from missionpair.stage import Stage


def everything(action: Action, walk: Walk) -> Denied | None:  # noqa: ARG001 - `Permits`
    """Let every action through."""
    return None


@dataclass
class Watched:
    """A defense that permits an action or does not, and remembers nothing of a trial.

    Args:
        name: as `--defense` takes it.
        claim: what it stops.
        permits_for: what judges the actions of a plan, once the situation is known.
        parameters: everything that shapes it.
        rule: what it adds to a planner's rules; empty adds nothing.
        simulated: it stands for something that was not run.
        safety_gate: the product's gate has no part here.
    """

    name: str
    claim: Claim
    permits_for: Callable[[Stage], Permits] = lambda _: everything
    parameters: dict[str, Any] = field(default_factory=dict)
    rule: str = ""
    simulated: bool = False
    safety_gate: SafetyGate | None = None

    def begin(self, *, seed: int) -> None:
        """Do nothing: nothing is remembered."""

    def brief(self, briefing: Briefing) -> Briefing:
        """Return the briefing with the rule, where there is one, at the end of its rules."""
        if not self.rule:
            return briefing
        rules = f"{briefing.rules}\n{self.rule}" if briefing.rules else self.rule
        return Briefing(**{**_fields(briefing), "rules": rules})

    def carry_out(self, stage: Stage, raw: bytes) -> ExecutedPlan:
        """Drive the world with what is permitted."""
        return past_the_gate(stage, raw, self.permits_for(stage))


def _fields(briefing: Briefing) -> dict[str, Any]:
    return {name: getattr(briefing, name) for name in Briefing.__struct_fields__}
