# SPDX-License-Identifier: Apache-2.0
"""Which values of a record cannot be read: sealed for other readers, or destroyed.

A box that a reader cannot open lies beside the record as it was stored; of one that was destroyed,
or whose keys were, the record has the commitment alone. A display of a record says which of the two
it is: a value that is not shown differs from one that never existed. Spec page:
docs/spec/sealed-fields.md#reading
"""

from __future__ import annotations

from collections.abc import Container, Iterator
from collections.abc import Set as AbstractSet

from msgspec import Struct

from authguard_r.audit.record import BOX, WRAP, Record
from authguard_r.audit.sealed_envelopes import ACT, OBJECT, PARAMS, REGIONS, classes_of

#: What an action may be committed to as.
_ACTION = ("action", ACT, OBJECT, PARAMS, REGIONS)


class Closed(Struct, frozen=True, kw_only=True):
    """What of one record cannot be read. The writer of the log chose the names.

    Args:
        sealed: the classes whose keys the reader lacks.
        destroyed: the classes that went; those that were sealed together with them where it is
            not known which of them went.
        boxes: the classes of each box, and whether it was destroyed.
        fields: what the record commits to, and the display leaves out.
    """

    sealed: tuple[str, ...] = ()
    destroyed: tuple[str, ...] = ()
    boxes: dict[tuple[str, ...], bool] = {}
    fields: tuple[str, ...] = ()

    def __bool__(self) -> bool:
        """True when something is closed."""
        return bool(self.sealed or self.destroyed)

    def why(self, field: str) -> str:
        """Return why a value is not shown: `sealed`, `destroyed`, or empty for neither.

        Args:
            field: its name; `action` stands for each of its parts.
        """
        sealed = {one for classes in self.boxes for one in classes}
        names = _ACTION if field == "action" else (field,)
        found = {
            self.boxes.get(tuple(one for one in classes_of(name) if one in sealed))
            for name in names
            if name in self.fields
        }
        if True in found:
            return "destroyed"
        return "sealed" if False in found else ""

    def words(self) -> str:
        """Return what is closed, for people; empty when nothing is."""
        told = (("sealed", self.sealed), ("destroyed", self.destroyed))
        return " ".join(f"[{word}: {', '.join(names)}]" for word, names in told if names)

    def plain(self) -> dict[str, list[str]]:
        """Return what is closed, as data."""
        return {"sealed": list(self.sealed), "destroyed": list(self.destroyed)}


def closed_of(
    record: Record,
    names: Container[str],
    *,
    has: AbstractSet[str] = frozenset(),
    lost: AbstractSet[str] = frozenset(),
) -> Closed:
    """Return what of a record is closed.

    Args:
        record: as it was opened, as far as that went.
        names: of what lies beside it then.
        has: the classes that the reader has keys of; what is closed is so for lack of another.
        lost: the classes of its mission whose keys are destroyed, as far as that is known.
    """
    boxes = {tuple(name.removeprefix(BOX).split("+")): gone for name, gone in _boxes(record, names)}
    wraps = [n for n in record.committed if n.startswith(WRAP) and n not in names]
    lacked = {one for classes, gone in boxes.items() if not gone for one in classes}
    gone = {one for classes, gone in boxes.items() if gone for one in classes}
    gone = (gone & lost or gone).union(name.removeprefix(WRAP) for name in wraps)
    return Closed(
        sealed=tuple(sorted(lacked - has or lacked)),
        destroyed=tuple(sorted(gone)),
        boxes=boxes,
        fields=tuple(name for name in record.committed if name not in names),
    )


def _boxes(record: Record, names: Container[str]) -> Iterator[tuple[str, bool]]:
    """Yield each box that did not open, and whether it was destroyed."""
    for name in record.committed:
        if name.startswith(BOX):
            yield name, name not in names
