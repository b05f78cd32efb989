# SPDX-License-Identifier: Apache-2.0
"""Emergencies at a gate: who calls, what runs meanwhile is stopped first, false ones are counted.

A false call stops nothing and changes nothing: it is answered, recorded and told to people. Only
a call that both gates accept stops what runs, and is judged again once the robot stands.
Spec page: docs/spec/emergency.md#calls
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
from authguard_r.emergency.policy import Caller
from authguard_r.enforcement import Enforcer
from authguard_r.gate.clients import Client
from authguard_r.gate.controller import RemoteController
from authguard_r.gate.liveness import Liveness
from authguard_r.gate.motions import Motions
from authguard_r.rescue import Call, Relief, Rescue, Rescued
from authguard_r.wire.messages import ClientRole, Emergency

#: Answers that are told again, to each user in each role: nobody's calls push out another's.
_MOST_KEPT = 256
#: Users whose false calls are counted; a further one takes the place of the oldest.
_MOST_COUNTED = 1_024
#: What waits in the journal is tried this often, in milliseconds.
FLUSH_MS = 100
#: What the gate calls and could not begin is called again after so long, in milliseconds.
AGAIN_MS = 1_000
_GATE = Identifier("gate")
_CALLERS = {ClientRole.PLANNER: Caller.PLANNER, ClientRole.OPERATOR: Caller.OPERATOR}


#: What became of calls by client and key; None: it is under way.
_Answers = dict[tuple[Identifier, str], dict[str, Any] | None]


class _Asked(Struct, frozen=True):
    """Who is told what becomes of a call; nobody is told of the gate's own."""

    name: Identifier
    caller: Caller
    capability: str
    tell: Callable[[dict[str, Any]], None]


class _Waiting(Struct, frozen=True):
    """An accepted call that waits until the robot stands."""

    asked: _Asked
    until_ms: int


