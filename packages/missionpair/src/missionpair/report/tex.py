# SPDX-License-Identifier: Apache-2.0
"""Tables as LaTeX in the paper's shapes: `k/n~[low, high]`, `---` where undefined, booktabs."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator

from missionpair.measures import Proportion
from missionpair.report.collected import CampaignReport
from missionpair.report.names import slug
from missionpair.report.table import Cell, Head, LatexName, Row, Table, text

UNDEFINED = "---"
_ESCAPES = {
    "\\": r"\textbackslash{}",
    "{": r"\{",
    "}": r"\}",
    "%": r"\%",
    "&": r"\&",
    "#": r"\#",
    "$": r"\$",
    "_": r"\_",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
}
_SPECIAL = re.compile("[" + re.escape("".join(_ESCAPES)) + "]")


def tex_files(report: CampaignReport) -> Iterator[tuple[str, Iterable[str]]]:
    """Yield each table's file name and LaTeX, and a document that holds all of them."""
    labeled = [table for table in report.tables if table.label]
    for table in labeled:
        yield f"{table.name}.tex", (tex(table),)
    yield (
        "all.tex",
        (
            "\\documentclass{article}\n\\usepackage{booktabs}\n\\usepackage{graphicx}\n",
            "\\begin{document}\n",
            *(f"\\input{{{table.name}.tex}}\n" for table in labeled),
            "\\end{document}\n",
        ),
    )


def tex(table: Table) -> str:
    """Return a table as a `table` environment, with the paper's label where it has one."""
    words = sum(1 for head in table.heads if _is_name(table, head))
    align = "l" * words + "c" * (len(table.heads) - words)
    caption = table.caption or f"{escaped(table.title)}."
    if table.simulated:
        caption += f" \\textbf{{Simulated: {escaped(table.simulated)}.}}"
    lines = [
        r"\begin{table}[t]",
        r"\centering",
        rf"\caption{{{caption}}}",
        rf"\label{{tab:{slug(table.label.removeprefix('tab:'))}}}",
        r"\resizebox{\columnwidth}{!}{%",
        rf"\begin{{tabular}}{{{align}}}",
        r"\toprule",
        " & ".join(head.tex or escaped(head.name) for head in table.heads) + r" \\",
        r"\midrule",
        *(_row(table, row, foot=False) for row in table.rows),
        *([r"\midrule"] if table.foot else []),
        *(_row(table, row, foot=True) for row in table.foot),
        r"\bottomrule",
        r"\end{tabular}}",
        r"\end{table}",
    ]
    return "\n".join(lines) + "\n"


def escaped(words: str) -> str:
    """Return text that LaTeX prints as it is."""
    return _SPECIAL.sub(lambda found: _ESCAPES[found[0]], words)


def _is_name(table: Table, head: Head) -> bool:
    """Return True of the columns on the left that hold names, as the paper aligns them."""
    number = table.heads.index(head)
    cells = [row[number] for row in table.rows if row[number] is not None]
    before = table.heads[:number]
    named = bool(cells) and all(isinstance(cell, str | LatexName) for cell in cells)
    return number == 0 or (named and all(_is_name(table, one) for one in before))


def _row(table: Table, row: Row, *, foot: bool) -> str:
    cells = (_cell(cell, head, foot=foot) for head, cell in zip(table.heads, row, strict=True))
    return " & ".join(cells) + r" \\"


def _cell(cell: Cell, head: Head, *, foot: bool) -> str:
    if isinstance(cell, LatexName):
        return cell.tex
    words = text(cell, head, foot=foot)
    if words is None:
        return UNDEFINED
    # a share and its interval stay on one line
    return escaped(words).replace(" [", "~[") if isinstance(cell, Proportion) else escaped(words)
