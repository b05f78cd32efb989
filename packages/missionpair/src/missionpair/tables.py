# SPDX-License-Identifier: Apache-2.0
"""The paper's two tables from one run. Source: `tab:pilot-results`, `tab:pilot-category`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction

import authguard_reference as oracle
from missionpair.systems import System, SystemResult


@dataclass(frozen=True)
class MeasuredTrial:
    """One trial under one system."""

    trial: str
    category: str
    system: System
    result: SystemResult


def results_table(measured: Iterable[MeasuredTrial]) -> list[dict[str, object]]:
    """Return UASR, SCMHR, BTCR, FRR and SU for each system (`eq:uasr` to `eq:su`)."""
    rows: list[dict[str, object]] = []
    everything = list(measured)
    for system in System:
        mine = [item for item in everything if item.system is system]
        attacks = [item.result for item in mine if item.category != "benign"]
        benign = [item.result for item in mine if item.category == "benign"]
        uasr = oracle.uasr(sum(result.unauthorized for result in attacks), len(attacks))
        btcr = oracle.btcr(sum(result.completed for result in benign), len(benign))
        rows.append(
            {
                "system": str(system),
                "UASR": _number(uasr),
                "SCMHR": _number(oracle.scmhr([result.hijacked for result in attacks])),
                "BTCR": _number(btcr),
                "FRR": _number(oracle.frr(sum(not r.completed for r in benign), len(benign))),
                "SU": _number(None if uasr is None or btcr is None else oracle.su(uasr, btcr)),
            }
        )
    return rows


def category_table(measured: Iterable[MeasuredTrial]) -> list[dict[str, object]]:
    """Return unauthorized executions over attempts, by category and system."""
    rows: dict[str, dict[str, object]] = {}
    everything = [item for item in measured if item.category != "benign"]
    for item in everything:
        row = rows.setdefault(item.category, {"category": item.category})
        if str(item.system) not in row:
            same = [
                other.result.unauthorized
                for other in everything
                if other.category == item.category and other.system is item.system
            ]
            row[str(item.system)] = f"{sum(same)}/{len(same)}"
    return list(rows.values())


def as_text(rows: list[dict[str, object]]) -> list[str]:
    """Return a table for people."""
    if not rows:
        return []
    heads = list(rows[0])
    cells = [[str(row.get(head, "")) for head in heads] for row in rows]
    widths = [max(len(head), *(len(c[n]) for c in cells)) for n, head in enumerate(heads)]
    lines = ["  ".join(head.ljust(width) for head, width in zip(heads, widths, strict=True))]
    lines += [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in cells
    ]
    return lines


def _number(value: Fraction | None) -> str | float:
    return "undefined" if value is None else float(round(value, 4))
