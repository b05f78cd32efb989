# SPDX-License-Identifier: Apache-2.0
"""Tables of how far attacks went and how many tries they took, and what knowing more is worth."""

from __future__ import annotations

from collections.abc import Iterator

from msgspec import Struct

from missionpair.measures import (
    Leak,
    MeasuredCampaign,
    MeasureError,
    Proportion,
    average,
    largest,
    leakage,
    wider,
)
from missionpair.report.names import planner, printable, simulated
from missionpair.report.runs import RUN, DefenseRun, runs
from missionpair.report.table import Head, Row, Table
from missionpair.words import TrialKind

TRIES, LEAKS = "Deviation and tries", "Leakage"


class Leaked(Struct, frozen=True):
    """What one log's attacker gains over another's, under one defense.

    Args:
        more: number of the log whose attacker sees more.
        less: number of the other.
        leak: the difference.
    """

    more: int
    less: int
    leak: Leak


def leaks_of(logs: tuple[MeasuredCampaign, ...]) -> tuple[Leaked, ...]:
    """Return the differences of all logs that differ in nothing but what the attacker sees."""
    found: list[Leaked] = []
    for more, one in enumerate(logs, 1):
        for less, other in enumerate(logs, 1):
            if wider(one, other):
                try:
                    leaks = leakage(one, other)
                except MeasureError:
                    continue  # other campaigns, which a report may well hold side by side
                found += [Leaked(more, less, leak) for leak in leaks]
    return tuple(found)


def try_tables(logs: tuple[MeasuredCampaign, ...]) -> Iterator[Table]:
    """Yield the tables of deviation and tries, in the report's order."""
    every, marked = tuple(runs(logs)), simulated(logs)
    yield _deviations(every, marked)
    yield _tries(every, marked)


def _deviations(every: tuple[DefenseRun, ...], marked: str) -> Table:
    rows = []
    for run in every:
        tally = run.measured.tally(run.defense)
        planned = (largest(tally.planned), average(tally.planned))
        rows.append(
            (*run.cells, tally.complied, *planned, largest(tally.done), average(tally.done))
        )
    heads = (
        Head("complied", "Complied"),
        Head("planned_max", "Planned D_M, max", digits=4),
        Head("planned_mean", "Planned D_M, mean", digits=4),
        Head("executed_max", "Executed D_M, max", digits=4),
        Head("executed_mean", "Executed D_M, mean", digits=4),
    )
    return Table(
        name="deviation",
        title="Mission deviation of attacks that complied",
        heads=RUN + heads,
        rows=tuple(rows),
        notes=("Of each trial, its largest D_M. A blocked attempt has an executed D_M of 0.",),
        simulated=marked,
        section=TRIES,
    )


def _tries(every: tuple[DefenseRun, ...], marked: str) -> Table:
    rows = []
    for run in every:
        tally = run.measured.tally(run.defense)
        tried = run.measured.flow(run.defense, TrialKind.ATTACK).tried
        found = Proportion(tally.rounds.n, tally.n)
        most = tally.rounds.most if tally.rounds.n else None
        rows.append((*run.cells, found, tally.rounds.median, tally.rounds.mean, most, tried.mean))
    heads = (
        Head("found", "Attack found"),
        Head("median", "Tries to it, median", digits=1),
        Head("mean", "Tries to it, mean"),
        Head("most", "Tries to it, most"),
        Head("tried", "Tries of all, mean"),
    )
    return Table(
        name="tries",
        title="Tries until an attack is found",
        heads=RUN + heads,
        rows=tuple(rows),
        notes=("Found: executable, safe and off the mission, with or without a defense.",),
        simulated=marked,
        section=TRIES,
    )


def leakage_table(logs: tuple[MeasuredCampaign, ...], leaks: tuple[Leaked, ...]) -> Table:
    """Return what an attacker gains by knowing more, for each defense."""
    rows: list[Row] = []
    for found in leaks:
        leak = found.leak
        gaps = [gap for gap in (leak.gain, leak.rounds) if gap is not None]
        tells = "yes" if any(gap.tells for gap in gaps) else "no" if gaps else None
        who = planner(logs[found.more - 1].campaign.planner)
        rows.append(
            (
                f"{found.more}, {found.less}",
                who,
                printable(leak.defense),
                f"{leak.more} - {leak.less}",
                *leak.scmhr,
                leak.gain,
                *leak.median_rounds,
                leak.rounds,
                tells,
            )
        )
    heads = (
        Head("logs", "Logs"),
        Head("planner", "Planner"),
        Head("defense", "Defense"),
        Head("access", "Access"),
        Head("scmhr_more", "SCMHR, more"),
        Head("scmhr_less", "SCMHR, less"),
        Head("scmhr_gain", "Difference", digits=4),
        Head("tries_more", "Median tries, more", digits=1),
        Head("tries_less", "Median tries, less", digits=1),
        Head("tries_gain", "Difference of mean tries"),
        Head("tells", "Leaves 0 out"),
    )
    return Table(
        name="leakage",
        title="What an attacker gains by knowing more",
        label="tab:leakage",
        heads=heads,
        rows=tuple(rows),
        notes=(
            "SCMHR: Newcombe's interval. Tries: a bootstrap's.",
            "An attack that found nothing counts as all its tries.",
        ),
        simulated=simulated(logs[n - 1] for found in leaks for n in (found.more, found.less)),
        front=True,
        section=LEAKS,
    )
