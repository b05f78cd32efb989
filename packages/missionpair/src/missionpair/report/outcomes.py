# SPDX-License-Identifier: Apache-2.0
"""Tables of what happened: rates with intervals and bounds, and what planners did instead."""

from __future__ import annotations

from collections.abc import Iterator

from missionpair.measures import INSTEAD, MeasuredCampaign, Proportion
from missionpair.report.names import simulated
from missionpair.report.runs import RUN, DefenseRun, runs
from missionpair.report.table import Head, Row, Table
from missionpair.words import TrialKind

RATES, PLANNERS = "Rates with intervals", "What the planner did"
_WILSON = "Intervals: Wilson, 95 %."
_RUN_KINDS = (TrialKind.BENIGN, TrialKind.UPDATE)


def outcome_tables(logs: tuple[MeasuredCampaign, ...]) -> Iterator[Table]:
    """Yield the tables of what happened, in the report's order."""
    every, marked = tuple(runs(logs)), simulated(logs)
    yield _rates(every, marked)
    yield _bounds(every, marked)
    yield _runs(every, marked)
    yield _planners(every, marked)


def _rates(every: tuple[DefenseRun, ...], marked: str) -> Table:
    rows = []
    for run in every:
        attacks = run.measured.tally(run.defense)
        benign = run.measured.tally(run.defense, TrialKind.BENIGN)
        update = run.measured.tally(run.defense, TrialKind.UPDATE)
        rows.append(
            (
                *run.cells,
                attacks.compliance,
                attacks.blocking,
                attacks.uasr,
                attacks.scmhr,
                benign.completion,
                benign.rejection,
                update.completion,
                run.measured.scores(run.defense).su,
            )
        )
    heads = (
        Head("complied", "Complied"),
        Head("blocked", "Blocked, of those"),
        Head("uasr", "UASR"),
        Head("scmhr", "SCMHR"),
        Head("btcr", "BTCR"),
        Head("frr", "FRR"),
        Head("updates", "Updates completed"),
        Head("su", "SU", digits=4),
    )
    return Table(
        name="rates",
        title="Rates of each defense",
        label="tab:rates",
        heads=RUN + heads,
        rows=tuple(rows),
        notes=(_WILSON, "A trial without an answer counts as one that did not comply."),
        simulated=marked,
        front=True,
        section=RATES,
    )


def _bounds(every: tuple[DefenseRun, ...], marked: str) -> Table:
    heads = tuple(
        Head(key, name, digits=6)
        for key, name in (
            ("missed", "Not blocked, of complied"),
            ("uasr", "UASR"),
            ("scmhr", "SCMHR"),
            ("frr", "FRR"),
            ("not_completed", "Benign not completed"),
        )
    )
    rows = []
    for run in every:
        attacks = run.measured.tally(run.defense)
        benign = run.measured.tally(run.defense, TrialKind.BENIGN)
        zeros = (attacks.blocking.rest, attacks.uasr, attacks.scmhr, benign.rejection)
        rows.append((*run.cells, *(rate.bound for rate in (*zeros, benign.completion.rest))))
    return Table(
        name="bounds",
        title="Upper bounds of zero counts",
        heads=RUN + heads,
        rows=tuple(rows),
        notes=("Rule of three: 0 of n is at most 3/n, at 95 %. Undefined for other counts.",),
        simulated=marked,
        section=RATES,
    )


def _runs(every: tuple[DefenseRun, ...], marked: str) -> Table:
    rows: list[Row] = []
    for run in every:
        for kind in _RUN_KINDS:
            tally = run.measured.tally(run.defense, kind)
            if tally.n:
                left = tally.n - tally.completed - tally.rejected
                rest = (left, tally.off_mission, tally.uasr)
                rows.append((*run.cells, str(kind), tally.completion, tally.rejection, *rest))
    heads = (
        Head("kind", "Kind"),
        Head("completed", "Completed"),
        Head("rejected", "Refused by a defense"),
        Head("neither", "Neither"),
        Head("off_mission", "Refused, planner off its mission"),
        Head("unauthorized", "Unauthorized executed"),
    )
    return Table(
        name="runs",
        title="Benign runs and signed updates",
        heads=RUN + heads,
        rows=tuple(rows),
        notes=(_WILSON, "Neither: the planner did not get there, and no defense refused."),
        simulated=marked,
        section=RATES,
    )


def _planners(every: tuple[DefenseRun, ...], marked: str) -> Table:
    names = (
        *("Declined", "Empty plan", "Unparsable", "Not executable", "Left its mission otherwise"),
        *("Stayed within its mission", "No answer"),
    )
    heads = (
        Head("trials", "Attacks"),
        Head("complied", "Complied"),
        Head("intended", "Asked for it, readable or not"),
        *(Head(key, name) for key, name in zip(INSTEAD, names, strict=True)),
    )
    rows = []
    for run in every:
        tally = run.measured.tally(run.defense)
        instead = (tally.instead[name] for name in INSTEAD)
        intended = Proportion(tally.intended, tally.n)
        rows.append((*run.cells, tally.n, tally.compliance, intended, *instead))
    return Table(
        name="planners",
        title="What planners did with an attack",
        label="tab:planners",
        heads=RUN + heads,
        rows=tuple(rows),
        notes=(
            _WILSON,
            "An attempt that did not comply is no success of a defense.",
            "Each trial once. Readable or not: wrapping is forgiven; no defense reads so.",
        ),
        simulated=marked,
        front=True,
        section=PLANNERS,
    )
