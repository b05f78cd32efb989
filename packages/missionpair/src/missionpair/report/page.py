# SPDX-License-Identifier: Apache-2.0
"""A report as one HTML page that needs nothing but itself: no script, no font, no other file.

Every plot stands beside a table with the same figures. Names out of logs are escaped. The page
follows the reader's dark or light setting and prints without either.
"""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from html import escape
from importlib.resources import files

from missionpair.measures import Gap, Proportion
from missionpair.report.collected import CampaignReport
from missionpair.report.names import slug
from missionpair.report.svg import Plot, draw
from missionpair.report.table import Cell, Head, Row, Table, text

_UNDEFINED = '<span title="undefined">\u2014</span>'


def page(report: CampaignReport) -> str:
    """Return the whole page."""
    style = files("missionpair.report").joinpath("page.css").read_text(encoding="utf-8")
    marked = "simulated parts" if report.simulated else ""
    title = f"MissionPAIR report{f' ({marked})' if marked else ''}"
    lines = [
        "<!DOCTYPE html>",
        '<html lang="en">',
        "<head>",
        '<meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        '<meta name="color-scheme" content="light dark">',
        f"<title>{escape(title)}</title>",
        f"<style>\n{style}</style>",
        "</head>",
        "<body>",
        '<a class="skip" href="#report">Skip to the report</a>',
        f"<header><h1>{escape(title)}</h1>",
        *_remarks(report),
        "</header>",
        *_contents(report),
        '<main id="report">',
        *(line for section in report.sections for line in _section(report, section)),
        "</main>",
        "</body>",
        "</html>",
    ]
    return "\n".join(lines) + "\n"


def _remarks(report: CampaignReport) -> Iterator[str]:
    if report.remarks:
        yield '<ul class="remarks">'
        yield from (f"<li>{escape(remark)}</li>" for remark in report.remarks)
        yield "</ul>"


def _contents(report: CampaignReport) -> Iterator[str]:
    yield '<nav aria-label="Contents"><ul>'
    for section in report.sections:
        yield f'<li><a href="#{_anchor(section)}">{escape(section)}</a></li>'
    yield "</ul></nav>"


def _section(report: CampaignReport, section: str) -> Iterator[str]:
    anchor = _anchor(section)
    yield f'<section id="{anchor}" aria-labelledby="{anchor}-head">'
    yield f'<h2 id="{anchor}-head">{escape(section)}</h2>'
    for plot in report.plots:
        if plot.section == section:
            yield from _figure(plot)
    for table in report.tables:
        if table.section == section:
            yield from _table(table)
    yield "</section>"


def _figure(plot: Plot) -> Iterator[str]:
    yield f'<figure id="{escape(plot.name, quote=True)}">'
    yield draw(plot)
    beside = escape(plot.table, quote=True)
    yield f"<figcaption>{escape(plot.title)}. {_mark(plot.simulated)}"
    yield f'The figures: <a href="#table-{beside}">table {beside}</a>.</figcaption>'
    yield "</figure>"


def _table(table: Table) -> Iterator[str]:
    name = f"table-{escape(table.name, quote=True)}"
    yield f'<div class="wide" role="region" tabindex="0" aria-labelledby="{name}-title">'
    yield f'<table id="{name}">'
    label = f" <code>{escape(table.label)}</code>" if table.label else ""
    title = f"{escape(table.title)} {_mark(table.simulated)}{label}"
    yield f'<caption id="{name}-title">{title}</caption>'
    yield f"<thead><tr>{''.join(map(_head, table.heads))}</tr></thead>"
    yield "<tbody>"
    yield from (_row(table, row, foot=False) for row in table.rows)
    if not table.rows:
        yield f'<tr><td colspan="{len(table.heads)}">nothing of this kind was run</td></tr>'
    yield "</tbody>"
    if table.foot:
        yield "<tfoot>"
        yield from (_row(table, row, foot=True) for row in table.foot)
        yield "</tfoot>"
    yield "</table></div>"
    yield from (f'<p class="note">{escape(note)}</p>' for note in table.notes)


def _head(head: Head) -> str:
    kind = ' class="published"' if head.published else ""
    return f'<th scope="col"{kind}>{escape(head.name)}</th>'


def _row(table: Table, row: Row, *, foot: bool) -> str:
    cells = []
    for number, (head, cell) in enumerate(zip(table.heads, row, strict=True)):
        words = text(cell, head, foot=foot)
        shown = _UNDEFINED if words is None else escape(words)
        if number == 0:
            cells.append(f'<th scope="row">{shown}</th>')
        else:
            cells.append(f"<td{_kind(cell, head)}>{shown}</td>")
    return f"<tr>{''.join(cells)}</tr>"


def _kind(cell: Cell, head: Head) -> str:
    kinds = ["published"] if head.published else []
    if isinstance(cell, int | Fraction | Proportion | Gap):
        kinds.append("number")
    return f' class="{" ".join(kinds)}"' if kinds else ""


def _mark(simulated: str) -> str:
    return (
        f'<strong class="simulated">Simulated: {escape(simulated)}.</strong> ' if simulated else ""
    )


def _anchor(section: str) -> str:
    return f"section-{slug(section)}"
