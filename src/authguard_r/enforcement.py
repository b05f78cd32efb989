# SPDX-License-Identifier: Apache-2.0
"""The one road to the controller: normalize, decide, safety, commit, release, watch, outcome.

Nothing else calls `decide` for effect or holds a controller. Nothing is dispatched before its
decision is on disk, except `stop`. Whatever goes wrong on the way is a refusal with a reason, a
place and one record. Source: `alg:authguard`, `eq:execute`. Spec page: docs/spec/enforcement.md
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import msgspec

from authguard_r.core.action import Action, ActionMeta
from authguard_r.core.checks.grant import spend_of
from authguard_r.core.decide import decide
from authguard_r.core.decision import Verdict
from authguard_r.core.encoding import Tag, digest_of
from authguard_r.core.errors import AuthGuardError, ControllerError, StoreError
from authguard_r.core.facts import SiteFacts
from authguard_r.core.finding import Findings
from authguard_r.core.identifiers import Digest, Identifier
from authguard_r.core.lease import Lease, permit, still
from authguard_r.core.lifecycle import Event
from authguard_r.core.ports import Clock, Controller, Flight, SafetyGate
from authguard_r.core.provenance import Label
from authguard_r.core.quantities import Now, to_timestamp
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import (
    Outcome,
    Spend,
    Standing,
    advance,
    ask,
    close_request,
    count_planner_stop,
    finish,
    reserve,
    settle,
)
from authguard_r.core.state import AttestedState
from authguard_r.core.token import VerifiedMission
from authguard_r.intake import Intake
from authguard_r.ledger import Act, Ledger
from authguard_r.normalize import Step
from authguard_r.normalize.context import ContextLedger, Influence
from authguard_r.normalize.labels import label_fields
from authguard_r.report import (
    Judged,
    Refusal,
    Report,
    alert_entry,
    decision_entry,
    fault_finding,
    open_question,
    outcome_entry,
    refusal_entry,
    stop_entry,
    suspension_entry,
)

T = TypeVar("T")
#: The lease is looked at this often, in milliseconds; never more seldom than every 100.
WATCH_MS = 100


class Enforcer:
    """The policy enforcement point of one robot.

    Args:
        ledger: store and trusted time.
        intake: what may enter: state, missions, approvals, each verified.
        facts: the signed site and the gate's own identity.
        safety: the second gate.
        controller: the actuators; nobody else has them.
        clock: for the pauses between two looks at a lease.
    """

    def __init__(
        self,
        ledger: Ledger,
        intake: Intake,
        *,
        facts: SiteFacts,
        safety: SafetyGate,
        controller: Controller,
        clock: Clock,
    ) -> None:
        self._ledger = ledger
        self.intake = intake
        self._facts = facts
        self._safety = safety
        self._controller = controller
        self._clock = clock
        self._first: Callable[[], object] = lambda: None

    def before_first(self, act: Callable[[], object]) -> None:
        """Do this before the first proposal is decided: recovery, when a gate starts."""
        self._first = act

    def propose(
        self, step: Step, *, planner: Identifier, evidence: Digest, context: ContextLedger
    ) -> Report:
        """Decide one step and, if both gates accept, carry it out to its outcome.

        Args:
            step: one bound step of a plan; anybody may have written it.
            planner: the client that proposed, named by the caller's channel.
            evidence: digest of the planner's bytes.
            context: what the planner could have seen.
        """
        base, influences = context.base(), context.influences(step.action)

        def job(act: Act) -> tuple[Judged, int]:
            judged = self._judge(act, step, planner=planner, evidence=evidence, base=base)
            self._commit(act, judged)
            return judged, act.record(decision_entry(judged, influences))

        try:
            self._first()
            self._first = lambda: None
            self.intake.refresh()
            judged, seq = self._ledger.run(job)
        except AuthGuardError as error:
            return self._refused(error, influences)
        except Exception as error:  # noqa: BLE001 - a fault of ours refuses too
            return self._refused(
                AuthGuardError(type(error).__name__, reason=Reason.INTERNAL_FAULT), influences
            )
        report = Report(judged=judged, influences=influences, seq=seq)
        return self._carry_out(judged, report) if judged.released else report

    def stop(self, *, by: Identifier, is_planner: bool, suspends: bool = False) -> None:
        """Brake and hold, for anyone, at once; recorded afterwards.

        Args:
            by: who asked, named by the caller's channel.
            is_planner: counted against the planner's budget of stops.
            suspends: an operator's stop: the mission goes on only after a signed `resume`.
        """
        self._controller.stop()
        entry = stop_entry(by, is_planner=is_planner)
        self._quietly(lambda: self._ledger.note(entry))
        if is_planner:
            self._quietly(lambda: self._ledger.run(self._count_stop))
        if suspends:
            self._quietly(lambda: self._ledger.run(self._suspend))

    @staticmethod
    def _suspend(act: Act) -> None:
        mid = act.active()
        standing = act.standing(mid) if mid is not None else None
        suspended = advance(standing, Event.SUSPEND) if standing is not None else None
        if suspended is not None:
            act.hold(suspended)
            act.record(suspension_entry(suspended.mid, act.now))

    def _count_stop(self, act: Act) -> None:
        """Count a stop that the planner asked for; past its budget, alert the operator."""
        mid = act.active()
        standing = act.standing(mid) if mid is not None else None
        if standing is None:
            return
        counted = count_planner_stop(standing)
        act.hold(counted)
        verified = self.intake.mission(act, standing.digest)
        if counted.planner_stops > verified.mission.budgets.planner_stops:
            act.record(alert_entry("planner stops", standing.mid, act.now))

    def _judge(
        self, act: Act, step: Step, *, planner: Identifier, evidence: Digest, base: Label
    ) -> Judged:
        """(1) to (7) in the writer's turn, then the second gate; nothing is changed yet."""
        verified = self.intake.active_mission(act)
        standing = act.standing(verified.mission.mid)
        state = self.intake.state
        now = act.now
        meta = ActionMeta(
            planner=planner,
            timestamp=to_timestamp(now.utc_ms),
            evidence=evidence,
            mission=verified.mission.mid,
            mission_version=verified.mission.version,
        )
        action = _complete(step, meta, verified, standing, state=state, base=base)
        answered = self.intake.answers(act, standing)
        decision = decide(
            verified,
            action,
            state=state,
            facts=self._facts,
            now=now,
            standing=standing,
            approvals=answered.approvals,
        )
        safety = None
        if decision.verdict is Verdict.ACCEPT:
            safety = self._safety.assess(action, state, self._facts, now)
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
            ticket=digest_of(Tag.ACTION, (digested, act.head()[0])),
            request=open_question(decision, verified, standing, now),
            approvals=answered.tokens,
        )

    def _commit(self, act: Act, judged: Judged) -> None:
        """(8) Use what a release uses, or open the question that it needs."""
        standing, match = judged.standing, judged.decision.match
        if standing is None or match is None:
            return
        grant = match.indexed.grant
        if judged.released:
            kind = self._facts.vocabulary[judged.action.type]
            standing = reserve(
                standing,
                grant,
                ticket=judged.ticket,
                spend=spend_of(kind, grant, judged.action.params),
                now=judged.now,
                per_ms=judged.verified.mission.budgets.rate.per_ms,
            )
        elif judged.request is not None:
            standing = ask(standing, grant.id, judged.request)
        elif {Reason.APPROVAL_DENIED, Reason.APPROVAL_TIMEOUT} & set(judged.decision.reasons):
            standing = close_request(standing, grant.id)
        elif judged.now.utc_ms > judged.verified.expiry_ms:
            standing = advance(standing, Event.EXPIRE) or standing
        if standing is not judged.standing:
            act.hold(standing)

    def _carry_out(self, judged: Judged, report: Report) -> Report:
        """Dispatch what was committed, hold the lease, record the outcome."""
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
        findings = self._look(lease)
        if findings:
            return self._settle(judged, report, Outcome.NOT_STARTED, findings, Spend())
        try:
            flight = self._controller.dispatch(judged.action, lease)
        except ControllerError as error:
            findings = (fault_finding(error),)
            return self._settle(judged, report, Outcome.NOT_STARTED, findings, Spend())
        outcome, findings = self._watch(lease, flight)
        return self._settle(judged, report, outcome, findings, flight.used())

    def _watch(self, lease: Lease, flight: Flight) -> tuple[Outcome, Findings]:
        """Hold the lease until the action ends or may not go on."""
        while True:
            ended = flight.outcome()
            if ended is not None:
                return ended, ()
            self._clock.pause(WATCH_MS)
            findings = self._look(lease)
            if findings and flight.outcome() is None:
                self._controller.stop()
                return Outcome.ABORTED, findings

    def _look(self, lease: Lease) -> Findings:
        """Ask the lease's conditions on new state; not being able to ask is a reason to stop."""
        try:
            state, now = self.intake.refresh(), self._ledger.now()
            standing = self._ledger.standing(lease.mid)
            return still(lease, state, facts=self._facts, now=now, standing=standing)
        except AuthGuardError as error:
            return (fault_finding(error),)

    def _settle(
        self, judged: Judged, report: Report, outcome: Outcome, findings: Findings, used: Spend
    ) -> Report:
        """Record the outcome and what it used; complete the mission when that was the last."""
        mission = judged.verified.mission

        def job(act: Act) -> int:
            standing = act.standing(mission.mid)
            if standing is None:
                raise StoreError("the registry's entry is gone", reason=Reason.STORE_CORRUPT)
            after = settle(standing, mission, ticket=judged.ticket, outcome=outcome, used=used)
            act.hold(finish(after, mission, act.now))
            return act.record(outcome_entry(judged, outcome, findings, used, act.now))

        recorded = self._quietly(lambda: self._ledger.run(job)) is not None
        return msgspec.structs.replace(
            report, outcome=outcome, reasons=findings, outcome_recorded=recorded
        )

    def _refused(self, error: AuthGuardError, influences: tuple[Influence, ...]) -> Report:
        """Turn an exception into a refusal with a record, if anything can still be recorded."""
        seq = self._quietly(lambda: self._ledger.note(lambda at: refusal_entry(error, at)))
        refusal = Refusal(error.reason, error.where, error.message)
        return Report(judged=None, refusal=refusal, influences=influences, seq=seq)

    def refuse_plan(self, error: AuthGuardError) -> Report:
        """Record that a whole plan could not be read; nothing of it was decided."""
        return self._refused(error, ())

    @staticmethod
    def _quietly(write: Callable[[], T]) -> T | None:
        """Return None when the world does not let us write: the refusal itself stands."""
        try:
            return write()
        except AuthGuardError:
            return None


