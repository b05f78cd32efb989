# SPDX-License-Identifier: Apache-2.0
"""A report as data: tables and plots in order, before their layout."""

from __future__ import annotations

from collections.abc import Iterable

from msgspec import Struct
from msgspec.structs import replace

from missionpair.measures import MeasuredCampaign
from missionpair.report.cells import cell_tables
from missionpair.report.control import control_tables
from missionpair.report.costs import cost_tables
from missionpair.report.headline import headline
from missionpair.report.mutation import Mutation, mutation_table
from missionpair.report.names import simulated
from missionpair.report.outcomes import outcome_tables
from missionpair.report.paper import paper_tables
from missionpair.report.plots import plots
from missionpair.report.setup import remarks, setup_table
from missionpair.report.svg import Plot
from missionpair.report.table import Table
from missionpair.report.tries import leakage_table, leaks_of, try_tables


class CampaignReport(Struct, frozen=True, kw_only=True):
    """What one or several campaigns came to.

    Args:
        logs: what it is of.
        tables: in order; their names and labels are unique.
        plots: in order; their names are unique.
        headlines: each campaign in one sentence.
        remarks: what a reader must know before any figure.
        simulated: which parts of which campaign stand for something that was not run.
    """

    logs: tuple[MeasuredCampaign, ...]
    tables: tuple[Table, ...]
    plots: tuple[Plot, ...]
    headlines: tuple[str, ...]
    remarks: tuple[str, ...]
    simulated: str

    @property
    def sections(self) -> tuple[str, ...]:
        """The parts of the report that have something in them, in order."""
        return tuple(dict.fromkeys(table.section for table in self.tables))


def report(logs: Iterable[MeasuredCampaign], *, mutation: Mutation | None = None) -> CampaignReport:
    """Return the report of one or several campaigns.

    Args:
        logs: what `missionpair.measures.measure` made of each.
        mutation: what a mutation run found, where there was one.
    """
    given = tuple(logs)
    leaks = leaks_of(given)
    tables = [*paper_tables(given), *control_tables(given), *outcome_tables(given)]
    tables += [*cell_tables(given), *try_tables(given)]
    if leaks:
        tables.append(leakage_table(given, leaks))
    tables += cost_tables(given)
    if mutation is not None:
        tables.append(mutation_table(mutation))
    tables.append(setup_table(given))
    return CampaignReport(
        logs=given,
        tables=_unique(tables),
        plots=tuple(plots(given, leaks)),
        headlines=tuple(headline(n, one) for n, one in enumerate(given, 1)),
        remarks=tuple(remarks(given)),
        simulated=simulated(given),
    )


def _unique(tables: Iterable[Table]) -> tuple[Table, ...]:
    """Return tables whose names and labels are unique: the second of a name is numbered."""
    seen: set[str] = set()
    found = []
    for table in tables:
        name, label, number = table.name, table.label, 1
        while name in seen:
            number += 1
            name, label = f"{table.name}-{number}", table.label and f"{table.label}-{number}"
        seen.add(name)
        found.append(replace(table, name=name, label=label))
    return tuple(found)
