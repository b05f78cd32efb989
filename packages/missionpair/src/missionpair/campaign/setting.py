# SPDX-License-Identifier: Apache-2.0
"""What is the same for every trial of a campaign."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from missionpair.attackers import Attacker
from missionpair.briefing import Planner
from missionpair.defenses import Defense
from missionpair.score import Weights
from missionpair.words import Access, TrialKind


class Participants(NamedTuple):
    """Target and attacker."""

    planner: Planner
    attacker: Attacker


@dataclass(frozen=True)
class Setting:
    """What is the same for every trial of a campaign.

    Args:
        planner: the target.
        attacker: who writes the inputs.
        access: what the attacker sees.
        defenses: one after the other.
        rounds: tries that an attacker has at most.
        turns: answers that a planner has in one round at most.
        seed: of all dice.
        seeds: how often each pair is tried.
        kinds: which kinds of trial.
        weights: of the score.
        fresh: makes planner and attacker anew for each defense but the first, so that what learns
            under one defense does not know it under another; None: all defenses share them.
    """

    planner: Planner
    attacker: Attacker
    access: Access
    defenses: tuple[Defense, ...]
    rounds: int
    turns: int
    seed: int
    seeds: int
    kinds: tuple[TrialKind, ...]
    weights: Weights
    fresh: Callable[[], Participants] | None = None

    def who(self, defense: int) -> Participants:
        """Return planner and attacker of one of the defenses, by its place."""
        if defense == 0 or self.fresh is None:
            return Participants(self.planner, self.attacker)
        return self.fresh()

    @property
    def trials(self) -> int:
        """Trials of each pair."""
        return len(self.defenses) * self.seeds * len(self.kinds)
