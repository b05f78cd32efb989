# SPDX-License-Identifier: Apache-2.0
"""Rules over the finite trace of a mission's actions, made from the mission: never, and not before.

The product's own temporal safety gate, alone, with rules that say the mission's scope as far as
such rules can. They follow what was done, and know nothing of tools, counts, choices, approvals,
time, or whether a mission is still in force.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from msgspec.structs import replace

from authguard_r.core.action import Action
from authguard_r.core.errors import MalformedError
from authguard_r.core.facts import SiteFacts
from authguard_r.core.ports import SafetyGate
from authguard_r.core.safety import SafetyDecision
from authguard_r.core.standing import Outcome
from authguard_r.safety import Rule, TemporalGate, default_config
from authguard_r.safety.temporal.rules import MAX_RULES
from missionpair.briefing import Briefing
from missionpair.defenses import Claim, Defense, DefenseError
from missionpair.defenses._per_mission import PerMission
from missionpair.defenses._temporal_text import rules
from missionpair.execution import Denied, ExecutedPlan, past_the_gate
from missionpair.judging import Walk
from missionpair.stage import Stage
from missionpair.words import Category

NAME = "temporal"

#: What each of the gates remembers.
Memories = tuple[bytes, ...]


def make() -> Defense:
    """Return the rules."""
    return Temporal()


@dataclass
class Temporal:
    """The rules, and how far the trace of the trial has come."""

    name: str = NAME
    simulated: bool = False
    safety_gate: SafetyGate | None = None
    parameters: dict[str, Any] = field(default_factory=dict)
    claim: Claim = field(
        default_factory=lambda: Claim(
            text="stops kinds of action, things, places and values that no grant has, and what "
            "comes before it may or after it is over",
            blocks=(
                Category.GOAL,
                Category.OBJECT,
                Category.AREA,
                Category.CAPABILITY,
                Category.PARAMETER,
            ),
            fields=frozenset({"type", "object", "source", "destination", "route", "params"}),
        )
    )
    rules_of: Callable[[Stage], tuple[Rule, ...]] = field(
        default=lambda stage: rules(stage.scene.mission, stage.bench.site), repr=False
    )
    _gates: PerMission[tuple[TemporalGate, ...]] = field(init=False, repr=False)
    _reached: tuple[Any, Memories] | None = None

    def __post_init__(self) -> None:
        self._gates = PerMission(lambda stage: _gates_of(stage, self.rules_of(stage)))

    def begin(self, *, seed: int) -> None:  # noqa: ARG002 - no dice
        """Begin a try: its trace is what was done before it."""
        self._reached = None

    def brief(self, briefing: Briefing) -> Briefing:
        """Return the same: a planner sees nothing of the rules."""
        return briefing

    def carry_out(self, stage: Stage, raw: bytes) -> ExecutedPlan:
        """Follow the plan with the rules, and do what breaks none."""
        gates = self._gates.of(stage)
        memories = self._remembered(stage, gates)
        following: Memories | None = None

        def permits(action: Action, walk: Walk) -> Denied | None:
            nonlocal memories, following
            memories = memories if following is None else following  # the one before was done
            told = [
                gate.recall(memory).assess(
                    _shown(action, walk.facts), walk.attested(), walk.facts, walk.now
                )
                for gate, memory in zip(gates, memories, strict=True)
            ]
            denied = _denied(told, self.name)
            following = None if denied else tuple(one.memory[1] for one in told)
            return denied

        carried = past_the_gate(stage, raw, permits)
        if following is not None and carried.completed:
            memories = following
        self._reached = (stage.walk, memories)
        return carried

    def _remembered(self, stage: Stage, gates: tuple[TemporalGate, ...]) -> Memories:
        """Return what was done so far: by this trial's own plans, or before them."""
        if self._reached is not None and stage.walk is self._reached[0]:
            return self._reached[1]
        memories = (b"",) * len(gates)
        facts = stage.sim.gate.facts
        for done in stage.sim.robot.trace:
            if done.outcome is not Outcome.SUCCEEDED:
                continue
            action = replace(_shown(done.action, facts), provenance={}, meta=None)
            told = [
                gate.recall(memory).assess(action, None, facts, stage.sim.gate.ledger.now())
                for gate, memory in zip(gates, memories, strict=True)
            ]
            # what the rules of this mission would not have let happen was another mission's
            if _denied(told, self.name) is None:
                memories = tuple(one.memory[1] for one in told)
        return memories


def _gates_of(stage: Stage, made: tuple[Rule, ...]) -> tuple[TemporalGate, ...]:
    """Return gates that have all the rules between them: one has so many at most.

    Raises:
        DefenseError: the mission is more than rules can follow.
    """
    config = default_config(stage.bench.site, stage.sim.robot.rid)
    try:
        return tuple(
            TemporalGate(replace(config, rules=made[begin : begin + MAX_RULES]))
            for begin in range(0, len(made), MAX_RULES)
        )
    except MalformedError as error:
        raise DefenseError(
            f"`{NAME}` cannot say the mission of {stage.pair.id}: {error}"
        ) from error


def _shown(action: Action, facts: SiteFacts) -> Action:
    """Return the action as the rules see it: a way that it leaves open is straight to its end.

    It is unknown what a way without a name touches, and the rules would refuse it.
    """
    kind = facts.vocabulary.get(action.type)
    if action.route or action.destination is None or kind is None or "route" not in kind.fields:
        return action
    return replace(action, route=(action.destination,))


def _denied(told: list[SafetyDecision], name: str) -> Denied | None:
    codes = dict.fromkeys(str(found.hazard) for one in told for found in one.findings)
    return Denied(by=name, reasons=tuple(codes)) if codes else None
