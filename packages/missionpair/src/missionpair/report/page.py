# SPDX-License-Identifier: Apache-2.0
"""A report as one HTML page that needs nothing but itself: no script, no font, no other file.

`page.html` is its template. Every plot stands beside a table with the same figures. The template
engine escapes everything that comes out of a log. The page follows the reader's dark or light
setting and prints without either.
"""

from __future__ import annotations

from fractions import Fraction
from functools import partial
from importlib.resources import files

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from missionpair.measures import Gap, Proportion
from missionpair.report.collected import CampaignReport
from missionpair.report.names import slug
from missionpair.report.svg import Plot, draw
from missionpair.report.table import Cell, Head, text
from missionpair.report.terms import terms_of


def page(report: CampaignReport) -> str:
    """Return the whole page."""
    marked = " (simulated parts)" if report.simulated else ""
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, keep_trailing_newline=True
    )
    environment.filters["slug"] = slug
    return environment.from_string(_file("page.html")).render(
        report=report,
        title=f"MissionPAIR report{marked}",
        style=Markup(_file("page.css")),  # noqa: S704 - our own file
        draw=_drawn,
        kinds=_kinds,
        terms=terms_of,
        pairs=partial(zip, strict=True),
        text=text,
    )


def _file(name: str) -> str:
    return files("missionpair.report").joinpath(name).read_text(encoding="utf-8")


def _drawn(plot: Plot) -> Markup:
    return Markup(draw(plot))  # noqa: S704 - it escapes its own texts


def _kinds(cell: Cell, head: Head) -> str | None:
    """Return the classes of a cell; None: it has none."""
    kinds = ["published"] if head.published else []
    if isinstance(cell, int | Fraction | Proportion | Gap):
        kinds.append("number")
    return " ".join(kinds) or None
