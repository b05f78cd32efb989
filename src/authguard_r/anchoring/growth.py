# SPDX-License-Identifier: Apache-2.0
"""How much of a log each mission wrote, counted as the log grows and never from its beginning.

Counted in the turn that makes a checkpoint, which already reads the rows. The caller counts the
records since then. Spec page: docs/spec/store.md#growth
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeVar

from msgspec import Struct

from authguard_r.audit.record import NONE
from authguard_r.core.encoding import decode, encode
from authguard_r.core.errors import MalformedError, StoreError
from authguard_r.core.identifiers import Count
from authguard_r.core.ports import Turn
from authguard_r.core.reasons import Reason
from authguard_r.wire.gate_limits import LIMITS

#: Where the counts lie: one for each mission, and how many records were counted.
KIND, COUNTED = "growth", " counted"
#: In front of the mission's name in a record. A bare quotation mark begins or ends a text, so no
#: untrusted text can contain this, and nothing before the link has a field of that name.
_MID, _LINK = b'"mid":"', b'"link":{'


class Growth(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What a mission has written.

    Args:
        records: how many.
        bytes: records, what lies beside them, and links.
    """

    records: Count = 0
    bytes: Count = 0


class GrowthCount(Struct, frozen=True, kw_only=True):
    """What a mission has written among the first `upto` records of the log."""

    growth: Growth
    upto: int


T = TypeVar("T")
Rows = Iterable[tuple[int, bytes, bytes, bytes]]


def count(turn: Turn) -> None:
    """Count the next page of records, and hold what each mission has written so far.

    Raises:
        StoreError: what is held is no count.
    """
    upto = _upto(turn)
    rows = turn.rows(upto, LIMITS.growth_page)
    if not rows:
        return
    for mid, more in _of(rows).items():
        turn.put(KIND, mid, encode(_sum(_held(turn, mid), more)))
    turn.put(KIND, COUNTED, encode(upto + len(rows)))


def counted(turn: Turn, mid: str) -> GrowthCount:
    """Return what a mission has written, up to one page after what is held.

    Raises:
        StoreError: what is held is no count.
    """
    upto = _upto(turn)
    rows = turn.rows(upto, LIMITS.growth_page)
    growth = _sum(_held(turn, mid), _of(rows).get(mid, Growth()))
    return GrowthCount(growth=growth, upto=upto + len(rows))


def mission_of(record: bytes) -> str:
    """Return the mission that a record is of, `-` when it is of none; nothing is verified."""
    _, _, link = record.partition(_LINK)
    _, found, rest = link.partition(_MID)
    mid, ends, _ = rest.partition(b'"')
    return mid.decode("ascii", "replace") if found and ends else NONE


def _of(rows: Rows) -> dict[str, Growth]:
    found: dict[str, Growth] = {}
    for _, record, sealed, link in rows:
        mid, size = mission_of(record), len(record) + len(sealed) + len(link)
        found[mid] = _sum(found.get(mid, Growth()), Growth(records=1, bytes=size))
    return found


def _sum(one: Growth, two: Growth) -> Growth:
    return Growth(records=one.records + two.records, bytes=one.bytes + two.bytes)


def _upto(turn: Turn) -> int:
    held = turn.get(KIND, COUNTED)
    return 0 if held is None else _decoded(held, int)


def _held(turn: Turn, mid: str) -> Growth:
    held = turn.get(KIND, mid)
    return Growth() if held is None else _decoded(held, Growth)


def _decoded(data: bytes, kind: type[T]) -> T:
    try:
        return decode(data, kind, where="store.growth")
    except MalformedError as error:
        raise StoreError(error.message, where=error.where, reason=Reason.STORE_CORRUPT) from error
