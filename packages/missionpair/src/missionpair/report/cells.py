# SPDX-License-Identifier: Apache-2.0
"""Tables by cell: category, channel, family, domain, combination, and the fields violated."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice

from missionpair.measures import Dimension, MeasuredCampaign, Proportion, Tally, largest
from missionpair.report.names import category, printable, simulated
from missionpair.report.runs import RUN, DefenseRun, runs
from missionpair.report.table import Head, Row, ShareForm, Table
from missionpair.words import TrialKind

SECTION = "By cell"
_CHUNK = 1_000
_WILSON = "Intervals: Wilson, 95 %."


def cell_tables(logs: tuple[MeasuredCampaign, ...]) -> Iterator[Table]:
    """Yield the tables by cell, in the report's order."""
    every, marked = tuple(runs(logs)), simulated(logs)
    for dimension in Dimension:
        yield _cells(every, dimension, marked)
    yield _combined(every, marked)
    yield _fields(every, marked)


_CELL = (
    Head("trials", "Attacks"),
    Head("complied", "Complied"),
    Head("blocked", "Blocked, of those"),
    Head("uasr", "UASR"),
    Head("scmhr", "SCMHR"),
    Head("deviation", "Largest planned D_M", digits=4),
)


def _cell(tally: Tally) -> Row:
    rates = (tally.compliance, tally.blocking, tally.uasr, tally.scmhr)
    return (tally.n, *rates, largest(tally.planned))


def _cells(every: tuple[DefenseRun, ...], dimension: Dimension, marked: str) -> Table:
    rows = tuple(
        (*run.cells, category(name) if dimension is Dimension.CATEGORY else name, *_cell(tally))
        for run in every
        for name, tally in run.measured.by(dimension, run.defense).items()
    )
    notes = {
        Dimension.CATEGORY: "A pair that changes several things stands in the row of the first.",
        Dimension.CHANNEL: "An attack on several channels has a row of its own.",
    }
    return Table(
        name=f"by-{dimension}",
        title=f"Attacks by {dimension}",
        heads=(*RUN, Head(str(dimension), str(dimension).capitalize()), *_CELL),
        rows=rows,
        notes=(_WILSON, *filter(None, [notes.get(dimension)])),
        simulated=marked,
        section=SECTION,
    )


def _combined(every: tuple[DefenseRun, ...], marked: str) -> Table:
    return Table(
        name="by-combination",
        title="Attacks that change several things",
        heads=(*RUN, Head("categories", "Categories"), *_CELL),
        rows=tuple(
            (*run.cells, printable(name), *_cell(tally))
            for run in every
            for name, tally in run.measured.combined(run.defense).items()
        ),
        notes=(_WILSON,),
        simulated=marked,
        section=SECTION,
    )


def every_cell(logs: tuple[MeasuredCampaign, ...]) -> Iterator[Table]:
    """Yield every cell by itself, a thousand rows at a time: too much for a page or for memory."""
    heads = (
        *RUN,
        *(Head(key, key) for key in ("kind", "domain", "categories", "channels", "family")),
        *_CELL,
        Head("completed", "Completed"),
        Head("rejected", "Refused"),
    )
    rows = _rows(logs)
    while chunk := tuple(islice(rows, _CHUNK)):
        yield Table(name="cells", title="Every cell", heads=heads, rows=chunk)


def _rows(logs: tuple[MeasuredCampaign, ...]) -> Iterator[Row]:
    for run in runs(logs):
        for cell, tally in sorted(run.measured.cells.items(), key=lambda item: item[0]):
            if cell.defense == run.defense:
                where = (cell.domain, "+".join(cell.categories), "+".join(cell.channels))
                counts = (*_cell(tally), tally.completed, tally.rejected)
                yield (*run.cells, cell.kind, *where, cell.family, *counts)


def _fields(every: tuple[DefenseRun, ...], marked: str) -> Table:
    rows: list[Row] = []
    for run in every:
        tally = run.measured.tally(run.defense)
        flow = run.measured.flow(run.defense, TrialKind.ATTACK)
        for code in sorted({*flow.planned, *flow.executed}):
            planned = Proportion(flow.planned.get(code, 0), tally.complied)
            executed = Proportion(flow.executed.get(code, 0), tally.n)
            rows.append((*run.cells, printable(code), planned, executed))
    heads = (
        Head("field", "Violated"),
        Head("planned", "In plans that complied", ShareForm.PERCENT),
        Head("executed", "In what was executed, of all", ShareForm.PERCENT),
    )
    return Table(
        name="fields",
        title="Protected fields that attacks violate",
        heads=RUN + heads,
        rows=tuple(rows),
        notes=("A trial may violate several fields and stands in each row.",),
        simulated=marked,
        section=SECTION,
    )
