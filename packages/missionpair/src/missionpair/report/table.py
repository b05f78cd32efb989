# SPDX-License-Identifier: Apache-2.0
"""A table as data: what its columns are and what stands in them. Writers say how it looks."""

from __future__ import annotations

from enum import StrEnum
from fractions import Fraction

from msgspec import Struct

from missionpair.measures import Gap, Proportion


class LatexName(Struct, frozen=True):
    """A name that is spelled otherwise in LaTeX.

    Args:
        plain: for every reader.
        tex: LaTeX source.
    """

    plain: str
    tex: str


#: What stands in a table; None is undefined, which is neither 0 nor empty.
Cell = str | int | Fraction | Proportion | Gap | LatexName | None


class ShareForm(StrEnum):
    """How a share is spelled."""

    COUNT = "k/n"
    INTERVAL = "k/n [low, high]"
    POOLED = "k/n = percent [low, high]"
    PERCENT = "k/n (percent)"
    VALUE = "value"


class Head(Struct, frozen=True):
    """A column.

    Args:
        key: its name in files.
        name: its name for people.
        form: of its shares.
        foot: the same in rows below the line; None is `form`.
        tex: its name in LaTeX; empty is `name`.
        published: it repeats figures of the paper.
        digits: of fractions, behind the point.
    """

    key: str
    name: str
    form: ShareForm = ShareForm.INTERVAL
    foot: ShareForm | None = None
    tex: str = ""
    published: bool = False
    digits: int = 2


Row = tuple[Cell, ...]


class Table(Struct, frozen=True, kw_only=True):
    """One table.

    Args:
        name: its file's, unique in a report.
        title: what it shows.
        heads: its columns.
        rows: as many cells each as there are columns.
        foot: rows below a line, such as sums.
        label: its label in LaTeX; empty for a table that is not written there.
        caption: LaTeX source; empty is `title`.
        notes: what a reader must know: denominators, what it does not say.
        simulated: which parts stand for something that was not run; empty when none does.
        front: it is among those that people are shown first.
        section: the part of the report that it belongs to.
    """

    name: str
    title: str
    heads: tuple[Head, ...]
    rows: tuple[Row, ...]
    foot: tuple[Row, ...] = ()
    label: str = ""
    caption: str = ""
    notes: tuple[str, ...] = ()
    simulated: str = ""
    front: bool = False
    section: str = ""

    def __post_init__(self) -> None:
        if any(len(row) != len(self.heads) for row in (*self.rows, *self.foot)):
            raise TypeError(f"table `{self.name}` has a row with another number of columns")
        if len({head.key for head in self.heads}) < len(self.heads):
            raise TypeError(f"table `{self.name}` has two columns of one key")
        if len({head.name for head in self.heads}) < len(self.heads):
            raise TypeError(f"table `{self.name}` has two columns of one name")


def share(rate: Proportion, form: ShareForm) -> str:
    """Return a share in words; a share of nothing is undefined and has none."""
    if rate.value is None or rate.interval is None:
        raise TypeError("a share of nothing has no words")
    low, high = rate.interval
    counts, percent = f"{rate.k}/{rate.n}", f"{100 * rate.k / rate.n:.1f}%"
    return {
        ShareForm.COUNT: counts,
        ShareForm.INTERVAL: f"{counts} [{low:.2f}, {high:.2f}]",
        ShareForm.POOLED: f"{counts} = {percent} [{low:.2f}, {high:.2f}]",
        ShareForm.PERCENT: f"{counts} ({percent})",
        ShareForm.VALUE: f"{float(rate.value):.2f}",
    }[form]


def text(cell: Cell, head: Head, *, foot: bool = False) -> str | None:
    """Return a cell in words; None when it is undefined."""
    if cell is None or (isinstance(cell, Proportion) and not cell.n):
        return None
    if isinstance(cell, Proportion):
        return share(cell, (head.foot or head.form) if foot else head.form)
    if isinstance(cell, Gap):
        ends = (f"{end:+.{head.digits}f}" for end in (cell.value, cell.low, cell.high))
        return "{} [{}, {}]".format(*ends)
    if isinstance(cell, LatexName):
        return cell.plain
    if isinstance(cell, Fraction):
        return f"{float(cell):.{head.digits}f}"
    return clean(str(cell))


def columns(head: Head, cells: tuple[Cell, ...]) -> tuple[str, ...]:
    """Return the names in a file of the columns that one column of a table becomes."""
    if any(isinstance(cell, Proportion) for cell in cells):
        return tuple(f"{head.key}_{part}" for part in ("k", "n", "rate", "low", "high", "most"))
    if any(isinstance(cell, Gap) for cell in cells):
        return (head.key, f"{head.key}_low", f"{head.key}_high")
    return (head.key,)


def values(cell: Cell, width: int) -> tuple[str | int | float | None, ...]:
    """Return what stands in those columns; None where it is undefined."""
    if isinstance(cell, Proportion):
        ends = cell.interval or (None, None)
        return (cell.k, cell.n, *map(_number, (cell.value, *ends, cell.bound)))
    if isinstance(cell, Gap):
        return tuple(map(_number, (cell.value, cell.low, cell.high)))
    if cell is None:
        return (None,) * width
    if isinstance(cell, LatexName):
        return (cell.plain,)
    if isinstance(cell, Fraction):
        return (_number(cell),)
    return (clean(cell) if isinstance(cell, str) else cell,)


def clean(words: str) -> str:
    """Return all of a text out of a log, with its control characters escaped."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in words)


def _number(value: Fraction | float | None) -> float | None:
    """Return a number as files have it: what lies behind twelve digits is the machine's."""
    return None if value is None else round(float(value), 12)
