# SPDX-License-Identifier: Apache-2.0
"""A released action while the robot moves: looked at, stopped when it must be, settled at its end.

Nothing waits in here. The caller asks again: the library after each pause, the gate's process on
each new state, each answer of the controller and at least every 100 ms. Source: section "Stateful
Action Verification". Spec page: docs/spec/lease.md#while-the-robot-moves
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Protocol, TypeVar, runtime_checkable

import msgspec
from msgspec import Struct

from authguard_r.core.action import Action
from authguard_r.core.errors import AuthGuardError, StoreError
from authguard_r.core.facts import SiteFacts
from authguard_r.core.finding import Finding, Findings, fault_finding
from authguard_r.core.lease import Lease, still
from authguard_r.core.lifecycle import Event
from authguard_r.core.mission import Mission
from authguard_r.core.ports import Controller, GoalHandle
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Outcome, Spend, Standing, advance, finish, settle
from authguard_r.enforcement.inputs import InputVerifier
from authguard_r.enforcement.report import Judged, Report, outcome_entry
from authguard_r.safety.stored_memory import settle_memory
from authguard_r.store.transactions import Ledger, Transaction
from authguard_r.wire.gate_limits import LIMITS

T = TypeVar("T")
#: Holds something beside a decision or an outcome, in the same turn; given its record's number.
CommitHook = Callable[[Transaction, Report, int], None]


def no_commit_hook(act: Transaction, report: Report, seq: int) -> None:
    """Hold nothing beside the record."""


@runtime_checkable
class Explained(Protocol):
    """A flight whose controller says why it did not go as it should."""

    def why(self) -> str:
        """Return a reason's code, empty when there is none."""
        ...


@runtime_checkable
class Guarded(Protocol):
    """A controller that begins nothing while no stop would be carried out."""

    def require_stop(self) -> None:
        """Require that a stop would be carried out.

        Raises:
            EnvironmentFault: no loop would watch the lease.
        """
        ...


class LeaseMonitor:
    """What looks at leases and writes down how they ended.

    Args:
        ledger: store and trusted time.
        inputs: the newest attested state.
        facts: the signed site and the gate's identity.
        controller: stops the robot.
        stand_within_ms: how long a stopped robot may take to stand.
    """

    def __init__(
        self,
        ledger: Ledger,
        inputs: InputVerifier,
        *,
        facts: SiteFacts,
        controller: Controller,
        stand_within_ms: int = LIMITS.stand_within_ms,
    ) -> None:
        self._ledger = ledger
        self._inputs = inputs
        self._facts = facts
        self.controller = controller
        self.stand_within_ms = stand_within_ms
        self._owed: list[Callable[[Transaction], int]] = []

    def mono_ms(self) -> int:
        """Return the monotonic clock that leases are measured on."""
        return self._ledger.mono_ms()

    def ready(self, *, irreversible: bool) -> bool:
        """Return True once a stop would be heard, and what cannot be undone could be counted.

        Raises:
            EnvironmentFault: it would not or could not, and nothing was consumed.
        """
        if isinstance(self.controller, Guarded):
            self.controller.require_stop()
        self._inputs.anchor.ready(irreversible=irreversible)
        return True

    def last_look(self, lease: Lease, *, irreversible: bool) -> Findings:
        """Look once more, after what was committed is counted outside if it cannot be undone."""
        return self._inputs.anchor.covered(irreversible=irreversible) or self.look(lease)

    def look(self, lease: Lease) -> Findings:
        """Check the lease's conditions on new state; a check that fails is a reason to stop."""
        try:
            self._inputs.refresh()
            state, now = self._inputs.newest, self._ledger.now()
            standing = self._ledger.standing(lease.mid)
            found = still(lease, state, facts=self._facts, now=now, standing=standing)
            if not found and self._inputs.kept(lease.digest) is None:
                # its signer has to be verified anew: a revocation list came
                self._ledger.run(lambda act: self._inputs.mission(act, lease.digest))
        except AuthGuardError as error:
            return (fault_finding(error),)
        return found

    def settle(
        self,
        report: Report,
        outcome: Outcome,
        *,
        findings: Findings = (),
        used: Spend = Spend(),  # noqa: B008 - frozen
        on_commit: CommitHook = no_commit_hook,
        stood_ms: int | None = None,
    ) -> Report:
        """Record the outcome and what it used; complete the mission when that was the last."""
        judged = require_judged(report)
        mission = judged.verified.mission
        ended = msgspec.structs.replace(report, outcome=outcome, reasons=findings)

        def job(act: Transaction) -> int:
            standing = act.standing(mission.mid)
            if standing is None:
                raise StoreError("the registry's entry is gone", reason=Reason.STORE_CORRUPT)
            after = settle(standing, mission, ticket=judged.ticket, outcome=outcome, used=used)
            if outcome is Outcome.UNKNOWN:  # as after a crash: a person says how it went
                after = advance(after, Event.SUSPEND) or after
            current = self._current(act, after, judged)
            act.hold(after if current is None else finish(after, current, act.now))
            settle_memory(act, standing, mission, ticket=judged.ticket, outcome=outcome)
            entry = outcome_entry(
                judged, outcome, findings, used=used, now=act.now, stood_ms=stood_ms
            )
            seq = act.record(entry)
            on_commit(act, ended, seq)
            return seq

        recorded = quietly(lambda: self._ledger.run(job, essential=True)) is not None
        if not recorded:
            self._ledger.raise_fence()  # it ended all the same

            def later(act: Transaction) -> int:
                standing = act.standing(mission.mid)
                known = () if standing is None else standing.open  # a person may have said it
                is_open = any(release.ticket == judged.ticket for release in known)
                return job(act) if is_open else -1

            self._owed.append(later)
        return msgspec.structs.replace(ended, outcome_recorded=recorded)

    def settle_owed(self) -> bool:
        """Write outcomes that could not be written when they were known; True when one was."""
        owed, self._owed = self._owed, []
        for job in owed:
            if quietly(partial(self._ledger.run, job, essential=True)) is None:
                self._owed.append(job)
        return len(self._owed) < len(owed)

    def _current(self, act: Transaction, standing: Standing, judged: Judged) -> Mission | None:
        """Return what says whether all is done: the version in force, not the one released under.

        None when it is unknown: its certificates are not valid any more, and it stays as it is.
        """
        if standing.digest == judged.verified.digest:
            return judged.verified.mission
        return quietly(lambda: self._inputs.mission(act, standing.digest).mission)


