# SPDX-License-Identifier: Apache-2.0
"""The process's one loop: connections, turns, clocks. It decides nothing and waits for no client.

Everything runs in one thread, so there is nothing to lock and nothing to race: what a turn does is
done when the next one begins. A disk that hangs holds the turn, and then no lease is renewed: the
controller stops by itself. Spec page: docs/spec/gate-protocol.md
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable
from functools import partial

from authguard_r.access.gate_config import GateConfig
from authguard_r.access.handshake import welcome_of
from authguard_r.core.errors import AuthGuardError, EnvironmentFault
from authguard_r.core.identifiers import Identifier
from authguard_r.core.reasons import Reason
from authguard_r.enforcement.leases import quietly
from authguard_r.enforcement.report import refusal_entry
from authguard_r.server.active_mission import ActiveMission
from authguard_r.server.approval_requests import OpenQuestions
from authguard_r.server.braking import brakes_of
from authguard_r.server.contexts import PlannerContexts
from authguard_r.server.decision_notices import DecisionNotices
from authguard_r.server.dispatcher import Dispatcher
from authguard_r.server.emergencies import STRANGE, EmergencyCalls
from authguard_r.server.event_bus import EventBus
from authguard_r.server.fair_queue import FairQueue, ServedClient
from authguard_r.server.lease_registry import LeaseRegistry
from authguard_r.server.liveness import Liveness
from authguard_r.server.log_maintenance import LogMaintenance
from authguard_r.server.periodic import every, first
from authguard_r.server.plans import Plans
from authguard_r.server.proposals import ProposalRegistry
from authguard_r.server.queries import GateQueries
from authguard_r.server.retention import RetentionWork
from authguard_r.server.service_parts import ServiceParts
from authguard_r.server.sessions import ServerSession
from authguard_r.server.stop_recorder import StopRecorder
from authguard_r.server.what_if import WhatIf
from authguard_r.wire.frames import Frame
from authguard_r.wire.gate_limits import LIMITS
from authguard_r.wire.messages import ClientRole, Hello, Kind, Mode, Welcome


class Service:
    """A gate and its clients (`sessions.ConnectionHost`).

    Args:
        parts: what it is made of; `begin` makes it ready for clients.
    """

    def __init__(self, parts: ServiceParts) -> None:
        self.gate = gate = parts.gate
        self._parts = parts
        self._config = config = parts.config
        self._controller = parts.controller
        self._advance = parts.advance
        self._recovery = parts.recovery
        self._sessions: set[ServerSession] = set()
        self._clients: set[ServedClient] = set()
        self._users: Counter[int] = Counter()
        self._queue = FairQueue(self._shed)
        self._turning = self._closing = False
        #: set when the gate is to end
        self.ended = asyncio.Event()
        self._foresight = WhatIf(gate, parts.controller, wait_ms=config.state_wait_ms)
        self.leases = LeaseRegistry(parts.controller, parts.streams)
        self.events = EventBus(gate.ledger, lambda: self._clients, parts.journal)
        mission = ActiveMission(gate.ledger, gate.enforcer.inputs)
        mono_ms = gate.ledger.mono_ms
        self.liveness = Liveness(config, mono_ms, self.events.alert, mission.phase)
        self.log_maintenance = LogMaintenance(
            gate.anchor, self.liveness, self.events, parts.rotation
        )
        self.retention = RetentionWork(gate.management, mono_ms, self.liveness, mission.changed)
        self.emergencies = self._emergency_calls()
        self.queries = self._gate_queries(mission)
        self.stops = StopRecorder(
            gate.enforcer,
            parts.controller,
            view=self.queries,
            look=self.look,
            liveness=self.liveness,
            events=self.events,
            mono_ms=mono_ms,
        )
        self._braking = brakes_of(
            gate, parts.controller, config.mode, recorder=self.stops, leases=self.leases
        )
        self._questions = OpenQuestions(gate, self.events.publish)
        self._notices = DecisionNotices(
            gate.enforcer, self.queries, self._questions, self.events, self.liveness
        )
        self._dispatcher = Dispatcher(
            gate,
            plans=self._plans(),
            leases=self.leases,
            look=self.look,
            inbox=parts.inbox,
            view=self.queries,
            controller=parts.controller,
            streams=parts.streams,
            emergencies=self.emergencies,
            questions=self._questions,
            publish=self.events.publish,
            first=self._settle_before,
            rest=partial(self._later, first=True),
            answered=self._queue.done,
            refused=lambda client, error: self.refused(client.name, error),
        )

    def _gate_queries(self, mission: ActiveMission) -> GateQueries:
        return GateQueries(
            self.gate,
            self._config,
            leases=self.leases,
            mission=mission,
            liveness=self.liveness,
            clients=lambda: self._clients,
            free_bytes=self._parts.free_bytes,
            stop_process_alive=self._parts.stop_process_alive,
            emergency=None if self.emergencies is None else self.emergencies.shown,
            simulated=self._advance is not None,
        )

    def _emergency_calls(self) -> EmergencyCalls | None:
        """Return what serves emergency calls; None without a signed policy."""
        if self._parts.emergency is None:
            return None
        return EmergencyCalls(
            self._parts.emergency,
            enforcer=self.gate.enforcer,
            leases=self.leases,
            controller=self._controller,
            liveness=self.liveness,
            publish=self.events.publish,
            state_wait_ms=self._config.state_wait_ms,
            closing=self.ended.is_set,
        )

    def _plans(self) -> Plans:
        parts = self._parts
        return Plans(
            self.gate.enforcer,
            parts.binder,
            reader=parts.reader,
            contexts=PlannerContexts(parts.binder, parts.channels),
            leases=self.leases,
            proposals=ProposalRegistry(self.gate.ledger, self._config.disclosure),
            foresight=self._foresight,
            disclosure=self._config.disclosure,
            shadow=self._config.mode is Mode.SHADOW,
            later=self._later,
            decided=self._notices.decided,
            ended=self._notices.ended,
            answered=self._queue.done,
        )

    def begin(self) -> None:
        """Report a store that was put back, and an emergency journal that is not authentic."""
        self.log_maintenance.begin()
        if self._parts.emergency is not None and self._parts.emergency.log.strange:
            self.liveness.alert(STRANGE, self._parts.emergency.log.strange)

    def look(self) -> None:
        """Look at every open lease, and at everything that waits for the robot."""
        self.leases.look()
        self._braking.look()  # a stop is answered before any step is looked at
        self._foresight.look()
        if self.emergencies is not None:
            self.emergencies.look()

    # connections

    @property
    def config(self) -> GateConfig:
        """The signed configuration."""
        return self._config

    def connect(self) -> ServerSession:
        """Return the protocol of a new connection."""
        session = ServerSession(self, asyncio.get_running_loop().call_later)
        self._sessions.add(session)
        return session

    def count(self, uid: int) -> int:
        """Return how many connections a user has, with the one that asks."""
        self._users[uid] += 1
        return self._users[uid]

    def welcome(self, hello: Hello) -> Welcome:
        """Return the answer to a hello, with the proof that its nonce asks for."""
        digests = {"site": self.gate.facts.digest, "binding": self._parts.binder.digest}
        return welcome_of(hello, self._config, self._parts.signer, **digests)

    def entered(self, client: ServedClient) -> None:
        """Take a client in; the first controller keeps its place.

        Raises:
            ControllerError: there is a controller already.
        """
        if client.role is ClientRole.CONTROLLER and self._controller is not None:
            self._controller.attach(client.tell)
        self._clients.add(client)
        self._hear(client)
        self.events.client(client, here=True)

    def came(self, client: ServedClient, item: Frame, *, alone: bool) -> None:
        """Let a frame wait for its turn; serve it now when it comes alone and nothing waits."""
        self._hear(client)
        if item.kind is Kind.STOP:  # before every turn
            self._braking.came(client, item, self.refused)
            return
        at_once = alone and not self._queue and not self._turning
        self._queue.came(client, item)
        if at_once:
            self._turn()
        else:
            self._turn_soon()

    def reads(self, client: ServedClient) -> None:
        """Serve what waits of a client that was put aside: it reads again, or it is gone."""
        self._queue.reads(client)
        self._turn_soon()

    def left(self, session: ServerSession, client: ServedClient | None) -> None:
        """Let a connection go; a controller that goes is looked at at once."""
        self._sessions.discard(session)
        self._users[session.uid] -= 1
        self._users = +self._users  # who has none is forgotten
        if client is None or client not in self._clients:
            return
        self._clients.discard(client)
        if client.role is ClientRole.CONTROLLER and self._controller is not None:
            self._controller.detach()
            self.look()
        self.events.client(client, here=False)

    def refused(self, name: Identifier, error: AuthGuardError) -> None:
        """Record a request, or a connection, that was refused before it was read."""
        self.queries.counted["refused"] += 1
        made, dedup_key = (
            partial(refusal_entry, error, client=name),
            (name, error.reason, error.where),
        )
        quietly(lambda: self.gate.ledger.refuse(made, dedup_key=dedup_key))

    # turns

    def _turn_soon(self) -> None:
        if not self._turning:
            self._turning = True
            asyncio.get_running_loop().call_soon(self._turn)

    def _turn(self) -> None:
        """Serve one urgent request and one other, then let the loop read."""
        self._turning = False
        if self._advance is not None and not self.leases:
            self._look()  # what is asked is asked of now
        for client, item in self._queue.take():
            try:
                if isinstance(item, Frame):
                    self._serve(client, item)
                else:
                    item()
            except Exception as error:  # noqa: BLE001 - a fault of ours costs this client alone
                name = type(error).__name__
                self.refused(client.name, AuthGuardError(name, reason=Reason.INTERNAL_FAULT))
                client.line.drop("a fault of the gate's own")
        if self._queue:
            self._turn_soon()
        if self._advance is not None and self.leases:
            self._look()

    def _serve(self, client: ServedClient, item: Frame) -> None:
        """Serve a request; what the last run left open is settled with the first snapshot."""
        self._dispatcher.serve(client, item)
        if self._recovery.after(item.kind):
            self._recovered()

    def _settle_before(self, kind: Kind) -> None:
        if self._closing and kind in {Kind.PROPOSE, Kind.EMERGENCY}:
            _refuse_all()
        if self._recovery.before(kind):
            self._recovered()

    def _recovered(self) -> None:
        """Publish the state of the mission of a gate that did not end cleanly."""
        self.queries.mission.changed()
        if self._recovery.unclean:
            status = self.queries.mission.status
            self.events.publish({"event": "recovery", "unclean": True, "status": status})

    def _later(self, client: ServedClient, act: Callable[[], None], *, first: bool = False) -> None:
        self._queue.put(client, act, first=first)
        self._turn_soon()

    def _shed(self, client: ServedClient) -> None:
        """Count a proposal that was shed; a row of them is one refusal in the log."""
        self.queries.counted["shed"] += 1
        if client.shed == 1:
            self.refused(client.name, EnvironmentFault("shed unread", reason=Reason.BUSY))

    def _hear(self, client: ServedClient) -> None:
        client.heard_ms = self.gate.ledger.mono_ms()
        self.liveness.hear(client.role)

    # the clocks

    async def run(self) -> None:
        """Keep the clocks going until it is time to end, then stop the robot and write it down."""
        clocks = [
            asyncio.create_task(every(LIMITS.look_s, self._look)),
            asyncio.create_task(every(LIMITS.flush_s, self._flush)),
            asyncio.create_task(every(LIMITS.listen_s, self._listen)),
            asyncio.create_task(every(LIMITS.maintenance_s, self.log_maintenance.look)),
            asyncio.create_task(every(LIMITS.shred_s, self.retention.look)),
        ]
        self.events.start(self._config, unclean=self._recovery.unclean)
        try:
            await first(self.ended, clocks)
        finally:
            for clock in clocks:
                clock.cancel()
            await self._come_to_rest()

    def _look(self) -> None:
        if self._advance is not None:
            self._advance(bool(self.leases))
        self.look()
        if self._advance is not None and self.leases:
            self._turn_soon()  # simulated time passes as fast as it can be watched

    def _flush(self) -> None:
        """Write down what waits: outcomes first, then refusals."""
        if self.gate.watch.settle_owed():
            self.queries.mission.changed()
        quietly(self.gate.ledger.flush)

    def _listen(self) -> None:
        """Once a second: recovery that is late, silence, the clock, the journal's counts."""
        if self._recovery.late(self.queries.uptime_ms):
            self._recovered()
        self.liveness.check(
            active=self.queries.mission.runs and self._config.mode is Mode.ENFORCE,
            controller=self._controller is None or self._controller.connected,
            estimator=self._advance is None,
            **self.queries.ledger_state(),
        )
        self._questions.listen()
        self._parts.journal.counts(self.queries.counted, self.gate.ledger.mono_ms())

    async def _come_to_rest(self) -> None:
        """Stop what moves, wait for it to stand, and end every connection."""
        self._closing = True
        # a next step, and a plan that is being read
        self.gate.enforcer.require(_refuse_all, first=True)
        self._foresight.close()
        if self.leases:
            self.gate.enforcer.stop(by=Identifier("gate"), is_planner=False)
        loop = asyncio.get_running_loop()
        until = loop.time() + self._config.stand_within_ms / 1_000
        while self.leases and loop.time() < until:
            self._look()
            await asyncio.sleep(LIMITS.look_s / 5)
        self.events.publish({"event": "end", "robot": self._config.robot})
        for session in tuple(self._sessions):
            session.end()
        self._parts.reader.close()
        self._braking.end()
        self._flush()


def _refuse_all() -> None:
    """Refuse every decision: the robot was stopped, and no loop would watch a lease.

    Raises:
        EnvironmentFault: always (`STOPPED`).
    """
    raise EnvironmentFault("the gate ends", reason=Reason.STOPPED, where="gate")
