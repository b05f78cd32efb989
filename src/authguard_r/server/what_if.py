# SPDX-License-Identifier: Apache-2.0
"""What both gates would say of a step now, and steps that wait while newer state may change that.

Nothing is recorded, consumed or released here. Spec page: docs/spec/state.md#fences
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from msgspec import Struct

from authguard_r.core.errors import AuthGuardError
from authguard_r.core.reasons import Reason
from authguard_r.enforcement.completion import attested_source
from authguard_r.enforcement.evaluation import evaluate
from authguard_r.enforcement.leases import quietly
from authguard_r.enforcement.report import Judged, behind_of, lacks_state
from authguard_r.normalize import Step
from authguard_r.safety.stored_memory import memory_of
from authguard_r.server.remote_controller import RemoteController
from authguard_r.server.wiring import Gate


class _WaitingStep(Struct, frozen=True):
    step: Step
    until_ms: int
    go_on: Callable[[int], None]


class WhatIf:
    """Asks both gates without any effect, and keeps steps for which newer state is awaited.

    Args:
        gate: enforcer, ledger, safety.
        controller: says whether a stop would be carried out: a step waits for that, too. None: it
            always would.
        wait_ms: a step waits so long at most.
    """

    def __init__(self, gate: Gate, controller: RemoteController | None, *, wait_ms: int) -> None:
        self._gate = gate
        self._controller = controller
        self._wait_ms = wait_ms
        self._held: list[_WaitingStep] = []
        self._seen: object = None
        self._is_closed = False

    def holds(self, step: Step, until_ms: int | None, go_on: Callable[[int], None]) -> bool:
        """Keep a step that would be refused for want of newer state; True when it is kept.

        Args:
            step: what is to be decided.
            until_ms: it is decided then in any case; None: it has not waited yet.
            go_on: called once with that, when newer state has come or the time is over.
        """
        now_ms = self._gate.ledger.mono_ms()
        until = now_ms + self._wait_ms if until_ms is None else until_ms
        if self._is_closed or now_ms >= until or (self._can_stop() and not self._is_early(step)):
            return False
        self._held.append(_WaitingStep(step, until, go_on))
        return True

    def close(self) -> None:
        """Let no step wait any more: the gate ends."""
        self._is_closed = True
        held, self._held = self._held, []
        for item in held:
            item.go_on(item.until_ms)

    def look(self) -> None:
        """Let every step go on once there is other state than before, or its time is over."""
        if not self._held:
            return
        ledger, inputs = self._gate.ledger, self._gate.enforcer.inputs
        quietly(inputs.refresh)
        now_ms, newest = ledger.mono_ms(), (inputs.newest, ledger.fence, self._can_stop())
        is_new, self._seen = newest != self._seen, newest
        held, self._held = self._held, []
        for item in held:
            if is_new or now_ms >= item.until_ms:
                item.go_on(item.until_ms)
            else:
                self._held.append(item)

    def _can_stop(self) -> bool:
        return self._controller is None or self._controller.can_stop()

    def judge(self, step: Step) -> Judged:
        """Return what both gates would say of a step, on the newest state.

        Raises:
            AuthGuardError: there is no mission to ask about, or the clock is behind.
        """
        gate, inputs = self._gate, self._gate.enforcer.inputs
        state = inputs.refresh()
        verified = gate.ledger.run(inputs.active_mission)
        standing = gate.ledger.standing(verified.mission.mid)
        remembered = partial(memory_of, standing=standing)
        return evaluate(
            verified,
            attested_source(step, state),
            state=state,
            facts=gate.facts,
            now=gate.ledger.now(),
            standing=standing,
            safety=gate.safety.recall(gate.ledger.peek(remembered)),
        )

    def _is_early(self, step: Step) -> bool:
        """True while the decision rests on state from before the last motion.

        Such state makes a guard or a place unknown, another grant than the right one the closest,
        and a risk higher. The decision itself reports any fault here.
        """
        gate, inputs = self._gate, self._gate.enforcer.inputs
        try:
            state = inputs.refresh()
            behind = behind_of(state)
            if not behind:
                return False
            judged = self.judge(step)
        except AuthGuardError:
            return False
        reasons = judged.decision.reasons
        if not reasons:
            return lacks_state(judged.safety)
        policies = (judged.verified.mission.risk_policy, *gate.facts.risk)
        risky = {one.guard.variable for policy in policies for one in policy.states}
        asks = {Reason.APPROVAL_REQUIRED, Reason.APPROVAL_TIMEOUT} >= set(reasons)
        return Reason.STATE_BEFORE_MOTION in reasons or (asks and not risky.isdisjoint(behind))