class ExecutionResult(Struct, frozen=True, kw_only=True):
    """How an action ended, as far as it is known.

    Args:
        outcome: the controller's word, or `unknown` without one.
        findings: why it was stopped, or why it did not go as it should.
        stood_ms: from the order to stop to that message; None when no stop was needed.
    """

    outcome: Outcome
    findings: Findings
    stood_ms: int | None


class ExecutionMonitor:
    """A dispatched action until its end: checked, stopped once, given up in the end.

    Args:
        watch: the clock, the controller, and how long a stopped robot may take to stand.
        handle: what the controller says of it.
        look: returns what speaks against going on.
    """

    def __init__(
        self, watch: LeaseMonitor, handle: GoalHandle, look: Callable[[], Findings]
    ) -> None:
        self._watch = watch
        self._handle = handle
        self._look = look
        self._findings: Findings = ()
        self._told_ms: int | None = None
        self._why = handle.why if isinstance(handle, Explained) else str

    @property
    def holds(self) -> bool:
        """True while nothing was found against it."""
        return self._told_ms is None

    def poll(self) -> ExecutionResult | None:
        """Look once; return how it ended, None while it goes on."""
        found = (*self._look(), *self._doubts()) if self._told_ms is None else ()
        ended = self._handle.outcome()
        if ended is not None:
            return self._ended(ended)
        if found:
            self._findings, self._told_ms = found, self._watch.mono_ms()
            self._watch.controller.stop()
            ended = self._handle.outcome()
            return None if ended is None else self._ended(ended)
        told = self._told_ms
        late = told is not None and self._watch.mono_ms() - told > self._watch.stand_within_ms
        return self._lost() if late else None

    def _doubts(self) -> Findings:
        why = self._why()
        return (_said(why),) if why else ()

    def _ended(self, outcome: Outcome) -> ExecutionResult:
        return self._finished(outcome, self._findings or self._doubts())

    def _lost(self) -> ExecutionResult:
        """Report an unknown outcome: the robot did not confirm that it stands."""
        silent = Finding(
            "controller", Reason.CONTROLLER_FAILED, "a robot that stands", "no answer to a stop"
        )
        return self._finished(Outcome.UNKNOWN, (*self._findings, silent))

    def _finished(self, outcome: Outcome, findings: Findings) -> ExecutionResult:
        told = self._told_ms
        stood = None if told is None else self._watch.mono_ms() - told
        return ExecutionResult(outcome=outcome, findings=findings, stood_ms=stood)


class Running:
    """One released action until its outcome is recorded.

    Args:
        watch: looks, stops, settles.
        report: of the decision.
        lease: what the release permits.
        handle: what the controller says of it.
        on_commit: holds something beside the outcome.
    """

    def __init__(
        self,
        watch: LeaseMonitor,
        report: Report,
        *,
        lease: Lease,
        handle: GoalHandle,
        on_commit: CommitHook,
    ) -> None:
        self._watch = watch
        self._report = report
        self.lease = lease
        self._handle = handle
        self._on_commit = on_commit
        self._course = ExecutionMonitor(watch, handle, lambda: watch.look(lease))
        self._before: Callable[[], object] = lambda: None
        self.since_ms = watch.mono_ms()

    @property
    def report(self) -> Report:
        """The report of the decision; it has no outcome yet."""
        return self._report

    @property
    def action(self) -> Action:
        """What was released."""
        return require_judged(self._report).action

    @property
    def holds(self) -> bool:
        """True while nothing was found against it."""
        return self._course.holds

    def before_outcome(self, act: Callable[[], object]) -> None:
        """Do this once, right before the outcome is recorded: a stream's last record."""
        self._before = act

    def poll(self) -> Report | None:
        """Look once; return the final report when the action has ended and None while it runs."""
        landed = self._course.poll()
        if landed is None:
            return None
        self._before()
        return self._watch.settle(
            self._report,
            landed.outcome,
            findings=landed.findings,
            used=self._handle.used(),
            on_commit=self._on_commit,
            stood_ms=landed.stood_ms,
        )


def _said(why: str) -> Finding:
    """Return what the controller said as a finding; its word is a code of ours or is shown."""
    known = why in Reason.__members__
    reason = Reason(why) if known else Reason.CONTROLLER_FAILED
    return Finding("controller", reason, "an action that runs to its end", why)


def require_judged(report: Report) -> Judged:
    """Return the judged proposal of a report that has one; the caller released it."""
    if report.judged is None:  # pragma: no cover - only a judged proposal is released
        raise RuntimeError("an action was released without a decision")
    return report.judged


def quietly(write: Callable[[], T]) -> T | None:
    """Return None when the world does not let us write: what is recorded stands all the same."""
    try:
        return write()
    except AuthGuardError:
        return None
