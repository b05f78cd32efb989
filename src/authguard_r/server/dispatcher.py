# SPDX-License-Identifier: Apache-2.0
"""What each request does when its client's turn has come.

A thin table: every act is the enforcer's or the management's. Nothing is read from a socket here
and nothing waits. Spec page: docs/spec/gate-protocol.md#requests
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec

from authguard_r.core.approval import VerifiedApproval
from authguard_r.core.errors import AuthenticityError, AuthGuardError, RefusedError
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Standing
from authguard_r.enforcement.management.lists import Received
from authguard_r.enforcement.management.rollback import AcceptedStore
from authguard_r.enforcement.management.shredding import Shredding
from authguard_r.enforcement.templates.template_store import TemplateStanding
from authguard_r.server.approval_requests import OpenQuestions
from authguard_r.server.emergencies import EmergencyCalls
from authguard_r.server.fair_queue import ServedClient
from authguard_r.server.lease_registry import LeaseRegistry
from authguard_r.server.plans import Plans, parts_of
from authguard_r.server.queries import GateQueries
from authguard_r.server.remote_controller import RemoteController
from authguard_r.server.state_inbox import StateInbox
from authguard_r.server.streams import Streams
from authguard_r.server.wiring import Gate
from authguard_r.wire.faults import to_fault
from authguard_r.wire.frames import Frame, read_body
from authguard_r.wire.messages import (
    BODY,
    Approvals,
    Attest,
    Close,
    Emergency,
    Evaluate,
    Explain,
    Kind,
    Observe,
    Order,
    OrderKind,
    Propose,
    Records,
    Result,
    Sample,
)

#: Sends an event to every client that watches.
Publish = Callable[[dict[str, Any]], None]
#: The result of an order.
_Done = Standing | TemplateStanding | VerifiedApproval | Received | AcceptedStore | Shredding
#: What an answer calls it; anything else is a standing.
_NAMED: dict[type, str] = {
    Received: "revocations",
    AcceptedStore: "accepted",
    Shredding: "shredding",
}


class Dispatcher:
    """Serves one request at a time.

    Args:
        gate: enforcer, management, ledger.
        plans: planners' proposals.
        leases: open leases.
        look: looks at every open lease.
        inbox: where snapshots go.
        view: what may be read.
        controller: the controller's end; None where the gate has none.
        streams: open streams; None where the gate has none.
        emergencies: emergency calls; None where no policy was signed.
        questions: open approval requests.
        publish: sends an event to every client that watches.
        rest: lets the rest of a request wait for its client's next turn.
        first: settles what has to be settled before a request of a kind; raises while it cannot.
        answered: called with a client whose proposal was answered.
        refused: records a request that was refused before it was anything.
    """

    def __init__(
        self,
        gate: Gate,
        *,
        plans: Plans,
        leases: LeaseRegistry,
        look: Callable[[], None],
        inbox: StateInbox,
        view: GateQueries,
        controller: RemoteController | None,
        streams: Streams | None,
        emergencies: EmergencyCalls | None,
        questions: OpenQuestions,
        publish: Publish,
        first: Callable[[Kind], None],
        rest: Callable[[ServedClient, Callable[[], None]], None],
        answered: Callable[[ServedClient], None],
        refused: Callable[[ServedClient, AuthGuardError], None],
    ) -> None:
        self._gate = gate
        self._plans = plans
        self._leases = leases
        self._look = look
        self._inbox = inbox
        self._view = view
        self._controller = controller
        self._streams = streams
        self._publish = publish
        self._first = first
        self._rest = rest
        self._answered, self._refused = answered, refused
        self._emergencies = emergencies
        self._questions = questions
        self._acts = _orders_of(gate)
        self._table: dict[Kind, Callable[[ServedClient, int, Any], None]] = {
            Kind.PROPOSE: self._propose,
            Kind.OBSERVE: self._observe,
            Kind.SAMPLE: self._sample,
            Kind.CLOSE: self._close,
            Kind.EMERGENCY: self._emergency,
            Kind.SNAPSHOT: self._attest,
            Kind.ORDER: self._order,
            Kind.EVALUATE: self._evaluate,
            Kind.STATUS: self._status,
            Kind.RECORDS: self._records,
            Kind.EXPLAIN: self._explain,
            Kind.METRICS: self._metrics,
            Kind.APPROVALS: self._approvals,
            Kind.WATCH: self._watch,
            **dict.fromkeys((Kind.BEGUN, Kind.ENDED, Kind.STOOD), self._hear),
            Kind.RESULT: self._result,
        }

    def serve(self, client: ServedClient, item: Frame) -> None:
        """Do what a frame asks for and answer it; a fault in it is the answer."""
        try:
            self._first(item.kind)
            self._table[item.kind](client, item.id, read_body(item.body, BODY[item.kind]))
        except AuthGuardError as error:
            self._refuse(client, item, error)
        except Exception as error:  # noqa: BLE001 - a fault of ours refuses too: nobody waits for it
            fault = AuthGuardError(type(error).__name__, reason=Reason.INTERNAL_FAULT)
            self._refuse(client, item, fault)

    def _refuse(self, client: ServedClient, item: Frame, error: AuthGuardError) -> None:
        self._refused(client, error)
        client.error(item.id, to_fault(error))
        if item.kind is Kind.PROPOSE:
            self._answered(client)

    def _propose(self, client: ServedClient, number: int, asked: Propose) -> None:
        self._plans.propose(client, number, asked)

    def _observe(self, client: ServedClient, number: int, seen: Observe) -> None:
        """Note a text in parts, one a turn: looking through a long one takes long."""
        parts = parts_of(seen.text)

        def note() -> None:
            self._plans.contexts.observe(client, seen.channel, parts.pop(0))
            if parts:
                self._rest(client, note)
            else:
                client.reply(number, {})

        note()

    def _sample(self, client: ServedClient, number: int, sample: Sample) -> None:
        forwarded = self._open_streams().sample(client.name, sample.ticket, sample.params)
        client.reply(number, {"forwarded": forwarded})

    def _close(self, client: ServedClient, number: int, ended: Close) -> None:
        self._open_streams().finish(client.name, ended.ticket)
        client.reply(number, {})

    def _open_streams(self) -> Streams:
        if self._streams is None:
            raise RefusedError("nothing streams here", reason=Reason.LEASE_ENDED, where="ticket")
        return self._streams

    def _emergency(self, client: ServedClient, number: int, asked: Emergency) -> None:
        if self._emergencies is None:
            raise RefusedError(
                "no emergency policy is here",
                reason=Reason.ACTION_OUT_OF_SCOPE,
                where="capability",
            )
        self._emergencies.call(client, number, asked)

    def _attest(self, client: ServedClient, number: int, attested: Attest) -> None:
        """Take a snapshot in and look at every lease; the log has why one was not taken in."""
        inputs = self._gate.enforcer.inputs
        if attested.token == self._inbox.latest():
            raise AuthenticityError(
                "expected a snapshot after the last one",
                reason=Reason.STATE_REPLAYED,
                where="snapshot",
            )
        self._inbox.put(attested.token, client)
        inputs.refresh()
        state = inputs.newest
        self._look()
        if inputs.fault is not None:
            raise inputs.fault
        taken = None if state is None else (state.snapshot.epoch, state.snapshot.seq)
        client.reply(number, {} if taken is None else {"epoch": taken[0], "seq": taken[1]})

    def _order(self, client: ServedClient, number: int, order: Order) -> None:
        """Do an act of management and look at every lease: it may have ended some."""
        try:
            done = self._acts[order.act](order)
        finally:
            self._look()
            self._view.mission.changed()  # a refused order may have ended an issued mission
        if isinstance(done, VerifiedApproval):
            answer: dict[str, Any] = self._questions.answered(done)
        else:
            answer = {_NAMED.get(type(done), "standing"): msgspec.to_builtins(done)}
        standing = answer.get("standing", {})
        after = {name: standing[name] for name in ("mid", "version", "status") if name in standing}
        self._publish({"event": "management", "act": order.act, "by": client.name, **after})
        client.reply(number, answer)

    def _evaluate(self, client: ServedClient, number: int, asked: Evaluate) -> None:
        def answer(steps: list[dict[str, Any]] | AuthGuardError) -> None:
            if isinstance(steps, AuthGuardError):
                client.error(number, to_fault(steps))
            else:
                client.reply(number, {"steps": steps})

        self._plans.evaluate(client, asked, answer)

    def _status(self, client: ServedClient, number: int, asked: object) -> None:  # noqa: ARG002
        client.reply(number, self._view.status())

    def _records(self, client: ServedClient, number: int, asked: Records) -> None:
        client.reply(number, {"records": self._view.records(asked.first, asked.count)})

    def _explain(self, client: ServedClient, number: int, asked: Explain) -> None:
        try:
            client.reply(number, self._view.explain(asked.seq))
        except RefusedError as error:  # a question without an answer is not counted as an attempt
            client.error(number, to_fault(error))

    def _approvals(self, client: ServedClient, number: int, asked: Approvals) -> None:
        try:
            client.reply(number, msgspec.to_builtins(self._questions.told(asked.counter)))
        except RefusedError as error:  # a question without an answer is not counted as an attempt
            client.error(number, to_fault(error))

    def _metrics(self, client: ServedClient, number: int, asked: object) -> None:  # noqa: ARG002
        client.reply(number, self._view.metrics())

    def _watch(self, client: ServedClient, number: int, asked: object) -> None:  # noqa: ARG002
        client.watching = number
        client.reply(number, {})

    def _hear(self, client: ServedClient, number: int, said: Any) -> None:  # noqa: ARG002
        if self._controller is not None:
            self._controller.hear(said, number)
            self._look()

    def _result(self, client: ServedClient, number: int, said: Result) -> None:  # noqa: ARG002
        self._leases.tell(said)


def _orders_of(gate: Gate) -> dict[OrderKind, Callable[[Order], _Done]]:
    """Return what carries out each kind of order: always the management, or the list keeper."""
    management = gate.management
    return {
        OrderKind.ACTIVATE: lambda o: management.activate(o.token, confirmation=o.confirmation),
        OrderKind.ISSUE: lambda o: management.issue(o.token, confirmation=o.confirmation),
        OrderKind.COMMAND: lambda o: management.command(o.token),
        OrderKind.SELECT: lambda o: management.select(o.token),
        OrderKind.APPROVE: lambda o: management.approve(o.token, why=o.why),
        OrderKind.TEMPLATE: lambda o: management.template(o.token, confirmation=o.confirmation),
        OrderKind.REVOCATIONS: lambda o: gate.lists.install(o.token),
        OrderKind.ACCEPT_STORE: lambda o: management.accept_store(o.token),
        OrderKind.SHRED: lambda o: management.shred(o.token),
    }
