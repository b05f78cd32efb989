# SPDX-License-Identifier: Apache-2.0
"""Attack beside control arm, and which figures were settled before anything was run."""

from __future__ import annotations

from collections.abc import Iterator

from missionpair.measures import Dimension, MeasuredCampaign, Tally
from missionpair.records import Campaign
from missionpair.report.names import GATES, category, printable, simulated
from missionpair.report.runs import RUN, DefenseRun, runs
from missionpair.report.table import Cell, Head, Row, Table
from missionpair.suites import frozen
from missionpair.words import CONTROLS, TrialKind

SECTION, KINDS = "With the attack and without it", "What each figure shows"
CHECK, FINDING = "consistency check", "finding"
_NOTES = (
    "Complied: the plan changes one of the attack's own protected fields as the attack asks.",
    "Without the attack: the same situation, tries and dice. A model with temperature 0 answers",
    "the same question once: all its tries with nothing in the attack's place are one answer.",
    "Nothing: no text at all. Neutral: a text as long in the same channel, that asks for nothing.",
    "Difference: Newcombe's interval for paired shares, 95 %.",
)
_RAN = (
    Head("ran", "Something unauthorized ran"),
    Head("ran_nothing", "The same with nothing in its place"),
    Head("ran_neutral", "The same with a neutral text in its place"),
)
_HEADS = (
    Head("trials", "Attacks"),
    Head("complied", "Complied"),
    Head("nothing", "With nothing in its place"),
    Head("nothing_gap", "Difference to nothing"),
    Head("neutral", "With a neutral text in its place"),
    Head("neutral_gap", "Difference to neutral"),
)
#: Planners whose plans are the suite's own: what they do with a text is published.
_FOLLOWERS = ("hijacked", "graded")
#: Planners that propose the author's own plan where nobody attacks.
_KEEPERS = (*_FOLLOWERS, "adversary", "prober")
#: Suites whose texts ask for the author's plan, word by word.
_WRITTEN = frozenset(frozen()) - {"perceived"}


def control_tables(logs: tuple[MeasuredCampaign, ...]) -> Iterator[Table]:
    """Yield the tables of attack and control, where a control arm was run."""
    every, marked = tuple(runs(logs)), simulated(logs)
    with_arms = tuple(
        run for run in every if run.measured.tally(run.defense, TrialKind.ATTACK).controls
    )
    if with_arms:
        rows, heads = _pooled(with_arms), [*_HEADS, *_RAN]
        yield _table("control", "What the attack adds", heads, rows, marked, front=True)
        heads = [Head("category", "Category"), *_HEADS]
        rows = _by_category(with_arms)
        yield _table(
            "control-by-category", "What the attack adds, by category", heads, rows, marked
        )
    yield _kinds(every, marked)


def _table(
    name: str,
    title: str,
    heads: list[Head],
    rows: Iterator[Row],
    marked: str,
    *,
    front: bool = False,
) -> Table:
    return Table(
        name=name,
        title=title,
        label=f"tab:{name}",
        heads=(*RUN, *heads),
        rows=tuple(rows),
        notes=_NOTES,
        simulated=marked,
        front=front,
        section=SECTION,
    )


def _pooled(every: tuple[DefenseRun, ...]) -> Iterator[Row]:
    for run in every:
        ran = (run.measured.tally(run.defense, kind).uasr for kind in (TrialKind.ATTACK, *CONTROLS))
        yield (*run.cells, *_arms(run.measured.tally(run.defense)), *ran)


def _by_category(every: tuple[DefenseRun, ...]) -> Iterator[Row]:
    for run in every:
        for name, tally in run.measured.by(Dimension.CATEGORY, run.defense).items():
            yield (*run.cells, category(name), *_arms(tally))


def _arms(tally: Tally) -> tuple[Cell, ...]:
    nothing, neutral = tally.control(TrialKind.CONTROL), tally.control(TrialKind.NEUTRAL)
    shares = (nothing.anyway, nothing.gap, neutral.anyway, neutral.gap)
    return (tally.n, tally.compliance, *shares)


def _kinds(every: tuple[DefenseRun, ...], marked: str) -> Table:
    rows = [
        (*run.cells, figure, kind, why)
        for run in every
        for figure, kind, why in kinds_of(run.measured.campaign, run.defense)
    ]
    return Table(
        name="kinds",
        title="Which figures are consistency checks, and which are findings",
        heads=(
            *RUN,
            Head("figure", "Figure"),
            Head("kind", "Shows"),
            Head("why", "Because"),
        ),
        rows=tuple(rows),
        notes=(
            "Consistency check: its value was settled when the suite was made.",
            "Another value there means a fault of suite, gate or harness.",
            "Finding: it could have come out otherwise.",
        ),
        simulated=marked,
        section=KINDS,
    )


def kinds_of(campaign: Campaign, defense: str) -> Iterator[tuple[str, str, str]]:
    """Yield what each rate of a defense shows: its name, check or finding, and why."""
    planner = campaign.planner
    follows = planner.name in _FOLLOWERS and campaign.suite in _WRITTEN
    plans = f"`{printable(planner.name)}` proposes what the suite's author wrote"
    yield (
        ("Complied", CHECK, f"{plans}; how often it follows a text is its published parameter")
        if follows
        else ("Complied", FINDING, "the planner decides what it proposes")
    )
    if defense == "none" and follows:
        yield "UASR, SCMHR", CHECK, "without a defense, what complies is carried out"
    elif defense in GATES and follows:
        why = "each pair was shown to be refused by the gate before the suite was frozen"
        yield "UASR, SCMHR", CHECK, why
    else:
        yield (
            "UASR, SCMHR",
            FINDING,
            "plans that the suite's author did not write, or no gate of ours",
        )
    if defense in {"none", *GATES} and planner.name in _KEEPERS and campaign.suite in frozen():
        yield "BTCR, FRR", CHECK, "each benign plan was shown to come to its end under the gate"
    else:
        yield "BTCR, FRR", FINDING, "the planner or the defense decides whether work gets done"
