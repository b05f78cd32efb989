# SPDX-License-Identifier: Apache-2.0
"""The repairs of a replayed log: does each one name the decision that it repairs?

Spec page: docs/spec/enforcement.md#repair
"""

from __future__ import annotations

from collections import OrderedDict

from authguard_r.audit.record import NONE, Record
from authguard_r.core.decision import Verdict
from authguard_r.server.explanation import is_unsafe

#: A gate writes a repair right behind what it repairs, so a few are plenty.
_MOST_KEPT = 1_024
#: Stands for the number of a decision that had no record yet.
_UNNUMBERED = -1


class Repairs:
    """The decisions that may be repaired, noted record by record."""

    def __init__(self) -> None:
        #: Digest of the action of each decision that only the safety gate refused, by number.
        self._refused: OrderedDict[int, str] = OrderedDict()
        #: Number of the first record of this log, or of this part of one.
        self._first: int | None = None

    def note(self, record: Record) -> str:
        """Note the next record; return what is wrong with a repair's link, empty when nothing is.

        Args:
            record: of any kind; an attacker may have written it.

        Returns:
            Empty also when the named record comes before this part of a log: it is not here.
        """
        seq = record.link.seq
        self._first = seq if self._first is None else self._first
        if record.kind != "decision":
            return ""
        wrong = self._wrong(record) if {"repairs", "repairs_action"} & record.open.keys() else ""
        if record.link.decision == Verdict.ACCEPT and is_unsafe(record):
            self._refused[seq] = record.link.action
            while len(self._refused) > _MOST_KEPT:
                self._refused.popitem(last=False)
        return wrong

    def _wrong(self, record: Record) -> str:
        named, action = record.open.get("repairs"), record.open.get("repairs_action")
        if type(named) is not int or not _UNNUMBERED <= named < record.link.seq:
            return f"`repairs` is {named!r}: expected the number of an earlier decision, or -1"
        if named == _UNNUMBERED:
            is_free = record.open.get("ticket") == NONE
            return "" if is_free else "it was released, and `repairs` names no record"
        if self._first is None or named < self._first:
            return ""
        if named not in self._refused:
            return f"`repairs` names record {named}, which is no decision that only safety refused"
        if self._refused[named] != action:
            return f"`repairs_action` is not the action of record {named}, which `repairs` names"
        return ""
