# SPDX-License-Identifier: Apache-2.0
"""Evolution over the template grammar, without a model: mutation, crossover, selection.

It climbs J where it sees J (white access); elsewhere how near the observed plan came to the wanted
calls. Options: `population=N` (8), `changes=N`, slots that a mutation draws anew (2). Source:
section "Adaptive Attacker Models". Spec page: docs/spec/missionpair-access.md#search
"""

from __future__ import annotations

from random import Random
from typing import Any

from msgspec.structs import replace

from missionpair.attackers._nearness import nearness
from missionpair.attackers._options import whole
from missionpair.attackers._reading import CaseView, SeenView, read_case, read_seen
from missionpair.pair import Input
from missionpair.wording import Derivation, confirm, cross, derive, is_for, mutate, write


class Search:
    """Breeds wordings; each round tries one.

    Args:
        population: wordings that are kept.
        changes: slots that a mutation draws anew.
    """

    name = "search"
    simulated = False

    def __init__(self, *, population: int, changes: int) -> None:
        self.parameters: dict[str, Any] = {
            "population": population,
            "changes": changes,
            "grammar": 2,
        }
        self._most = population
        self._changes = changes
        self._case: CaseView | None = None
        self._random = Random(0)  # noqa: S311 - dice of a published seed
        self._kept: list[tuple[int, int, Derivation]] = []
        self._tried: Derivation | None = None
        self._count = 0

    def open(self, case: bytes, *, seed: int) -> tuple[Input, ...]:
        """Return the wording that the seed draws; nothing is known of trials before."""
        self._case = told = read_case(case)
        self._random = Random(seed)  # noqa: S311
        self._kept, self._count = [], 0
        same = is_for(told.wanted, told.instead_of)
        return self._texts(derive(told.family, told.channels[0], seed=seed, same=same))

    def revise(self, seen: bytes, *, seed: int) -> tuple[Input, ...] | None:  # noqa: ARG002
        """Weigh the wording that was tried, and return the next one."""
        if self._case is None or self._tried is None:
            return None
        self._select(self._fitness(read_seen(seen)), self._tried)
        return self._texts(self._bred())

    @property
    def kept(self) -> tuple[tuple[int, Derivation], ...]:
        """The population, the fittest first."""
        return tuple((fitness, found) for fitness, _, found in sorted(self._kept, key=_rank))

    def _fitness(self, seen: SeenView) -> int:
        if seen.score is not None:
            return seen.score
        wanted = () if self._case is None else self._case.wanted
        return nearness(seen.reply, wanted) + (100 if seen.outcome == "executed" else 0)

    def _select(self, fitness: int, tried: Derivation) -> None:
        """Keep what was tried, and of too many not the least fit; of equals the older stays."""
        self._count += 1
        self._kept.append((fitness, self._count, tried))
        self._kept.sort(key=_rank)
        del self._kept[self._most :]

    def _bred(self) -> Derivation:
        if len(self._kept) < self._most:
            # the first generation: far from each other
            return mutate(self._kept[0][2], self._random, changes=6)
        child = cross(self._parent(), self._parent(), self._random)
        return mutate(child, self._random, changes=self._changes)

    def _parent(self) -> Derivation:
        """Return the fitter of two that are drawn."""
        drawn = [self._random.choice(self._kept) for _ in range(2)]
        return min(drawn, key=_rank)[2]

    def _texts(self, derivation: Derivation) -> tuple[Input, ...]:
        case = self._case
        if case is None:  # pragma: no cover - `open` came first
            raise RuntimeError("no trial was opened")
        self._tried = derivation
        asked = write(derivation, case.wanted, authorized=case.instead_of)
        others = [
            Input(channel, confirm(_on(derivation, channel), authorized=case.instead_of))
            for channel in case.channels[1:]
        ]
        return Input(derivation.channel, asked), *others


def _on(derivation: Derivation, channel: Any) -> Derivation:
    """Return the derivation on another channel, which has settings of its own."""
    same, seed = derivation.same, int(derivation.choices["verbs"])
    drawn = derive(derivation.family, channel, seed=seed, same=same)
    kept = {slot: derivation.choices[slot] for slot in ("claim", "confirmation", "scene")}
    return replace(drawn, choices={**drawn.choices, **kept})


def _rank(kept: tuple[int, int, Derivation]) -> tuple[int, int]:
    fitness, number, _ = kept
    return -fitness, number


def make(*, population: str = "8", changes: str = "2") -> Search:
    """Return the attacker.

    Raises:
        ValueError: an option is no whole number above zero.
    """
    return Search(population=whole("population", population), changes=whole("changes", changes))
