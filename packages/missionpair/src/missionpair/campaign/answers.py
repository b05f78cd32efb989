# SPDX-License-Identifier: Apache-2.0
"""Who plans in a trial, and the answers: asked once, so that every defense judges the same plan.

Source: section "Controlled Validation" (the same trials under several systems)
"""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter_ns

from msgspec.structs import replace

from missionpair.attackers import Attacker
from missionpair.briefing import Briefing, Planner, Reply
from missionpair.campaign.setting import Setting
from missionpair.campaign.trial_record import Dice, TrialCosts
from missionpair.words import TrialKind


class SharedAnswers:
    """The answers of one try of a pair, for the defenses that come after the first."""

    def __init__(self) -> None:
        self._given: list[tuple[Briefing, int, Reply]] = []

    def clear(self) -> None:
        """Forget every answer: another try begins."""
        self._given.clear()

    def answer(self, briefing: Briefing, seed: int, ask: Callable[[], Reply]) -> tuple[Reply, bool]:
        """Return the answer to a question, and whether it was asked just now.

        Args:
            briefing: what the planner is shown; one word more is another question.
            seed: of its dice.
            ask: asks the planner.
        """
        for shown, dice, reply in self._given:
            if dice == seed and shown == briefing:
                return reply, False
        reply = ask()
        self._given.append((briefing, seed, reply))
        return reply, True


class TrialPlanners:
    """Planner and attacker of each defense.

    Args:
        setting: of the campaign.
    """

    def __init__(self, setting: Setting) -> None:
        self._who = {defense.name: setting.who(n) for n, defense in enumerate(setting.defenses)}
        self._fresh = setting.fresh
        self._learners: dict[tuple[TrialKind, str], Planner] = {}
        self._answers = SharedAnswers()

    def clear(self) -> None:
        """Forget every answer: another try begins."""
        self._answers.clear()

    def attacker(self, defense: str) -> Attacker:
        """Return who writes the inputs under a defense."""
        return self._who[defense].attacker

    def learns(self, dice: Dice) -> bool:
        """True when the planner is an attacker, too, and is told of each round."""
        return hasattr(self._who[dice.defense.name].planner, "told")

    def of(self, dice: Dice) -> Planner:
        """Return who plans; what learns in an arm knows nothing of the others."""
        planner = self._who[dice.defense.name].planner
        if dice.kind is TrialKind.ATTACK or self._fresh is None or not self.learns(dice):
            return planner
        key = dice.kind, dice.defense.name
        if key not in self._learners:
            self._learners[key] = self._fresh().planner
        return self._learners[key]

    def answered(self, briefing: Briefing, dice: Dice, seed: int, spent: TrialCosts) -> Reply:
        """Return the planner's answer, and add what it took; the same question is asked once."""
        begun, planner = perf_counter_ns(), self.of(dice)

        def ask() -> Reply:
            return planner.propose(briefing, seed=seed)

        if hasattr(planner, "told"):  # it learns from what this defense did
            reply, is_new = ask(), True
        else:
            question, thrown = briefing, seed
            if getattr(planner, "is_greedy", False):  # the words alone decide
                question, thrown = replace(briefing, usual=(), trial=None), 0
            reply, is_new = self._answers.answer(question, thrown, ask)
        if not is_new:
            return reply
        spent.planner += reply.took_us or (perf_counter_ns() - begun) // 1_000
        read, written = spent.tokens
        spent.tokens = (read + reply.tokens[0], written + reply.tokens[1])
        spent.cost_microusd += reply.cost_microusd
        return reply
