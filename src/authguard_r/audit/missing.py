# SPDX-License-Identifier: Apache-2.0
"""Values that lie beside no record any more, though no order in the log explains it.

Only an order to destroy sealed fields, by a person or by the signed retention, lets values go, and
only those in boxes. A writer of the file can remove other values. The chain stays valid then, for a
record commits to its values and does not contain them. Memory is bounded. Spec page:
docs/spec/audit-record.md#missing
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from msgspec import Struct
from msgspec.structs import replace

from authguard_r.audit.record import BOX, WRAP
from authguard_r.core.identifiers import Count

#: The order that destroys values (`commands.Verb.SHRED`).
_ORDER = "shred"
#: Fields that lie in no box.
_NEVER_BOXED = frozenset({"now", "site", "safety", "policy", "list"})
#: Kinds of missing values that are reported apart; further kinds count as one, which no order
#: explains.
_MOST = 1 << 18
#: The same of one mission: an order looks at all of them.
_MOST_OF_ONE = 1 << 8


class MissingValues(Struct, frozen=True, kw_only=True):
    """Values of one name beside the records of one mission.

    Args:
        mid: the mission, `-` for none; `*` where too many differ.
        name: of the value.
        count: how many are missing.
        first: the first record that lacks it.
    """

    mid: str
    name: str
    count: Count
    first: Count


class DestructionOrder(Struct, frozen=True):
    """An order to destroy: the mission, `-` for the records of none, and the classes."""

    mid: str
    classes: tuple[str, ...]


class Gone:
    """What is missing of the log so far."""

    def __init__(self) -> None:
        #: By mission and name, so that an order looks at its own mission alone.
        self._left: dict[str, dict[str, MissingValues]] = {}
        self._size = 0
        self._orders: dict[DestructionOrder, None] = {}

    @property
    def orders(self) -> tuple[DestructionOrder, ...]:
        """Every order so far, each once, for what lies before the first record seen here."""
        return tuple(self._orders)

    @property
    def left(self) -> tuple[MissingValues, ...]:
        """What no order explains, in the order in which it was found."""
        every = (one for of in self._left.values() for one in of.values())
        return tuple(sorted(every, key=lambda one: (one.first, one.name)))

    def take(self, seq: int, mid: str, committed: Iterable[str], beside: Iterable[str]) -> None:
        """Take in a record that commits to more than lies beside it."""
        names = tuple(committed)
        has_box = any(name.startswith(BOX) for name in names)
        for name in set(names).difference(beside):
            if name.startswith((BOX, WRAP)) or name in _NEVER_BOXED or not has_box:
                self._add(MissingValues(mid=mid, name=name, count=1, first=seq))

    def hear(self, decision: str, opened: dict[str, Any]) -> None:
        """Take in an order, if it is one: what it names may be gone up to here."""
        of, classes = opened.get("of"), opened.get("classes")
        if decision == _ORDER and isinstance(of, str) and isinstance(classes, list):
            self.carry_out(DestructionOrder(of, tuple(map(str, classes))))

    def carry_out(self, order: DestructionOrder) -> None:
        """Let go of what an order explains."""
        self._orders[order] = None
        left = self._left.pop(order.mid, {})
        kept = {name: one for name, one in left.items() if not _explains(order, one)}
        self._size -= len(left) - len(kept)
        if kept:
            self._left[order.mid] = kept

    def join(self, orders: Iterable[DestructionOrder], left: Iterable[MissingValues]) -> None:
        """Take in what is missing of the next piece of the log, and the orders in it."""
        for order in orders:
            self.carry_out(order)
        for one in left:
            self._add(one)

    def _add(self, one: MissingValues) -> None:
        of = self._left.get(one.mid, {})
        if one.name not in of and (self._size >= _MOST or len(of) >= _MOST_OF_ONE):
            one = replace(one, mid="*", name="*")
            of = self._left.get("*", {})
        known = of.get(one.name)
        self._size += known is None
        of[one.name] = one if known is None else replace(known, count=known.count + one.count)
        self._left[one.mid] = of


def told(left: Iterable[MissingValues]) -> Iterator[str]:
    """Yield what is missing, for people."""
    for one in left:
        of = "" if one.mid == "-" else f" of mission {one.mid}"
        where = f"first at record {one.first}"
        yield f"MISSING: {one.count} x `{one.name}`{of}, {where}: no order says why"


def _explains(order: DestructionOrder, one: MissingValues) -> bool:
    for front in (BOX, WRAP):
        if one.mid == order.mid and one.name.startswith(front):
            return not set(order.classes).isdisjoint(one.name.removeprefix(front).split("+"))
    return False
