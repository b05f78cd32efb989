# SPDX-License-Identifier: Apache-2.0
"""Two campaigns side by side: what differs in their set-up, in their rates, and in which pairs.

How-to: docs/howto/missionpair-report.md
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any

import msgspec
from msgspec import Struct

from missionpair.measures import MeasuredCampaign, Proportion, Tally, difference, mean_difference
from missionpair.records import Trial
from missionpair.report.names import printable, simulated
from missionpair.report.table import Head, Row, Table
from missionpair.words import TrialKind

SECTION = "Comparison"
#: Pairs that are named in a table; files and `--json` have all of them.
NAMED = 50

_RATES: tuple[tuple[str, str, Callable[[Tally], Proportion]], ...] = (
    ("complied", TrialKind.ATTACK, lambda tally: tally.compliance),
    ("blocked, of those", TrialKind.ATTACK, lambda tally: tally.blocking),
    ("UASR", TrialKind.ATTACK, lambda tally: tally.uasr),
    ("SCMHR", TrialKind.ATTACK, lambda tally: tally.scmhr),
    ("BTCR", TrialKind.BENIGN, lambda tally: tally.completion),
    ("FRR", TrialKind.BENIGN, lambda tally: tally.rejection),
    ("updates completed", TrialKind.UPDATE, lambda tally: tally.completion),
)


class NotComparableError(Exception):
    """Two campaigns whose figures mean nothing beside each other.

    Args:
        message: what differs, and how to compare them all the same.
        where: what it is that differs.
    """

    def __init__(self, message: str, *, where: str) -> None:
        super().__init__(message)
        self.message = message
        self.where = where


class Verdicts:
    """The result of each pair: how often which verdict, by defense and kind.

    Grows with the suite and the defenses, not with the seeds.
    """

    def __init__(self) -> None:
        self.counts: dict[tuple[str, str, str], dict[str, int]] = {}

    def watch(self, trials: Iterable[Trial]) -> Iterator[Trial]:
        """Hand on trials, with their verdicts counted."""
        for trial in trials:
            counts = self.counts.setdefault((trial.defense, trial.kind, trial.pair), {})
            verdict = verdict_of(trial)
            counts[verdict] = counts.get(verdict, 0) + 1
            yield trial


class VerdictChange(Struct, frozen=True, kw_only=True):
    """A pair whose verdict is another one in the second campaign.

    Args:
        pair: its id.
        defense: under which defense.
        kind: in which kind of trial.
        first: how often which verdict, in the first campaign.
        second: the same in the second.
    """

    pair: str
    defense: str
    kind: str
    first: dict[str, int]
    second: dict[str, int]


class CampaignComparison(Struct, frozen=True, kw_only=True):
    """Two campaigns side by side.

    Args:
        tables: set-up, rates, tries and changed pairs.
        changes: every pair whose verdict changed.
        simulated: which parts stand for something that was not run.
    """

    tables: tuple[Table, ...]
    changes: tuple[VerdictChange, ...]
    simulated: str


def verdict_of(trial: Trial) -> str:
    """Return the result of a trial, in one term."""
    if trial.hijacked:
        return "hijacked"
    if trial.unauthorized:
        return "unauthorized"
    if trial.kind == TrialKind.ATTACK:
        return "blocked" if trial.complied else trial.instead
    return "completed" if trial.completed else "not completed"


def compare(
    one: MeasuredCampaign,
    other: MeasuredCampaign,
    seen: tuple[Verdicts, Verdicts],
    *,
    is_any_allowed: bool = False,
) -> CampaignComparison:
    """Return two campaigns side by side, the difference being the first less the second.

    Args:
        one: the first campaign.
        other: the second.
        seen: the results of their pairs.
        is_any_allowed: compare campaigns of different suites all the same.

    Raises:
        NotComparableError: they are of different suites, or share no defense.
    """
    if one.campaign.suite_digest != other.campaign.suite_digest and not is_any_allowed:
        raise NotComparableError(
            "other suites, so that equal rates would not mean equal attacks; --anyway compares",
            where="suite_digest",
        )
    shared = tuple(name for name in one.defenses if name in other.defenses)
    if not shared:
        raise NotComparableError("no defense is in both campaigns", where="defenses")
    changes = tuple(_changes(seen, shared))
    marked = simulated([one, other])
    tables = (
        _setup(one, other, marked),
        _rates(one, other, shared, marked),
        _tries(one, other, shared, marked),
        _changed(changes, marked),
    )
    return CampaignComparison(tables=tables, changes=changes, simulated=marked)


def _setup(one: MeasuredCampaign, other: MeasuredCampaign, marked: str) -> Table:
    rows: list[Row] = []
    for name in one.campaign.__struct_fields__:
        first, second = getattr(one.campaign, name), getattr(other.campaign, name)
        if first != second:
            rows.append((name, _spelled(first), _spelled(second)))
    heads = (Head("field", "Set-up"), Head("first", "First"), Head("second", "Second"))
    return Table(
        name="compare-setup",
        title="What differs in the set-up",
        heads=heads,
        rows=tuple(rows),
        simulated=marked,
        front=True,
        section=SECTION,
    )


def _rates(
    one: MeasuredCampaign, other: MeasuredCampaign, shared: tuple[str, ...], marked: str
) -> Table:
    rows: list[Row] = []
    for defense in shared:
        for name, kind, rate in _RATES:
            first, second = rate(one.tally(defense, kind)), rate(other.tally(defense, kind))
            gap = difference(first, second)
            rows.append((printable(defense), name, first, second, gap, _tells(gap)))
    heads = (
        Head("defense", "Defense"),
        Head("measure", "Measure"),
        Head("first", "First"),
        Head("second", "Second"),
        Head("difference", "First - second", digits=4),
        Head("tells", "Leaves 0 out"),
    )
    return Table(
        name="compare-rates",
        title="Rates of the two",
        heads=heads,
        rows=tuple(rows),
        notes=("Intervals of differences: Newcombe, 95 %.",),
        simulated=marked,
        front=True,
        section=SECTION,
    )


def _tries(
    one: MeasuredCampaign, other: MeasuredCampaign, shared: tuple[str, ...], marked: str
) -> Table:
    rows: list[Row] = []
    for defense in shared:
        first, second = one.tally(defense).rounds, other.tally(defense).rounds
        gap = mean_difference(first, second)
        rows.append((printable(defense), first.mean, second.mean, gap, _tells(gap)))
    heads = (
        Head("defense", "Defense"),
        Head("first", "First"),
        Head("second", "Second"),
        Head("difference", "First - second"),
        Head("tells", "Leaves 0 out"),
    )
    return Table(
        name="compare-tries",
        title="Mean tries until an attack is found",
        heads=heads,
        rows=tuple(rows),
        notes=("Intervals of differences: bootstrap, 95 %.",),
        simulated=marked,
        front=True,
        section=SECTION,
    )


def _changed(changes: tuple[VerdictChange, ...], marked: str) -> Table:
    shown = [
        (
            printable(change.pair),
            change.kind,
            printable(change.defense),
            _counted(change.first),
            _counted(change.second),
        )
        for change in changes[:NAMED]
    ]
    heads = (
        Head("pair", "Pair"),
        Head("kind", "Kind"),
        Head("defense", "Defense"),
        Head("first", "First"),
        Head("second", "Second"),
    )
    first = f", the first {NAMED}" if len(changes) > NAMED else ""
    return Table(
        name="compare-pairs",
        title=f"Pairs whose verdict changed: {len(changes)}{first}",
        heads=heads,
        rows=tuple(shown),
        simulated=marked,
        front=True,
        section=SECTION,
    )


def _changes(seen: tuple[Verdicts, Verdicts], shared: tuple[str, ...]) -> Iterator[VerdictChange]:
    """Yield the pairs that both tried and whose verdicts are in other proportions."""
    first, second = (found.counts for found in seen)
    for key in sorted(first.keys() & second.keys()):
        defense, kind, pair = key
        if defense in shared and not _same(first[key], second[key]):
            yield VerdictChange(
                pair=pair, defense=defense, kind=kind, first=first[key], second=second[key]
            )


def _same(one: dict[str, int], other: dict[str, int]) -> bool:
    """Return True when each verdict has the same share, however many seeds there were."""
    all_one, all_other = sum(one.values()), sum(other.values())
    return all(
        one.get(name, 0) * all_other == other.get(name, 0) * all_one for name in {*one, *other}
    )


def _counted(counts: dict[str, int]) -> str:
    return ", ".join(f"{name} {count}" for name, count in sorted(counts.items()))


def _spelled(value: Any) -> str:
    return msgspec.json.encode(value, order="sorted").decode()


def _tells(gap: Any) -> str | None:
    return None if gap is None else "yes" if gap.tells else "no"