class Rescues:
    """The emergency road's clients.

    Args:
        rescue: the road.
        enforcer: refuses proposals while an emergency is under way.
        motions: what moves; emergencies are watched there, too.
        controller: the controller's end; None where nothing is connected to anything.
        liveness: alerts.
        publish: tells everybody who watches.
    """

    def __init__(
        self,
        rescue: Rescue,
        *,
        enforcer: Enforcer,
        motions: Motions,
        controller: RemoteController | None,
        liveness: Liveness,
        publish: Callable[[dict[str, Any]], None],
    ) -> None:
        self._rescue = rescue
        self._enforcer = enforcer
        self._motions = motions
        self._controller = controller
        self._liveness = liveness
        self._publish = publish
        self._waiting: _Waiting | None = None
        self._running: _Asked | None = None
        self._answers: dict[tuple[str, ClientRole], _Answers] = {}
        self._false: OrderedDict[str, int] = OrderedDict()
        self._false_in: str | None = None
        self._met: set[Identifier] = set()
        self._failed: dict[Identifier, int] = {}
        self._flushed_ms = 0
        #: true once the gate ends: nothing is begun any more
        self.closing: Callable[[], bool] = lambda: False

    def shown(self) -> dict[str, Any]:
        """Return what `status` says of emergencies."""
        policy = self._rescue.opened.policy
        waiting = None if self._waiting is None else self._waiting.asked
        asked = self._running or waiting
        return {
            "policy": policy.id,
            "version": policy.version,
            "expiry": policy.expiry,
            "under_way": None if asked is None else asked.capability,
            "unknown": list(self._rescue.log.unknown),
        }

    def call(self, client: Client, number: int, asked: Emergency) -> None:
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
            for kept in answered[:-_MOST_KEPT]:  # what is under way is not forgotten
                del mine[kept]
            client.reply(number, {**answer, "repeated": False})

        caller = _CALLERS[client.role]
        self._judge(_Asked(client.name, caller, asked.capability, tell))

    def look(self) -> None:
        """Go on with what waits, and call what the gate calls by itself."""
        now_ms = self._rescue.watch.mono_ms()
        if now_ms - self._flushed_ms >= FLUSH_MS:
            self._flushed_ms = now_ms
            self._rescue.log.flush()
        if self._waiting is not None:
            self._go_on(self._waiting, now_ms)
        elif self._running is None and not self.closing():
            self._watch(now_ms)

    # one call

    def _judge(self, asked: _Asked) -> None:
        call = self._rescue.judge(asked.capability, asked.caller, asked.name)
        if not call.released:
            self._refuse(asked, call, call.decision.findings)
        elif self._running is not None or self._waiting is not None or self.closing():
            busy = Finding("emergency", Reason.BUSY, "no other that is under way", "one")
            self._refuse(asked, call, (busy,), is_false=False)
        else:
            self._enforcer.before_first(self._require_over)
            until_ms = self._rescue.watch.mono_ms() + self._rescue.watch.stand_within_ms
            self._waiting = _Waiting(asked, until_ms)
            if self._motions:
                self._rescue.watch.controller.stop()
            self._go_on(self._waiting, self._rescue.watch.mono_ms())

    def _go_on(self, waiting: _Waiting, now_ms: int) -> None:
        """Begin once the robot stands and no stop is unexplained; give up after a while."""
        rests = self._controller is None or self._controller.at_rest
        late = now_ms > waiting.until_ms
        if (self._motions or not rests) and not late:
            return
        self._waiting = None
        asked = waiting.asked
        call = self._rescue.judge(asked.capability, asked.caller, asked.name)
        if self._motions or self.closing():
            moves = Finding("controller", Reason.BUSY, "a robot that stands", "one that moves")
            self._refuse(asked, call, (moves,), is_false=False)
        elif not call.released:
            self._refuse(asked, call, call.decision.findings)
        else:
            self._begin(asked, call)

    def _begin(self, asked: _Asked, call: Call) -> None:
        told = {"capability": call.name, "by": call.by, "caller": str(call.caller)}
        begun = self._rescue.begin(call)
        if isinstance(begun, Relief):
            self._running = asked
            self._motions.rescue(begun, partial(self._ended, asked))
            self._publish({"event": "emergency", **told})
            self._liveness.tell("emergency", told)
        else:
            self._answer(asked, begun)

    def _ended(self, asked: _Asked, ended: Rescued) -> None:
        self._running = None
        self._liveness.end("emergency")
        self._answer(asked, ended)

    def _answer(self, asked: _Asked, ended: Rescued) -> None:
        told = rescued_json(ended)
        self._publish({"event": "emergency", "by": asked.name, **told})
        asked.tell(told)

    def _refuse(
        self, asked: _Asked, call: Call, findings: Findings, *, is_false: bool = True
    ) -> None:
        """Record a refused call, count a planner's false one, and answer."""
        self._rescue.refuse(call, findings)
        if is_false and asked.caller is Caller.PLANNER:
            self._count(asked, call, findings)
        asked.tell(rescued_json(Rescued(call=call, reasons=findings)))

    def _count(self, asked: _Asked, call: Call, findings: Findings) -> None:
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
        while len(self._false) > _MOST_COUNTED:
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

        What came to nothing is called again while they hold, unless no controller is there.
        """
        away = self._controller is not None and not self._controller.connected
        for name in self._rescue.of_gate():
            call = self._rescue.judge(name, Caller.GATE, _GATE)
            if not call.released:
                self._met.discard(name)
            elif name not in self._met and self._is_due(name, now_ms, away=away):
                self._met.add(name)
                self._judge(_Asked(_GATE, Caller.GATE, name, partial(self._answered, name)))
                return

    def _is_due(self, name: Identifier, now_ms: int, *, away: bool) -> bool:
        """True when a capability was not called in vain, or is to be called again."""
        failed_ms = self._failed.get(name)
        return failed_ms is None or (now_ms - failed_ms >= AGAIN_MS and not away)

    def _answered(self, name: Identifier, answer: dict[str, Any]) -> None:
        """Let a call of the gate's own be made again when nothing came of it."""
        outcome = answer["execution"]["outcome"]
        if answer["ticket"] is None or outcome == Outcome.NOT_STARTED:
            self._met.discard(name)
            self._failed[name] = self._rescue.watch.mono_ms()

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


def rescued_json(ended: Rescued) -> dict[str, Any]:
    """Return what became of a call, as its caller is told."""
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
