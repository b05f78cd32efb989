# SPDX-License-Identifier: Apache-2.0
"""A report's tables as CSV files and as JSON: numbers, not words for them.

A share becomes six columns: `_k`, `_n`, `_rate`, `_low`, `_high` (Wilson, 95 %) and `_most` (rule
of three, of none). What is undefined is empty, or null. Every file says what is simulated.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator
from typing import Any

from missionpair.report.cells import every_cell
from missionpair.report.collected import CampaignReport
from missionpair.report.table import Table, columns, values

SIMULATED = "simulated"
#: What a spreadsheet takes for a formula when a text begins with it.
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


def sheets(report: CampaignReport) -> Iterator[tuple[str, Iterable[str]]]:
    """Yield each table's file name and its CSV, in pieces; also `cells.csv`, with every cell."""
    for table in report.tables:
        yield f"{table.name}.csv", (sheet(table),)
    yield "cells.csv", _cells(report)


def sheet(table: Table) -> str:
    """Return a table as CSV with a line of names, rows below a line included."""
    written = io.StringIO()
    writer = csv.writer(written, lineterminator="\n")
    rows = records(table)
    names = list(rows[0]) if rows else _names(table)
    writer.writerow(names)
    writer.writerows([_field(row[name]) for name in names] for row in rows)
    return written.getvalue()


def records(table: Table) -> list[dict[str, Any]]:
    """Return each row by the names of its columns; undefined is None."""
    split = [columns(head, cells) for head, cells in zip(table.heads, _turned(table), strict=True)]
    found = []
    for row in (*table.rows, *table.foot):
        record: dict[str, Any] = {}
        for names, cell in zip(split, row, strict=True):
            record |= zip(names, values(cell, len(names)), strict=True)
        record.setdefault(SIMULATED, table.simulated or "no")
        found.append(record)
    return found


def payload(report: CampaignReport) -> dict[str, Any]:
    """Return the whole report as one JSON object."""
    return {
        "simulated": report.simulated,
        "headlines": list(report.headlines),
        "remarks": list(report.remarks),
        "tables": {
            table.name: {
                "title": table.title,
                "label": table.label,
                "simulated": table.simulated,
                "notes": list(table.notes),
                "rows": records(table),
            }
            for table in report.tables
        },
    }


def _cells(report: CampaignReport) -> Iterator[str]:
    for number, table in enumerate(every_cell(report.logs)):
        content = sheet(table)
        yield content if number == 0 else content.partition("\n")[2]


def _names(table: Table) -> list[str]:
    return list(dict.fromkeys([*(head.key for head in table.heads), SIMULATED]))


def _turned(table: Table) -> list[tuple[Any, ...]]:
    """Return the cells of each column."""
    rows = (*table.rows, *table.foot)
    return [tuple(row[number] for row in rows) for number in range(len(table.heads))]


def _field(value: Any) -> Any:
    """Return a value as it stands in CSV; a text that a spreadsheet would run is quoted."""
    if isinstance(value, str) and value.startswith(_FORMULA):
        return f"'{value}"
    return value