def _complete(
    step: Step,
    meta: ActionMeta,
    verified: VerifiedMission,
    standing: Standing | None,
    *,
    state: AttestedState | None,
    base: Label,
) -> Action:
    """Fill what attested state settles, label every privileged field, and say whose it is."""
    action = step.action
    if "source" in step.attested and state is not None and len(state.place) == 1:
        action = msgspec.structs.replace(action, source=next(iter(state.place)))
    labels = label_fields(action, verified, standing, base=base)
    if "source" in step.attested and action.source is not None:
        labels["source"] = Label.TRUSTED_SENSOR
    return msgspec.structs.replace(action, provenance=labels, meta=meta)


def evaluate(
    verified: VerifiedMission,
    action: Action,
    *,
    state: AttestedState | None,
    facts: SiteFacts,
    now: Now,
    standing: Standing | None,
    safety: SafetyGate | None = None,
    base: Label = Label.MODEL,
) -> Judged:
    """Return what both gates would say, without consuming, recording or releasing: a what-if.

    Args:
        verified: the mission.
        action: the proposal; its labels and meta are set here, never taken over.
        state: what would be attested.
        facts: the signed site and the gate's identity.
        now: the instant to ask about.
        standing: the registry's entry to ask about.
        safety: the second gate; asked also when the first refuses, to show the two apart.
        base: the least trusted label of anything the planner could have seen.
    """
    labels = label_fields(action, verified, standing, base=base)
    action = msgspec.structs.replace(action, provenance=labels, meta=None)
    decision = decide(
        verified, action, state=state, facts=facts, now=now, standing=standing, approvals=()
    )
    digested = digest_of(Tag.ACTION, action)
    return Judged(
        action=action,
        action_digest=digested,
        decision=decision,
        safety=None if safety is None else safety.assess(action, state, facts, now),
        verified=verified,
        standing=standing,
        state=state,
        now=now,
        ticket=digested,
    )
