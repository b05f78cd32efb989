# SPDX-License-Identifier: Apache-2.0
"""`authguard audit growth`: how much of a log each mission wrote, in records and in bytes.

Spec page: docs/spec/store.md#growth
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from msgspec import Struct

from authguard_r.audit.record import NONE, LogRow, read_record
from authguard_r.cli.audit import StoreArgument
from authguard_r.cli.inputs import JsonFlag
from authguard_r.cli.log_reading import reading
from authguard_r.wire.output import emit

_HEAD = ("mission", "records", "decisions", "bytes", "bytes/decision", "share")


class _GrowthRow(Struct):
    """What one mission wrote so far."""

    records: int = 0
    decisions: int = 0
    bytes: int = 0


def growth_command(store: StoreArgument, as_json: JsonFlag = False) -> int:
    """Show how much of a log each mission wrote: records, decisions, bytes (`-`: no mission).

    Bytes are records, sealed values and links. The overhead of the file (a few percent) and the
    registry are not counted. The command verifies nothing.
    """
    with reading(store) as log:
        found = _count(log.rows)
        told_by = None if log.gate is None else log.gate.pid
    total = _sum(found.values())
    missions = [
        {"mission": mid, **_figures(one, total)}
        for mid, one in sorted(found.items(), key=lambda item: (-item[1].bytes, item[0]))
    ]
    payload = {**_figures(total, total), "missions": missions, "told_by": told_by}
    emit(payload, _lines(missions, {"mission": "all", **_figures(total, total)}), as_json=as_json)
    return 0


def _count(rows: Iterable[LogRow]) -> dict[str, _GrowthRow]:
    found: dict[str, _GrowthRow] = {}
    for row in rows:
        record = read_record(row.record, where=f"record {row.seq}")
        one = found.setdefault(record.link.mid, _GrowthRow())
        one.records += 1
        one.decisions += record.kind == "decision"
        one.bytes += len(row.record) + len(row.sealed) + len(row.link)
    return found


def _sum(found: Iterable[_GrowthRow]) -> _GrowthRow:
    total = _GrowthRow()
    for one in found:
        total.records += one.records
        total.decisions += one.decisions
        total.bytes += one.bytes
    return total


def _figures(one: _GrowthRow, total: _GrowthRow) -> dict[str, Any]:
    """Return the display of one growth finding."""
    return {
        "records": one.records,
        "decisions": one.decisions,
        "bytes": one.bytes,
        "bytes_per_decision": round(one.bytes / one.decisions) if one.decisions else None,
        "share": round(one.bytes / total.bytes, 3) if total.bytes else 0.0,
    }


def _lines(missions: list[dict[str, Any]], every: dict[str, Any]) -> Iterator[str]:
    table = [_HEAD, *(_cells(one) for one in (*missions, every))]
    widths = [max(len(row[at]) for row in table) for at in range(len(_HEAD))]
    for name, *cells in table:
        padded = [cell.rjust(width) for cell, width in zip(cells, widths[1:], strict=True)]
        yield "  ".join((name.ljust(widths[0]), *padded))


def _cells(one: dict[str, Any]) -> tuple[str, ...]:
    each = one["bytes_per_decision"]
    return (
        str(one["mission"]),
        *(f"{one[name]:,}" for name in ("records", "decisions", "bytes")),
        NONE if each is None else f"{each:,}",
        f"{one['share']:.1%}",
    )
