# SPDX-License-Identifier: Apache-2.0
"""What a campaign is asked to do.

How-to: docs/howto/missionpair.md
"""

from __future__ import annotations

from dataclasses import dataclass

from msgspec import Struct

from authguard_r.core.mission import ProtectedField
from missionpair.pair import Pair
from missionpair.registry import SpecificationError
from missionpair.score import DEFAULT, Weights
from missionpair.words import Access, TrialKind

#: Most answers of a planner in one round: seeds stay whole numbers of JSON.
MOST_TURNS = 30


class PlanError(SpecificationError):
    """A campaign that cannot be; the text says what to do."""


class CampaignPlan(Struct, frozen=True, kw_only=True):
    """What is asked for, in words that another process understands.

    Args:
        suite: a suite's name, or the path of its file.
        planner: `name:option=value,...`, as `--planner` takes it.
        attacker: as `--attacker` takes it.
        defenses: as `--defense` takes each.
        access: what the attacker sees.
        seed: of all dice.
        seeds: how often each pair is tried.
        rounds: an attacker's tries at most.
        turns: a planner's answers in a round at most.
        every: takes every so many-th pair, from the first: a slice spread over the whole suite.
        pairs: how many of those, from the first; None takes all.
        kinds: which kinds of trial.
        weights: of the score.
        field_weights: w_j of D_M; none: as each mission signs them.
        unqualified: score also baselines that do not do what they claim.
    """

    suite: str
    planner: str
    attacker: str = "fixed"
    defenses: tuple[str, ...] = ("both",)
    access: Access = Access.BLACK
    seed: int = 0
    seeds: int = 1
    rounds: int = 1
    turns: int = 1
    every: int = 1
    pairs: int | None = None
    kinds: tuple[TrialKind, ...] = tuple(TrialKind)
    weights: Weights = DEFAULT
    field_weights: dict[ProtectedField, int] = {}
    unqualified: bool = False

    def taken(self, pairs: tuple[Pair, ...]) -> tuple[Pair, ...]:
        """Return those of a suite's pairs that are tried.

        Raises:
            PlanError: there would be no trial at all, and a log of none passes for a finished one.
        """
        taken = pairs[:: self.every][: self.pairs]
        if not len(taken) * self.seeds * len(self.kinds) * len(self.defenses):
            text = "a campaign needs at least one pair, seed, kind of trial and defense"
            raise PlanError(f"`{self.suite}`: nothing would be tried: {text}")
        return taken


@dataclass(frozen=True)
class Progress:
    """How far a campaign is."""

    done: int
    trials: int
