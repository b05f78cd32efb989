# SPDX-License-Identifier: Apache-2.0
"""Emergencies at a gate: who calls, what runs meanwhile is stopped first, false ones are counted.

A false call stops nothing and changes nothing: it is answered, recorded and published. Only a call
that both gates accept stops what runs. It is judged again once the robot stands, on state from
after that. Spec page: docs/spec/emergency.md#calls
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from functools import partial
from typing import Any

import msgspec
from msgspec import Struct

from authguard_r.core.errors import EnvironmentFault, RefusedError
from authguard_r.core.finding import Finding, Findings
from authguard_r.core.identifiers import Identifier
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Outcome
from authguard_r.enforcement.emergency.policy import Caller
from authguard_r.enforcement.emergency_enforcer import (
    EmergencyEnforcer,
    EmergencyExecution,
    EmergencyReport,
    JudgedEmergency,
)
from authguard_r.enforcement.enforcer import Enforcer
from authguard_r.server.fair_queue import ServedClient
from authguard_r.server.lease_registry import LeaseRegistry
from authguard_r.server.liveness import Liveness
from authguard_r.server.remote_controller import RemoteController
from authguard_r.wire.gate_limits import LIMITS
from authguard_r.wire.messages import ClientRole, Emergency

#: The alert about an emergency journal that holds entries that this gate did not write.
STRANGE = "the emergency journal is not authentic"
_GATE = Identifier("gate")
_CALLERS = {ClientRole.PLANNER: Caller.PLANNER, ClientRole.OPERATOR: Caller.OPERATOR}


#: Results of calls by client and key; None: it is under way.
_Answers = dict[tuple[Identifier, str], dict[str, Any] | None]


class _CallListener(Struct, frozen=True):
    """The client that hears the result of a call; the gate's own calls have none."""

    name: Identifier
    caller: Caller
    capability: str
    tell: Callable[[dict[str, Any]], None]


class _PendingCall(Struct, frozen=True):
    """An accepted call that waits until the robot stands, and then for state from after that."""

    asked: _CallListener
    until_ms: int
    stands: bool = False


class _Failed(Struct, frozen=True):
    """When a call of the gate's own came to nothing, and how long it is not made again."""

    at_ms: int
    again_ms: int


