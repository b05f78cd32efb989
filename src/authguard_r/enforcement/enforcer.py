# SPDX-License-Identifier: Apache-2.0
"""The one path to the controller: normalize, decide, safety, commit, release, watch, outcome.

Nothing else calls `decide` for effect or holds a controller. Nothing is dispatched before its
decision is on disk, except `stop`. Any fault on the way is a refusal with a reason, a place and one
record. Source: `alg:authguard`, `eq:execute`. Spec page: docs/spec/enforcement.md
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import msgspec

from authguard_r.audit.deviation import weights_of
from authguard_r.core.checks.grant import spend_of
from authguard_r.core.decide import decide
from authguard_r.core.decision import Verdict
from authguard_r.core.encoding import Tag, digest_of
from authguard_r.core.errors import AuthGuardError, ControllerError, RefusedError
from authguard_r.core.facts import SiteFacts
from authguard_r.core.finding import fault_finding
from authguard_r.core.identifiers import Digest, Identifier
from authguard_r.core.lease import permit
from authguard_r.core.lifecycle import Event
from authguard_r.core.ports import Clock, SafetyGate
from authguard_r.core.provenance import Label
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Outcome, advance, ask, close_request, reserve
from authguard_r.enforcement.completion import (
    cause_of,
    complete,
    meta_of,
    record_decision,
    record_of_decision,
    repaired_report,
)
from authguard_r.enforcement.inputs import InputVerifier
from authguard_r.enforcement.leases import (
    CommitHook,
    LeaseMonitor,
    Running,
    no_commit_hook,
    quietly,
    require_judged,
)
from authguard_r.enforcement.report import Judged, Refusal, Report, open_question, refused_proposal
from authguard_r.enforcement.stopping import RecordedStops
from authguard_r.normalize import Step
from authguard_r.provenance.context import ContextLedger, Influence
from authguard_r.safety.stored_memory import memory_of, remember
from authguard_r.store.transactions import Ledger, Transaction
from authguard_r.wire.gate_limits import LIMITS


class Enforcer:
    """The policy enforcement point of one robot.

    Args:
        ledger: store and trusted time.
        inputs: what may enter: state, missions, approvals, each verified.
        facts: the signed site and the gate's own identity.
        safety: the second gate.
        watch: alone holds the actuators, and checks open leases.
        clock: for the pauses between two looks at a lease.
        first: what must succeed before the first proposal is decided: recovery, when a gate starts.
    """

    def __init__(
        self,
        ledger: Ledger,
        inputs: InputVerifier,
        *,
        facts: SiteFacts,
        safety: SafetyGate,
        watch: LeaseMonitor,
        clock: Clock,
        first: Callable[[], object] | None = None,
    ) -> None:
        self._ledger = ledger
        self.inputs = inputs
        self._facts = facts
        self._safety = safety
        self._watch = watch
        self.stopping = RecordedStops(ledger, inputs)
        self._clock = clock
        self._conditions = [] if first is None else [first]

    def require(self, condition: Callable[[], object], *, first: bool = False) -> None:
        """Refuse every proposal until this condition has passed once.

        Args:
            condition: raises `AuthGuardError` while proposals must be refused.
            first: check it before the others, so that its reason is the one that is given.
        """
        if condition not in self._conditions:
            self._conditions.insert(0 if first else len(self._conditions), condition)

    def propose(
        self,
        step: Step,
        *,
        planner: Identifier,
        evidence: Digest,
        context: ContextLedger,
        repair: bool = False,
    ) -> Report:
        """Decide one step and, if both gates accept, carry it out to its outcome.

        Args: as in `submit`.
        """
        begun = self.submit(
            step, planner=planner, evidence=evidence, context=context, repair=repair
        )
        if isinstance(begun, Report):
            return begun
        while True:
            report = begun.poll()
            if report is not None:
                return report
            self._clock.pause(LIMITS.watch_ms)

    def submit(
        self,
        step: Step,
        *,
        planner: Identifier,
        evidence: Digest,
        context: ContextLedger,
        on_commit: CommitHook = no_commit_hook,
        inputs: Mapping[str, Any] | None = None,
        repair: bool = False,
    ) -> Report | Running:
        """Decide one step and, if both gates accept, begin it; the caller watches it.

        The numbers in the code are those of docs/spec/enforcement.md#the-road. Steps 9 and 10 are
        `Running.poll`.

        Args:
            step: one bound step of a plan; untrusted.
            planner: the client that proposed, named by the caller's channel.
            evidence: digest of the planner's bytes.
            context: what the planner could have seen.
            on_commit: holds something beside what the decision and the outcome change.
            inputs: what to seal beside a refusal that has no decision.
            repair: when the safety gate alone refuses the step and offers a repair, decide the
                repair too, once, in the same transaction. Its report names the refused one in
                `repairs`.

        Returns:
            The final report, or the action while it runs: the caller has to `poll` it then.
        """
        base, influences = context.base(), context.influences(step.action)

        def job(act: Transaction) -> Report:
            judge = partial(self._judge, act, planner=planner, evidence=evidence, base=base)
            report = Report(judged=judge(step), influences=influences, around=step.around)  # 2-4
            report = repaired_report(report, step, judge, context) if repair else report
            return self._record(act, report, planner, on_commit)  # 5

        try:
            self._require_suspended()  # 0: an operator's stop is on disk, owed outcomes too,
            self._watch.settle_owed()
            self._require_conditions()  # and what the start and emergencies ask for holds
            self.inputs.refresh()  # 1: the newest state
            report = self._ledger.run(job)  # 2 to 6: one transaction, committed
        except AuthGuardError as error:
            return self._refused(error, planner, influences, inputs)
        except Exception as error:  # noqa: BLE001 - a fault of ours refuses too
            fault = AuthGuardError(type(error).__name__, reason=Reason.INTERNAL_FAULT)
            return self._refused(fault, planner, influences)
        if not require_judged(report).released:
            return report
        return self._begin(report, on_commit)  # 7 and 8: the lease on new state, then dispatch

    def settle_stops(self) -> bool:
        """Write what an operator's stop has to change, if it is not on disk; True once it is."""
        self.stopping.settle()
        return not self.stopping.owes

    def _require_conditions(self) -> None:
        """Check each condition until it has passed once.

        Raises:
            AuthGuardError: one does not pass; it and those after it are checked again next time.
        """
        while self._conditions:
            self._conditions[0]()
            del self._conditions[0]

    def _require_suspended(self) -> None:
        """Refuse everything while an operator's stop has not taken its effect on disk.

        Raises:
            RefusedError: the suspension could not be written yet (`STOPPED`).
        """
        if not self.settle_stops():
            why = "an operator stopped the robot, and that could not be recorded yet"
            raise RefusedError(why, reason=Reason.STOPPED, where="stop")

    def stop(self, *, by: Identifier, is_planner: bool, suspends: bool = False) -> None:
        """Brake and hold, for anyone, at once; recorded afterwards.

        Args:
            by: who asked, named by the caller's channel.
            is_planner: counted against the planner's budget of stops.
            suspends: an operator's stop: the mission goes on only after a signed `resume`.
        """
        self._watch.controller.stop()
        self.stopped(by=by, is_planner=is_planner, suspends=suspends)

    def stopped(
        self,
        *,
        by: Identifier,
        is_planner: bool,
        suspends: bool = False,
        details: Mapping[str, Any] | None = None,
        why: str = "",
    ) -> bool:
        """Record a stop that was carried out already; True when it raised an alert.

        Args:
            by: see `stop`.
            is_planner: see `stop`.
            suspends: see `stop`.
            details: what else lies open in the record.
            why: the words of the person who stopped; sealed.
        """
        return self.stopping.record(
            by=by, is_planner=is_planner, suspends=suspends, details=details or {}, why=why
        )

    def _judge(
        self, act: Transaction, step: Step, *, planner: Identifier, evidence: Digest, base: Label
    ) -> Judged:
        """Steps 2 to 4, in the transaction: fill in the action, decide it, ask the safety gate."""
        verified = self.inputs.active_mission(act)
        standing = act.standing(verified.mission.mid)
        state = self.inputs.state
        now = act.now
        meta = meta_of(verified, planner=planner, evidence=evidence, now=now)
        action = complete(step, meta, verified, standing, state=state, base=base)  # 2
        answered = self.inputs.answers(act, standing)
        decision = decide(  # 3
            verified,
            action,
            state=state,
            facts=self._facts,
            now=now,
            standing=standing,
            approvals=answered.approvals,
            preapprovals=answered.preapprovals,
        )
        safety = None
        if decision.verdict is Verdict.ACCEPT:  # 4
            recalled = self._safety.recall(memory_of(act, standing))
            safety = recalled.assess(action, state, self._facts, now)
        digested = digest_of(Tag.ACTION, action)
        return Judged(
            action=action,
            action_digest=digested,
            decision=decision,
            safety=safety,
            verified=verified,
            standing=standing,
            state=state,
            now=now,
            ticket=digest_of(Tag.ACTION, (digested, act.head()[0], act.salt())),
            request=open_question(decision, verified, standing, now, risk=self._facts.risk),
            approvals=answered.used_by(decision),
            answers=answered.approvals,
            weights=weights_of(verified.mission.risk_policy, self._facts.risk),
        )

    def _commit(self, act: Transaction, judged: Judged) -> bool:
        """Step 5: reserve a release, or open the request that it needs; False: nothing changed."""
        standing, match = judged.standing, judged.decision.match
        if standing is None or match is None:
            return False
        grant = match.indexed.grant
        if judged.released and self._watch.ready(irreversible=grant.irreversible):
            kind = self._facts.vocabulary[judged.action.type]
            remember(act, standing, judged.safety, ticket=judged.ticket)
            standing = reserve(
                standing,
                grant,
                ticket=judged.ticket,
                spend=spend_of(kind, grant, judged.action.params),
                now=judged.now,
                per_ms=judged.verified.mission.budgets.rate.per_ms,
                preapproved=judged.decision.preapproved,
            )
        elif judged.request is not None:
            standing = ask(standing, grant.id, judged.request)
        elif {Reason.APPROVAL_DENIED, Reason.APPROVAL_TIMEOUT} & set(judged.decision.reasons):
            standing = close_request(standing, grant.id)
        if not judged.released and judged.now.utc_ms > judged.verified.expiry_ms:
            standing = advance(standing, Event.EXPIRE) or standing
        if standing is judged.standing:
            return False
        act.hold(standing)
        return True

    def _record(
        self, act: Transaction, report: Report, planner: Identifier, on_commit: CommitHook
    ) -> Report:
        """Step 5: make a decision's changes and append its record, after the one it repairs."""
        judged, refused = require_judged(report), report.repairs
        changes = self._commit(act, judged)
        if refused is not None:  # it is recorded at once when its repair changes something
            report = msgspec.structs.replace(report, repairs=self._refuse(act, refused, planner))
        if not changes:
            return self._refuse(act, report, planner)
        number = record_decision(act, judged, record_of_decision(report, self._facts))
        on_commit(act, report, number)
        return msgspec.structs.replace(report, seq=number)

    def _refuse(self, act: Transaction, report: Report, planner: Identifier) -> Report:
        """Record a decision that changes nothing, now or later."""
        dedup_key = (planner, *cause_of(report))
        seq = act.refuse(record_of_decision(report, self._facts), dedup_key=dedup_key)
        return msgspec.structs.replace(report, seq=seq, outcome_recorded=self._kept(seq))

    def _begin(self, report: Report, on_commit: CommitHook) -> Report | Running:
        """Steps 7 and 8: dispatch what was committed, unless its lease does not hold any more."""
        judged = require_judged(report)
        match = judged.decision.match
        if match is None:  # pragma: no cover - an accepted action has a match
            raise RuntimeError("an action was released without a match")
        lease = permit(
            judged.verified,
            judged.action,
            grant=match.indexed.grant,
            row=match.row,
            facts=self._facts,
            now=judged.now,
            ticket=judged.ticket,
        )
        irreversible = match.indexed.grant.irreversible
        findings = self._watch.last_look(lease, irreversible=irreversible)  # 7
        if not findings:
            try:
                handle = self._watch.controller.dispatch(judged.action, lease)  # 8
                return Running(self._watch, report, lease=lease, handle=handle, on_commit=on_commit)
            except ControllerError as error:
                findings = (fault_finding(error),)
        return self._watch.settle(
            report, Outcome.NOT_STARTED, findings=findings, on_commit=on_commit
        )

    def _refused(
        self,
        error: AuthGuardError,
        planner: Identifier,
        influences: tuple[Influence, ...],
        inputs: Mapping[str, Any] | None = None,
    ) -> Report:
        """Turn an exception into a refusal with a record, if anything can still be recorded."""
        made = partial(refused_proposal, error, client=planner, inputs=inputs or {})
        seq = quietly(
            lambda: self._ledger.refuse(made, dedup_key=(planner, error.reason, error.where))
        )
        refusal = Refusal(error.reason, error.where, error.message)
        told = Report(judged=None, refusal=refusal, influences=influences, seq=seq)
        return msgspec.structs.replace(told, outcome_recorded=self._kept(seq))

    def _kept(self, seq: int | None) -> bool:
        """True of a refusal that is in the log or waits to be; else it is counted at most."""
        return seq is not None or self._ledger.refusals.may_write()

    def refuse_plan(
        self, error: AuthGuardError, *, planner: Identifier, inputs: Mapping[str, Any] | None = None
    ) -> Report:
        """Record that a whole plan could not be read; nothing of it was decided.

        Args:
            error: what was wrong with it.
            planner: whose plan it was.
            inputs: what to seal beside it: the plan itself, where a shadow run keeps it.
        """
        return self._refused(error, planner, (), inputs)
