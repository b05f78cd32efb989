# SPDX-License-Identifier: Apache-2.0
"""The emergency path: judge, second gate, write down, dispatch, watch, write down how it ended.

It is narrower than the enforcer's: it carries out only what a safety officer signed as a whole.
Nothing is dispatched before it is on disk, in the log or, where the capability says so, in the
emergency journal. It reads no mission and changes none.
Spec page: docs/spec/emergency.md#the-road
"""

from __future__ import annotations

import msgspec
from msgspec import Struct

from authguard_r.core.action import Action
from authguard_r.core.encoding import Tag, digest_of
from authguard_r.core.errors import AuthGuardError, ControllerError, RefusedError
from authguard_r.core.facts import SiteFacts
from authguard_r.core.finding import Finding, Findings, fault_finding, in_paper_order
from authguard_r.core.identifiers import Digest, Identifier
from authguard_r.core.lease import Lease
from authguard_r.core.ports import GoalHandle, SafetyGate
from authguard_r.core.principals import Verifier
from authguard_r.core.reasons import Reason
from authguard_r.core.safety import SafetyDecision
from authguard_r.core.standing import Outcome
from authguard_r.core.state import AttestedState
from authguard_r.enforcement.emergency.decide import (
    EmergencyDecision,
    EmergencyScene,
    action_of,
    decide_emergency,
    named,
    permit_emergency,
    still_emergency,
)
from authguard_r.enforcement.emergency.opened import OpenedPolicy, require_signer
from authguard_r.enforcement.emergency.policy import Caller, Capability, Missing
from authguard_r.enforcement.emergency_audit import (
    ACCEPT,
    EmergencyAudit,
    EmergencyStep,
    refused_call,
)
from authguard_r.enforcement.inputs import InputVerifier
from authguard_r.enforcement.leases import ExecutionMonitor, LeaseMonitor, quietly
from authguard_r.enforcement.report import behind_of, lacks_state
from authguard_r.store.transactions import Ledger


class JudgedEmergency(Struct, frozen=True, kw_only=True):
    """One call after both gates, before anything was dispatched.

    Args:
        name: the capability that was named.
        caller: what called.
        by: who, named by the channel.
        decision: the policy's answer.
        scene: what it was held against.
        action: what would be carried out; None when there is no such capability.
        safety: the second gate's answer; None when the first refused.
    """

    name: str
    caller: Caller
    by: Identifier
    decision: EmergencyDecision
    scene: EmergencyScene
    action: Action | None = None
    safety: SafetyDecision | None = None

    @property
    def released(self) -> bool:
        """True when both gates let it through, or the capability says that one is enough."""
        capability, safety = self.decision.capability, self.safety
        if not self.decision.accepted or capability is None or safety is None:
            return False
        return safety.safe or capability.past_safety

    @property
    def is_early(self) -> bool:
        """True when the answer rests on state from before the last motion: newer may change it."""
        reasons = {finding.reason for finding in self.decision.findings}
        if reasons:
            return Reason.STATE_BEFORE_MOTION in reasons
        return lacks_state(self.safety) and bool(behind_of(self.scene.state))


class EmergencyReport(Struct, frozen=True, kw_only=True):
    """The result of a call.

    Args:
        call: as it was judged.
        ticket: the release; None when nothing was released.
        outcome: how it ended; None while it runs, or when nothing was released.
        reasons: why it was not recorded, not begun, or aborted.
        recorded: False when neither log nor journal took how it ended.
    """

    call: JudgedEmergency
    ticket: Digest | None = None
    outcome: Outcome | None = None
    reasons: Findings = ()
    recorded: bool = True