class EmergencyCalls:
    """The emergency path's clients.

    Args:
        path: carries emergencies out.
        enforcer: refuses proposals while an emergency is under way.
        leases: what moves; emergencies are watched there, too.
        controller: the controller's end; None where nothing is connected to anything.
        liveness: alerts.
        publish: sends an event to every client that watches.
        state_wait_ms: once the robot stands, a call waits so long at most for newer state.
        closing: returns True once the gate ends: nothing is begun then.
    """

    def __init__(
        self,
        path: EmergencyEnforcer,
        *,
        enforcer: Enforcer,
        leases: LeaseRegistry,
        controller: RemoteController | None,
        liveness: Liveness,
        publish: Callable[[dict[str, Any]], None],
        state_wait_ms: int,
        closing: Callable[[], bool],
    ) -> None:
        self._path = path
        self._enforcer = enforcer
        self._leases = leases
        self._controller = controller
        self._liveness = liveness
        self._publish = publish
        self._state_wait_ms = state_wait_ms
        self._waiting: _PendingCall | None = None
        self._running: _CallListener | None = None
        self._answers: dict[tuple[str, ClientRole], _Answers] = {}
        self._false: OrderedDict[str, int] = OrderedDict()
        self._false_in: str | None = None
        self._met: set[Identifier] = set()
        self._failed: dict[Identifier, _Failed] = {}
        self._flushed_ms = 0
        self._closing = closing

    def shown(self) -> dict[str, Any]:
        """Return what `status` says of emergencies."""
        policy = self._path.opened.policy
        waiting = None if self._waiting is None else self._waiting.asked
        asked = self._running or waiting
        return {
            "policy": policy.id,
            "version": policy.version,
            "expiry": policy.expiry,
            "under_way": None if asked is None else asked.capability,
            "unknown": list(self._path.log.unknown),
        }

    def call(self, client: ServedClient, number: int, asked: Emergency) -> None:
        """Answer a call, now or when it has ended.

        Raises:
            RefusedError: the key is another call's that is not answered yet.
        """
        mine = self._answers.setdefault((_user_of(client.name), client.role), {})
        key = (client.name, asked.key)
        if key in mine:
            known = mine[key]
            if known is None:
                raise RefusedError("it is not answered yet", reason=Reason.BUSY, where="key")
            client.reply(number, {**known, "repeated": True})
            return
        mine[key] = None

        def tell(answer: dict[str, Any]) -> None:
            mine.pop(key)
            mine[key] = answer
            answered = [kept for kept, told in mine.items() if told is not None]
            for kept in answered[: -LIMITS.emergency_answers]:  # what is under way is not forgotten
                del mine[kept]
            client.reply(number, {**answer, "repeated": False})

        caller = _CALLERS[client.role]
        self._judge(_CallListener(client.name, caller, asked.capability, tell))

    def look(self) -> None:
        """Go on with what waits, and call what the gate calls by itself."""
        now_ms = self._path.watch.mono_ms()
        if now_ms - self._flushed_ms >= LIMITS.emergency_flush_ms:
            self._flushed_ms = now_ms
            self._path.log.flush()
        if self._waiting is not None:
            self._go_on(self._waiting, now_ms)
        elif self._running is None and not self._closing():
            self._watch(now_ms)

    # one call

    def _judge(self, asked: _CallListener) -> None:
        call = self._path.judge(asked.capability, asked.caller, asked.name)
        if not call.released:
            self._refuse(asked, call, call.decision.findings)
        elif self._running is not None or self._waiting is not None:
            busy = Finding("emergency", Reason.BUSY, "no other that is under way", "one")
            self._refuse(asked, call, (busy,), is_false=False)
        elif hindered := self._hindered():
            self._refuse(asked, call, hindered, is_false=False)
        else:
            self._enforcer.require(self._require_over)
            until_ms = self._path.watch.mono_ms() + self._path.watch.stand_within_ms
            self._waiting = _PendingCall(asked, until_ms)
            if self._leases:
                self._path.watch.controller.stop()
            self._go_on(self._waiting, self._path.watch.mono_ms())

    def _go_on(self, waiting: _PendingCall, now_ms: int) -> None:
        """Begin once the robot stands, no stop is unexplained and newer state shows that it may.

        Both have their time; what was not so by then refuses the call.
        """
        remote = self._controller
        rests = remote is None or (remote.at_rest and remote.can_stop())
        if (self._leases or not rests) and now_ms <= waiting.until_ms:
            return
        if not waiting.stands:
            waiting = _PendingCall(waiting.asked, now_ms + self._state_wait_ms, stands=True)
        self._waiting = None
        asked = waiting.asked
        self._path.log.flush()  # what ended before is in the log before the fence is asked
        call = self._path.judge(asked.capability, asked.caller, asked.name, stands=True)
        moves = Finding("controller", Reason.BUSY, "a robot that stands", "one that moves")
        if hindered := (moves,) if self._leases else self._hindered(begins=True):
            self._refuse(asked, call, hindered, is_false=False)
        elif call.released:
            self._begin(asked, call)
        elif call.is_early and now_ms < waiting.until_ms:
            self._waiting = waiting
        else:
            self._refuse(asked, call, call.decision.findings, is_false=not call.is_early)

    def _hindered(self, *, begins: bool = False) -> Findings:
        """Return why nothing could be begun, even if both gates accept; nothing is written then.

        Args:
            begins: now, and not once the robot stands.
        """
        if self._closing():
            return (Finding("gate", Reason.BUSY, "a gate that serves", "one that ends"),)
        if self._controller is not None and not self._controller.connected:
            away = Finding("controller", Reason.CONTROLLER_FAILED, "a connected one", "none")
            return (away,)
        if begins and self._controller is not None and not self._controller.can_stop():
            return (Finding("stop", Reason.BUSY, "a stop process that answers", "none"),)
        return ()

    def _begin(self, asked: _CallListener, call: JudgedEmergency) -> None:
        told = {"capability": call.name, "by": call.by, "caller": str(call.caller)}
        begun = self._path.begin(call)
        if isinstance(begun, EmergencyExecution):
            self._running = asked
            self._leases.watch_emergency(begun, partial(self._ended, asked))
            self._publish({"event": "emergency", **told})
            self._liveness.tell("emergency", told)
        else:
            self._answer(asked, begun)

    def _ended(self, asked: _CallListener, ended: EmergencyReport) -> None:
        self._running = None
        self._liveness.end("emergency")
        self._answer(asked, ended)

    def _answer(self, asked: _CallListener, ended: EmergencyReport) -> None:
        told = emergency_json(ended)
        self._publish({"event": "emergency", "by": asked.name, **told})
        asked.tell(told)

    def _refuse(
        self,
        asked: _CallListener,
        call: JudgedEmergency,
        findings: Findings,
        *,
        is_false: bool = True,
    ) -> None:
        """Record a refused call, count a planner's false one, and answer."""
        self._path.refuse(call, findings)
        if is_false and asked.caller is Caller.PLANNER:
            self._count(asked, call, findings)
        asked.tell(emergency_json(EmergencyReport(call=call, reasons=findings)))

    def _count(self, asked: _CallListener, call: JudgedEmergency, findings: Findings) -> None:
        """Raise an alert at a user's first false call, the tenth, the hundredth, and so on.

        Each mission begins the count anew, for the alert ends with it.
        """
        phase = self._liveness.follow()
        before, self._false_in = self._false_in, None if phase is None else phase.mid
        if self._false_in != before:
            self._false.clear()
        user = _user_of(asked.name)
        count = self._false.pop(user, 0) + 1
        self._false[user] = count
        while len(self._false) > LIMITS.emergency_users:
            self._false.popitem(last=False)
        if str(count).strip("0") != "1":
            return
        reasons = list(dict.fromkeys(str(finding.reason) for finding in findings))
        known = call.decision.capability
        self._liveness.alert(
            "false emergency",
            {
                "client": asked.name,
                "calls": count,
                "reasons": reasons or ["SAFETY"],
                "capability": "-" if known is None else known.id,
            },
        )

    def _watch(self, now_ms: int) -> None:
        """Call what the gate calls by itself, once each time that its guards begin to hold.

        What came to nothing is called again while they hold. Nothing is called, and so nothing is
        stopped, for guards that hold on state from before the last motion alone.
        """
        for name in self._path.of_gate():
            call = self._path.judge(name, Caller.GATE, _GATE)
            if not call.released:
                self._met.discard(name)
                if name in self._failed:  # what begins next is called at once
                    self._failed[name] = _Failed(
                        self._failed[name].at_ms, LIMITS.emergency_again_ms
                    )
            elif name not in self._met and self._is_due(name, now_ms):
                self._met.add(name)
                self._judge(_CallListener(_GATE, Caller.GATE, name, partial(self._answered, name)))
                return

    def _is_due(self, name: Identifier, now_ms: int) -> bool:
        """True when a capability can begin, and a call of it did not fail a moment ago."""
        failed = self._failed.get(name)
        if self._hindered() or (failed and now_ms - failed.at_ms < failed.again_ms):
            return False
        return not self._path.judge(name, Caller.GATE, _GATE, stands=True).is_early

    def _answered(self, name: Identifier, answer: dict[str, Any]) -> None:
        """Let a call of the gate's own be made again when nothing came of it."""
        failed = self._failed.pop(name, None)
        if answer["execution"]["outcome"] == Outcome.NOT_STARTED:
            twice_ms = LIMITS.emergency_again_ms if failed is None else 2 * failed.again_ms
            again_ms = min(twice_ms, LIMITS.emergency_again_at_last_ms)
        elif answer["ticket"] is None:
            again_ms = LIMITS.emergency_again_ms if failed is None else failed.again_ms
        else:
            return
        self._met.discard(name)
        self._failed[name] = _Failed(self._path.watch.mono_ms(), again_ms)

    def _require_over(self) -> None:
        """Refuse proposals while an emergency is under way.

        Raises:
            EnvironmentFault: one is (`BUSY`).
        """
        if self._running is not None or self._waiting is not None:
            raise EnvironmentFault(
                "an emergency is under way", reason=Reason.BUSY, where="emergency"
            )


def _user_of(name: Identifier) -> str:
    """Return the user of a client, who is one under all its names."""
    return name.partition(".")[0]


def emergency_json(ended: EmergencyReport) -> dict[str, Any]:
    """Return what the caller hears of its call."""
    call = ended.call
    released = ended.ticket is not None
    findings = () if released else ended.reasons
    hazards = () if call.safety is None else call.safety.findings
    execution = {
        "outcome": ended.outcome,
        "reasons": [str(finding.reason) for finding in ended.reasons] if released else [],
        "recorded": ended.recorded,
    }
    return {
        "capability": call.name,
        "outcome": "accept" if released else "reject",
        "reasons": list(dict.fromkeys(str(finding.reason) for finding in findings)),
        "findings": msgspec.to_builtins(findings),
        "hazards": [str(hazard.hazard) for hazard in hazards],
        "ticket": ended.ticket,
        "execution": execution,
    }
