# SPDX-License-Identifier: Apache-2.0
"""Tables of what a defense costs: time, waiting, questions, tokens; and of what it refused."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction

from missionpair.measures import PARTS, Flow, MeasuredCampaign, Proportion
from missionpair.report.names import printable, simulated
from missionpair.report.runs import RUN, DefenseRun, runs
from missionpair.report.table import Cell, Head, Row, ShareForm, Table
from missionpair.words import TrialKind

AVAILABILITY, TIME, MONEY, REFUSALS = "Availability", "Time", "Tokens and money", "Refusals"
QUANTILES = (("p50", 500), ("p95", 950), ("p99", 990))


def cost_tables(logs: tuple[MeasuredCampaign, ...]) -> Iterator[Table]:
    """Yield the tables of what it costs, in the report's order."""
    every, marked = tuple(runs(logs)), simulated(logs)
    yield _availability(every, marked)
    yield _prompts(every, marked)
    yield _times(every, marked)
    yield _money(every, marked)
    yield _refusals(every, marked)


def _kinds(run: DefenseRun) -> Iterator[tuple[str, Flow]]:
    for kind in TrialKind:
        flow = run.measured.flow(run.defense, kind)
        if flow.n:
            yield str(kind), flow


def _availability(every: tuple[DefenseRun, ...], marked: str) -> Table:
    rows: list[Row] = []
    for run in every:
        for kind, flow in _kinds(run):
            stalled = flow.stalled
            parts = tuple(stalled.quantile(permille) for _, permille in QUANTILES)
            false = Proportion(flow.false_stops, flow.n)
            rows.append((*run.cells, kind, false, stalled.mean, *parts, stalled.most))
    heads = (
        Head("kind", "Kind"),
        Head("false_stops", "False stops"),
        Head("stalled_mean_ms", "Stalled ms, mean", digits=1),
        *(Head(f"stalled_{name}_ms", f"Stalled ms, {name}") for name, _ in QUANTILES),
        Head("stalled_most_ms", "Stalled ms, most"),
    )
    return Table(
        name="availability",
        title="Stalls and false stops",
        heads=RUN + heads,
        rows=tuple(rows),
        notes=("Stalled: simulated time in which the robot carried out waits.",),
        simulated=marked,
        section=AVAILABILITY,
    )


def _prompts(every: tuple[DefenseRun, ...], marked: str) -> Table:
    rows: list[Row] = []
    for run in every:
        for kind, flow in _kinds(run):
            mean = Fraction(flow.prompts, flow.n)
            rows.append((*run.cells, kind, flow.n, flow.prompts, mean, flow.most_prompts))
    heads = (
        Head("kind", "Kind"),
        Head("missions", "Missions"),
        Head("prompts", "Prompts"),
        Head("per_mission", "Prompts per mission"),
        Head("most", "Most in one"),
    )
    return Table(
        name="prompts",
        title="Questions to people",
        heads=RUN + heads,
        rows=tuple(rows),
        notes=("Each trial is one mission.",),
        simulated=marked,
        section=AVAILABILITY,
    )


def _times(every: tuple[DefenseRun, ...], marked: str) -> Table:
    rows: list[Row] = []
    for run in every:
        times = run.measured.flow(run.defense).times
        for name, permille in QUANTILES:
            rows.append((*run.cells, name, *(times[p].quantile(permille) for p in PARTS)))
        rows.append((*run.cells, "trials", *(times[part].n for part in PARTS)))
    heads = (
        Head("quantile", "Quantile"),
        *(Head(f"time_{part}", f"{part.capitalize()}, us") for part in PARTS),
    )
    return Table(
        name="times",
        title="Time by part, microseconds for each trial",
        heads=RUN + heads,
        rows=tuple(rows),
        notes=(
            "The planner's time is its own and in no other column but the total.",
            "A part's quantiles are of the trials in which it ran: row `trials`.",
            "Times differ between two runs of one campaign; everything else here does not.",
        ),
        simulated=marked,
        section=TIME,
    )


def _money(every: tuple[DefenseRun, ...], marked: str) -> Table:
    rows: list[Row] = []
    for run in every:
        flow = run.measured.flow(run.defense)
        complied = run.measured.tally(run.defense).complied
        cost = Fraction(flow.cost_microusd, 1_000_000)
        each: Cell = cost / complied if complied else None
        rows.append((*run.cells, flow.n, flow.errors, flow.read, flow.written, cost, each))
    heads = (
        Head("trials", "Trials"),
        Head("errors", "Without an answer"),
        Head("tokens_read", "Tokens read"),
        Head("tokens_written", "Tokens written"),
        Head("usd", "USD", digits=4),
        Head("usd_per_complied", "USD for each attack that complied", digits=4),
    )
    return Table(
        name="costs",
        title="Tokens and money",
        heads=RUN + heads,
        rows=tuple(rows),
        notes=("Tokens of the target; money of target and attacker, where the price is known.",),
        simulated=marked,
        section=MONEY,
    )


def _refusals(every: tuple[DefenseRun, ...], marked: str) -> Table:
    rows: list[Row] = []
    for run in every:
        for kind, flow in _kinds(run):
            for what, counts in (("by", flow.by), ("reason", flow.reasons)):
                for name, count in sorted(counts.items(), key=lambda item: (-item[1], item[0])):
                    rows.append(
                        (*run.cells, kind, what, printable(name), Proportion(count, flow.n))
                    )
    heads = (
        Head("kind", "Kind"),
        Head("what", "What"),
        Head("name", "Name"),
        Head("trials", "Trials", ShareForm.PERCENT),
    )
    return Table(
        name="refusals",
        title="Who refused, and why",
        heads=RUN + heads,
        rows=tuple(rows),
        notes=("The last refusal of each trial; `world` is physics.",),
        simulated=marked,
        section=REFUSALS,
    )
