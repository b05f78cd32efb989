# SPDX-License-Identifier: Apache-2.0
"""Plots of points with intervals as inline SVG: no script, no font, no color of its own.

Colors come from the page's style sheet, so that dark pages and paper have theirs. Marks differ in
shape too. The same figures give the same bytes, and every text is escaped.
"""

from __future__ import annotations

from collections.abc import Iterator
from html import escape
from math import log10

from msgspec import Struct

_LEFT, _RIGHT, _WIDTH = 260, 24, 800
_TOP, _ROW, _BOTTOM = 34, 26, 34
_LABEL = 40


class Dot(Struct, frozen=True, kw_only=True):
    """One point of a line.

    Args:
        series: which of the plot's series it is of.
        value: where it lies.
        low: its interval's lower end; the value where it has none.
        high: its interval's upper end.
        tip: what a reader of this point sees.
    """

    series: int
    value: float
    low: float
    high: float
    tip: str


class PlotRow(Struct, frozen=True):
    """One row of a plot; without dots it is undefined, and says so."""

    label: str
    dots: tuple[Dot, ...]


class Axis(Struct, frozen=True):
    """What a plot's horizontal axis shows.

    Args:
        title: with its unit.
        low: its left end; above 0 where it is logarithmic.
        high: its right end.
        logarithmic: it shows orders of magnitude, of microseconds.
    """

    title: str
    low: float
    high: float
    logarithmic: bool = False

    def at(self, value: float) -> float:
        """Return where a value lies, in the picture's units."""
        low, high = self._place(self.low), self._place(self.high)
        share = (self._place(min(max(value, self.low), self.high)) - low) / (high - low)
        return _LEFT + share * (_WIDTH - _LEFT - _RIGHT)

    def ticks(self) -> tuple[tuple[float, str], ...]:
        """Return marked values with their words."""
        if self.logarithmic:
            powers = range(round(log10(self.low)), round(log10(self.high)) + 1)
            return tuple((10.0**power, _duration(power)) for power in powers)
        step = (self.high - self.low) / 4
        return tuple((at, f"{at:g}") for at in (self.low + number * step for number in range(5)))

    def _place(self, value: float) -> float:
        return log10(value) if self.logarithmic else value


def _duration(power: int) -> str:
    """Return a power of ten of microseconds in words."""
    thousands = min(power // 3, 2)
    return f"{10 ** (power - 3 * thousands)} {('us', 'ms', 's')[thousands]}"


class Plot(Struct, frozen=True, kw_only=True):
    """One plot.

    Args:
        name: unique in a report.
        title: what it shows.
        axis: the horizontal one.
        series: names, in the order of their marks; at most four.
        lines: from top to bottom.
        simulated: which parts stand for something that was not run.
        table: the table that has the same figures.
        section: the part of the report that it belongs to.
    """

    name: str
    title: str
    axis: Axis
    series: tuple[str, ...]
    lines: tuple[PlotRow, ...]
    simulated: str = ""
    table: str = ""
    section: str = ""


def draw(plot: Plot) -> str:
    """Return a plot as an `svg` element that says the same in words to who does not see it."""
    height = _TOP + _ROW * len(plot.lines) + _BOTTOM + 22
    name = escape(plot.name, quote=True)
    words = "; ".join(
        f"{line.label}: {', '.join(dot.tip for dot in line.dots) or 'undefined'}"
        for line in plot.lines
    )
    title = plot.title + (f" (simulated: {plot.simulated})" if plot.simulated else "")
    size = f'viewBox="0 0 {_WIDTH} {height}"'
    return "\n".join(
        [
            f'<svg {size} role="img" aria-labelledby="{name}-title {name}-words">',
            f'<title id="{name}-title">{escape(title)}</title>',
            f'<desc id="{name}-words">{escape(words)}</desc>',
            *_legend(plot),
            *_grid(plot, height),
            *(part for row, line in enumerate(plot.lines) for part in _line(plot, row, line)),
            "</svg>",
        ]
    )


def _legend(plot: Plot) -> Iterator[str]:
    if plot.simulated:
        yield '<text class="simulated" x="0" y="18">simulated</text>'
    for number, series in enumerate(plot.series):
        x = _LEFT + number * (_WIDTH - _LEFT) / len(plot.series)
        yield _mark(number, x + 6, 14)
        yield f'<text x="{x + 18:.1f}" y="18">{escape(series)}</text>'


def _grid(plot: Plot, height: int) -> Iterator[str]:
    bottom = height - _BOTTOM - 12
    for value, words in plot.axis.ticks():
        x = plot.axis.at(value)
        yield f'<path class="grid" d="M{x:.1f} {_TOP}V{bottom}"/>'
        yield f'<text x="{x:.1f}" y="{bottom + 16}" text-anchor="middle">{escape(words)}</text>'
    middle = (_LEFT + _WIDTH - _RIGHT) / 2
    yield (
        f'<text x="{middle:.1f}" y="{height - 8}" text-anchor="middle">'
        f"{escape(plot.axis.title)}</text>"
    )


def _line(plot: Plot, row: int, line: PlotRow) -> Iterator[str]:
    y = _TOP + _ROW * row + _ROW / 2
    shown = line.label if len(line.label) <= _LABEL else line.label[: _LABEL - 1] + "\u2026"
    yield f'<text x="{_LEFT - 10}" y="{y + 4:.1f}" text-anchor="end">{escape(shown)}</text>'
    if not line.dots:
        yield f'<text x="{_LEFT + 4}" y="{y + 4:.1f}">undefined</text>'
    for number, dot in enumerate(line.dots):
        at = y + (number - (len(line.dots) - 1) / 2) * 7
        low, high = plot.axis.at(dot.low), plot.axis.at(dot.high)
        yield f'<g class="s{dot.series}"><title>{escape(dot.tip)}</title>'
        if dot.low < dot.high:
            yield f'<path class="range" d="M{low:.1f} {at:.1f}H{high:.1f}"/>'
        yield _mark(dot.series, plot.axis.at(dot.value), at)
        yield "</g>"


def _mark(series: int, x: float, y: float) -> str:
    """Return a series' mark: a disc, a diamond, a square or a triangle."""
    paths = (
        f"M{x - 4:.1f} {y:.1f}a4 4 0 1 0 8 0a4 4 0 1 0 -8 0z",
        f"M{x:.1f} {y - 5:.1f}l5 5l-5 5l-5 -5z",
        f"M{x - 4:.1f} {y - 4:.1f}h8v8h-8z",
        f"M{x:.1f} {y - 5:.1f}l5 9h-10z",
    )
    return f'<path class="mark s{series}" d="{paths[series]}"/>'