class EmergencyEnforcer:
    """One robot's emergency path.

    Args:
        ledger: store and clock; either may be missing.
        inputs: the newest attested state.
        opened: the policy, verified.
        verifier: says whether its signer was revoked since.
        facts: the signed site and the gate's identity.
        safety: the second gate.
        watch: holds the controller.
        log: where it is written down.
    """

    def __init__(
        self,
        ledger: Ledger,
        inputs: InputVerifier,
        *,
        opened: OpenedPolicy,
        verifier: Verifier,
        facts: SiteFacts,
        safety: SafetyGate,
        watch: LeaseMonitor,
        log: EmergencyAudit,
    ) -> None:
        self._ledger = ledger
        self._inputs = inputs
        self.opened = opened
        self._verifier = verifier
        self._facts = facts
        self._safety = safety
        self.watch = watch
        self.log = log
        self._count = 0
        capabilities = opened.policy.capabilities
        inputs.outlasts_clock = any(Missing.CLOCK in c.without for c in capabilities)

    def of_gate(self) -> tuple[Identifier, ...]:
        """Return what the gate itself calls as soon as its guards hold."""
        return tuple(c.id for c in self.opened.policy.capabilities if Caller.GATE in c.callers)

    def judge(
        self, name: str, caller: Caller, by: Identifier, *, stands: bool = False
    ) -> JudgedEmergency:
        """Ask both gates about a call; nothing is used, recorded or released.

        Args:
            name: the capability, from anyone.
            caller: what called.
            by: who, named by the channel.
            stands: the robot stands, and this answer lets it begin: only state from after its last
                motion counts, and monitored values do. Else the newest counts, for a call that
                comes right after a motion is no false one.
        """
        capability = named(self.opened, name)
        now, stopped = self._ledger.latest(), self.log.stopped  # either may raise the fence
        scene = EmergencyScene(
            state=self._state(stands=stands),
            facts=self._facts,
            now=now,
            uses=self.log.uses(caller, name),
            tries=self.log.tries(caller, name),
            lacks=self._lacks(frozenset(Missing)),
            stopped=stopped,
            stands=stands,
        )
        decided = decide_emergency(self.opened, name, caller, scene)
        found = in_paper_order((*decided.findings, *self._revoked()))
        decision = msgspec.structs.replace(decided, findings=found)
        call = JudgedEmergency(name=name, caller=caller, by=by, decision=decision, scene=scene)
        if capability is None:
            return call
        action = action_of(capability, scene.state, self._facts)
        safety = None
        if decision.accepted:
            safety = self._safety.assess(action, scene.state, self._facts, scene.now)
        return msgspec.structs.replace(call, action=action, safety=safety)

    def begin(self, call: JudgedEmergency) -> EmergencyReport | EmergencyExecution:
        """Record an accepted call and dispatch it; the caller watches it.

        Raises:
            RuntimeError: it was not accepted: a fault of the caller's.
        """
        capability, action = call.decision.capability, call.action
        if not call.released or capability is None or action is None:
            raise RuntimeError("an emergency was begun that was not accepted")
        self._count += 1
        now = call.scene.now
        ticket = digest_of(
            Tag.ACTION, (self.opened.digest, action, now.utc_ms, now.mono_ms, self._count)
        )
        lease = permit_emergency(self.opened, capability, facts=self._facts, now=now, ticket=ticket)
        step = self._step(call, ticket, ACCEPT)
        try:
            self.log.write(step, journal=Missing.STORE in capability.without)
        except AuthGuardError as error:
            return EmergencyReport(call=call, reasons=(fault_finding(error),))
        return self._dispatch(call, capability, action, lease)

    def _dispatch(
        self, call: JudgedEmergency, capability: Capability, action: Action, lease: Lease
    ) -> EmergencyReport | EmergencyExecution:
        findings = self.look(capability, lease, stands=True)
        if not findings:
            try:
                handle = self.watch.controller.dispatch(action, lease)
                return EmergencyExecution(self, call, lease=lease, handle=handle)
            except ControllerError as error:
                findings = (fault_finding(error),)
        return self.ended(call, lease.ticket, Outcome.NOT_STARTED, findings)

    def look(self, capability: Capability, lease: Lease, *, stands: bool = False) -> Findings:
        """Ask a lease's conditions on new state; while the robot stands, as `judge` does."""
        found = still_emergency(
            capability,
            lease,
            self._state(stands=stands),
            facts=self._facts,
            now=self._ledger.latest(),
            lacks=self._lacks(frozenset(Missing).difference(capability.without)),
        )
        return (*self._revoked(), *found)

    def ended(
        self,
        call: JudgedEmergency,
        ticket: Digest,
        outcome: Outcome,
        findings: Findings,
        stood_ms: int | None = None,
    ) -> EmergencyReport:
        """Write down how it ended; what cannot be written is said."""
        step = self._step(call, ticket, outcome, findings, stood_ms)
        written = True
        try:
            self.log.write(step, journal=True)
        except AuthGuardError:
            written = False
        self._ledger.raise_fence()  # the log may hear of it later only
        return EmergencyReport(
            call=call, ticket=ticket, outcome=outcome, reasons=findings, recorded=written
        )

    def refuse(self, call: JudgedEmergency, findings: Findings) -> None:
        """Record a refused call; a row of one caller's is one record.

        Args:
            call: as it was judged.
            findings: why; the policy's, or what was found since.
        """
        hazards = () if call.safety is None else call.safety.findings
        first = next(iter(findings), Finding("safety", Reason.GUARD_FALSE, "safe", "unsafe"))
        error = RefusedError(
            f"expected {first.expected}, got {first.got}", reason=first.reason, where=first.field
        )
        entry = refused_call(
            error,
            by=call.by,
            reasons=list(dict.fromkeys(f.reason for f in findings)),
            hazards=[hazard.hazard for hazard in hazards],
            sealed={"capability": call.name[:64], "findings": findings},
        )
        dedup_key = (call.by, str(first.reason), "emergency")
        quietly(lambda: self._ledger.refuse(entry, dedup_key=dedup_key))

    def _revoked(self) -> Findings:
        """Return that the policy's signer was revoked since it was opened, if that is so."""
        try:
            require_signer(self.opened, verifier=self._verifier)
        except AuthGuardError as error:
            return (fault_finding(error),)
        return ()

    def _state(self, *, stands: bool) -> AttestedState | None:
        """Return the newest attested state; what cannot be taken in now leaves the last."""
        quietly(self._inputs.refresh)
        return self._inputs.state if stands else self._inputs.newest

    def _lacks(self, asked: frozenset[Missing]) -> frozenset[Missing]:
        """Return what is missing; that the store is, shows when it is written to."""
        lacks: set[Missing] = set()
        if Missing.CLOCK in asked and quietly(self._ledger.now) is None:
            lacks.add(Missing.CLOCK)
        if Missing.MISSION in asked:
            held = quietly(lambda: self._ledger.peek(lambda turn: turn.get("active", "mission")))
            lacks |= set() if held else {Missing.MISSION}
        return frozenset(lacks)

    def _step(
        self,
        call: JudgedEmergency,
        ticket: Digest,
        decision: str,
        findings: Findings = (),
        stood_ms: int | None = None,
    ) -> EmergencyStep:
        return EmergencyStep(
            decision=decision,
            at=self._ledger.latest(),
            opened=self.opened,
            capability=Identifier(call.name),
            caller=call.caller,
            by=call.by,
            ticket=ticket,
            action=call.action,
            state=call.scene.state,
            safety=call.safety,
            findings=findings,
            lacked=call.scene.lacks,
            stood_ms=stood_ms,
        )


class EmergencyExecution:
    """One emergency while the robot moves, until its outcome is written down.

    Args:
        rescue: looks, stops, writes.
        call: what was accepted.
        lease: what it permits.
        handle: what the controller says of it.
    """

    def __init__(
        self, rescue: EmergencyEnforcer, call: JudgedEmergency, *, lease: Lease, handle: GoalHandle
    ) -> None:
        capability = call.decision.capability
        if capability is None or call.action is None:  # pragma: no cover - it was accepted
            raise RuntimeError("an emergency was dispatched without a capability")
        self._rescue = rescue
        self.call = call
        self.lease = lease
        self.action = call.action
        self.since_ms = rescue.watch.mono_ms()
        self._course = ExecutionMonitor(
            rescue.watch, handle, lambda: rescue.look(capability, lease)
        )

    @property
    def holds(self) -> bool:
        """True while nothing was found against it."""
        return self._course.holds

    def poll(self) -> EmergencyReport | None:
        """Look once; return the result when it has ended, None while it goes on."""
        landed = self._course.poll()
        if landed is None:
            return None
        return self._rescue.ended(
            self.call, self.lease.ticket, landed.outcome, landed.findings, landed.stood_ms
        )
