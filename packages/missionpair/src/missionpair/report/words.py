# SPDX-License-Identifier: Apache-2.0
"""A report's first tables as text, for people at a terminal."""

from __future__ import annotations

from collections.abc import Iterator

from missionpair.report.collected import CampaignReport
from missionpair.report.table import Row, Table, text


def lines(report: CampaignReport) -> Iterator[str]:
    """Yield the headlines, the remarks and the tables that come first."""
    yield from report.headlines
    yield from report.remarks
    for table in report.tables:
        if table.front:
            yield ""
            yield from table_lines(table)


def table_lines(table: Table) -> Iterator[str]:
    """Yield a table with its title; what is simulated is said there."""
    marked = f" [simulated: {table.simulated}]" if table.simulated else ""
    yield f"{table.title}{marked}"
    heads = [head.name for head in table.heads]
    body = [_cells(table, row, foot=False) for row in table.rows]
    foot = [_cells(table, row, foot=True) for row in table.foot]
    widths = [max(map(len, column)) for column in zip(heads, *body, *foot, strict=True)]
    for row in (heads, *body, *foot):
        padded = (cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        yield f"  {'  '.join(padded)}".rstrip()


def _cells(table: Table, row: Row, *, foot: bool) -> list[str]:
    found = (text(cell, head, foot=foot) for head, cell in zip(table.heads, row, strict=True))
    return ["---" if words is None else words for words in found]
