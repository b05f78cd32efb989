# SPDX-License-Identifier: Apache-2.0
"""A planner's answers to one question: it is asked once, and every defense judges the same plan.

Source: section "Controlled Validation" (the same trials under several systems)
"""

from __future__ import annotations

from collections.abc import Callable

from missionpair.briefing import Briefing, Reply


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
