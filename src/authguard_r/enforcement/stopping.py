# SPDX-License-Identifier: Apache-2.0
"""Stops, written down: who asked, what it did to the mission, and when a planner asks too often.

The robot stands before anything here runs. Spec page: docs/spec/enforcement.md#stop
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from functools import partial
from typing import Any

from authguard_r.core.identifiers import Identifier
from authguard_r.core.lifecycle import Event, Status
from authguard_r.core.standing import advance, count_planner_stop
from authguard_r.enforcement.inputs import InputVerifier
from authguard_r.enforcement.leases import quietly
from authguard_r.enforcement.report import alert_entry, stop_entry, suspension_entry
from authguard_r.store.transactions import STOP, Ledger, Transaction

#: A planner's stops beyond its budget are counted like refusals under this reason.
_OVER = "planner stops"


class _BudgetPlace(Enum):
    """Where a planner's stop stands in its mission's budget."""

    WITHIN = 1
    ALERT = 2
    OVER = 3


class RecordedStops:
    """Records stops that were carried out.

    Args:
        ledger: store and trusted time.
        inputs: for the mission's budget.
    """

    def __init__(self, ledger: Ledger, inputs: InputVerifier) -> None:
        self._ledger = ledger
        self._inputs = inputs
        self._owed = False

    def record(
        self,
        *,
        by: Identifier,
        is_planner: bool,
        suspends: bool,
        details: Mapping[str, Any],
        why: str,
    ) -> bool:
        """Record one stop; True when it is the one too many of a planner's.

        A stop that cannot be recorded was carried out all the same.

        A planner's stops beyond its mission's budget are counted, not recorded one by one: they
        may not use up the disk that is kept for others.

        Args:
            by: who asked, named by the caller's channel.
            is_planner: counted against the planner's budget of stops.
            suspends: an operator's stop: it stands, and the mission goes on only after a signed
                `resume`.
            details: what else lies open in the record.
            why: the words of the person who stopped; sealed.
        """
        entry = stop_entry(by, is_planner=is_planner, details=details, why=why)
        counted: _BudgetPlace | None = _BudgetPlace.WITHIN
        if is_planner:
            counted = quietly(lambda: self._ledger.run(self._count_stop))
        if counted is not _BudgetPlace.OVER:
            # that it stands needs no right clock, as its record does not
            at_ms = str(self._ledger.latest().utc_ms).encode("ascii")
            held = (*STOP, at_ms) if suspends else None
            note = partial(self._ledger.note, entry, essential=not is_planner, held=held)
            if quietly(note) is None:
                self._ledger.raise_fence()
        else:
            quietly(lambda: self._ledger.refuse(entry, dedup_key=(by, _OVER, "stop")))
            self._ledger.raise_fence()  # the log may hear of it later, or of its count alone
        self._owed = self._owed or suspends
        self.settle()
        return counted is _BudgetPlace.ALERT

    def hold(self) -> None:
        """Let an operator's stop take its effect now; what is said of it is recorded later."""
        self._owed = True
        self.settle()

    @property
    def owes(self) -> bool:
        """True while a suspension could not be written: nothing may be released meanwhile."""
        return self._owed

    def settle(self) -> None:
        """Suspend what an operator's stop has to suspend, if that is not on disk yet."""
        if self._owed and quietly(lambda: self._ledger.run(self._suspend, essential=True)):
            self._owed = False

    @staticmethod
    def _suspend(act: Transaction) -> bool:
        """Let the stop stand and suspend the active mission, if one is; True: it is done."""
        act.put(*STOP, str(act.now.utc_ms).encode("ascii"))
        mid = act.active()
        standing = act.standing(mid) if mid is not None else None
        if standing is None:
            return True
        # a mission that is closing cannot wait for a `resume`: an operator's stop ends it
        closing = standing.status is Status.CLOSING
        held = advance(standing, Event.COMPLETE if closing else Event.SUSPEND)
        if held is not None:
            act.hold(held)
            act.record(suspension_entry(held, act.now))
        return True

    def _count_stop(self, act: Transaction) -> _BudgetPlace:
        """Count a stop that the planner asked for; the first past its budget raises an alert."""
        mid = act.active()
        standing = act.standing(mid) if mid is not None else None
        if standing is None:
            return _BudgetPlace.WITHIN
        most = self._inputs.held(act, standing.digest).mission.budgets.planner_stops
        if standing.planner_stops > most:
            return _BudgetPlace.OVER
        counted = count_planner_stop(standing)
        act.hold(counted)
        if counted.planner_stops <= most:
            return _BudgetPlace.WITHIN
        act.record(alert_entry("planner stops", standing.mid, act.now))
        return _BudgetPlace.ALERT
