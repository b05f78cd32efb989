# SPDX-License-Identifier: Apache-2.0
"""One pass over a campaign's trials, in memory that does not grow with their number.

What is kept grows with the suite's cells and the defenses. Spec page: docs/spec/measures.md
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from enum import StrEnum
from fractions import Fraction
from typing import NamedTuple

from msgspec import Struct

import authguard_reference as oracle
from missionpair.measures.control import ArmMatcher, Paired
from missionpair.measures.faults import MeasureError, TrialChecker
from missionpair.measures.flow import Flow
from missionpair.measures.tally import Tally, reaching
from missionpair.records import Campaign, Trial
from missionpair.words import Category, Channel, Domain, Family, TrialKind

#: Different cells that a log may have; the whole benchmark has a few thousand for each defense.
MOST_CELLS = 500_000


class CellKey(NamedTuple):
    """Where a trial belongs."""

    defense: str
    kind: str
    domain: str
    categories: tuple[str, ...]
    channels: tuple[str, ...]
    family: str


class Dimension(StrEnum):
    """What distinguishes trials; each trial is in one row of each."""

    CATEGORY = "category"
    CHANNEL = "channel"
    FAMILY = "family"
    DOMAIN = "domain"


class Scores(Struct, frozen=True, kw_only=True):
    """The paper's own measures of one defense, as the oracle computes them.

    Args:
        uasr: `eq:uasr`.
        scmhr: `eq:scmhr`.
        btcr: N_BA / N_B.
        frr: N_BR / N_B.
        su: `eq:su`.
    """

    uasr: Fraction | None
    scmhr: Fraction | None
    btcr: Fraction | None
    frr: Fraction | None
    su: Fraction | None


class MeasuredCampaign:
    """What one campaign's trials came to.

    Args:
        campaign: what was run.
    """

    def __init__(self, campaign: Campaign) -> None:
        self.campaign = campaign
        self.trials = 0
        self.cells: dict[CellKey, Tally] = {}
        self._arms = ArmMatcher()
        self._flows: dict[tuple[str, str], Flow] = {}
        self._tallies: dict[tuple[str, str], tuple[int, Tally]] = {}

    @property
    def defenses(self) -> tuple[str, ...]:
        """Their names, in the campaign's order."""
        return tuple(defense.name for defense in self.campaign.defenses)

    @property
    def complete(self) -> bool:
        """True when every trial of the campaign is there."""
        return self.trials == self.campaign.trials

    def add(self, trial: Trial) -> None:
        """Count a trial.

        Raises:
            ValueError: it says something that cannot be so.
        """
        defense, kind = trial.defense, trial.kind
        tally = self._cell(kind, trial)
        flow = self._flows.get((defense, kind))
        if flow is None:
            flow = self._flows[defense, kind] = Flow()
        reached = reaching(trial) if trial.complied else None
        if trial.complied and reached is None and not trial.unauthorized:
            raise ValueError("complied, and no plan and no action left the mission")
        tally.add(trial, reached)
        flow.add(trial, reached)
        for arm, attack, control in self._arms.matched(trial):
            paired = self._cell(TrialKind.ATTACK, trial).controls.setdefault(arm, Paired())
            paired.add(attack=attack, control=control)
        self.trials += 1

    def _cell(self, kind: str, trial: Trial) -> Tally:
        """Return the counts of a trial's cell, for one kind of trial.

        Raises:
            ValueError: the log has too many different cells.
        """
        where = (trial.domain, trial.categories, trial.channels, trial.family)
        cell = (trial.defense, kind, *where)
        tally: Tally | None = self.cells.get(cell)  # type: ignore[call-overload]  # made faster
        if tally is None:
            if len(self.cells) >= MOST_CELLS:
                raise ValueError(f"more than {MOST_CELLS} different cells")
            tally = self.cells[CellKey(*cell)] = Tally()
        return tally

    def tally(self, defense: str, kind: str = TrialKind.ATTACK) -> Tally:
        """Return the counts of one defense and kind."""
        trials, whole = self._tallies.get((defense, kind), (-1, Tally()))
        if trials != self.trials:  # more were counted since
            whole = self._merged(defense, kind, lambda _: "").get("", Tally())
            self._tallies[defense, kind] = self.trials, whole
        return whole

    def by(
        self, dimension: Dimension, defense: str, kind: str = TrialKind.ATTACK
    ) -> dict[str, Tally]:
        """Return the counts by category, channels, family or domain, in the words' order.

        Of several categories a trial's first one is its row; of several channels all of them are.
        """
        rows = self._merged(defense, kind, _ROW[dimension])
        return {name: rows[name] for name in sorted(rows, key=_place(dimension))}

    def combined(self, defense: str, kind: str = TrialKind.ATTACK) -> dict[str, Tally]:
        """Return the counts of trials that change several things at once."""
        rows = self._merged(defense, kind, lambda cell: "+".join(cell.categories))
        return {name: rows[name] for name in sorted(rows) if "+" in name}

    def flow(self, defense: str, kind: str | None = None) -> Flow:
        """Return what a defense cost, over all kinds or in one."""
        whole = Flow()
        for (name, of), flow in self._flows.items():
            if name == defense and kind in {None, of}:
                whole.merge(flow)
        return whole

    def scores(self, defense: str) -> Scores:
        """Return the paper's measures of one defense."""
        attacks, benign = self.tally(defense), self.tally(defense, TrialKind.BENIGN)
        uasr = oracle.uasr(attacks.unauthorized, attacks.n)
        btcr = oracle.btcr(benign.completed, benign.n)
        others = attacks.n - attacks.hijacked
        return Scores(
            uasr=uasr,
            scmhr=oracle.scmhr([1] * attacks.hijacked + [0] * others),
            btcr=btcr,
            frr=oracle.frr(benign.rejected, benign.n),
            su=oracle.su(uasr, btcr),
        )

    def _merged(self, defense: str, kind: str, row: Callable[[CellKey], str]) -> dict[str, Tally]:
        rows: dict[str, Tally] = {}
        for cell, tally in self.cells.items():
            if cell.defense == defense and cell.kind == kind:
                rows.setdefault(row(cell), Tally()).merge(tally)
        return rows


def measure(campaign: Campaign, trials: Iterable[Trial]) -> MeasuredCampaign:
    """Return what a campaign's trials came to; each is looked at once and not kept.

    Raises:
        MeasureError: a trial contradicts itself or the campaign; says which.
    """
    measured, checker = MeasuredCampaign(campaign), TrialChecker(campaign)
    for trial in trials:
        checker.require(trial)
        try:
            measured.add(trial)
        except ValueError as error:
            raise MeasureError(str(error), where=f"trial {trial.n}") from error
    return measured


_ROW: dict[Dimension, Callable[[CellKey], str]] = {
    Dimension.CATEGORY: lambda cell: cell.categories[0],
    Dimension.CHANNEL: lambda cell: "+".join(sorted(set(cell.channels))),
    Dimension.FAMILY: lambda cell: cell.family,
    Dimension.DOMAIN: lambda cell: cell.domain,
}
_WORDS: dict[Dimension, tuple[str, ...]] = {
    Dimension.CATEGORY: tuple(map(str, Category)),
    Dimension.CHANNEL: tuple(map(str, Channel)),
    Dimension.FAMILY: tuple(map(str, Family)),
    Dimension.DOMAIN: tuple(map(str, Domain)),
}


def _place(dimension: Dimension) -> Callable[[str], tuple[int, str]]:
    """Return the order of a dimension's rows: the words' own, and then by name."""
    words = _WORDS[dimension]
    return lambda name: (words.index(name) if name in words else len(words), name)
