# SPDX-License-Identifier: Apache-2.0
"""What the stop process does with every byte and every moment, without a socket.

The process around it (`server`) moves bytes and asks the clock. A stop goes to the controllers
before anything else happens; records, proofs and files come when no stop waits. Spec page:
docs/spec/gate-protocol.md#stop-lane
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from contextlib import suppress

from msgspec import Struct

from authguard_r.access.gate_config import GateConfig, roles_of
from authguard_r.access.handshake import welcome_of
from authguard_r.access.peers import OVERFLOW_UID, client_role
from authguard_r.core.errors import (
    AuthenticityError,
    AuthGuardError,
    EnvironmentFault,
    MalformedError,
)
from authguard_r.core.identifiers import RobotId
from authguard_r.core.principals import Signer
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.estop.stop_queue import Backlog
from authguard_r.estop.stops import ControllerConnection, Settled, Stops
from authguard_r.wire.faults import to_fault
from authguard_r.wire.frames import Frame, FrameReader, frame, read_body
from authguard_r.wire.messages import (
    BOUND,
    PROTOCOL,
    ClientRole,
    Halt,
    Heard,
    Hello,
    Kind,
    Nothing,
    Stood,
    Stop,
    StopHeard,
    Stopped,
    opening_bound,
)
from authguard_r.wire.stop_limits import LIMITS


class EStopPeer:
    """One connection.

    The process reads from it while it `is_heard`, sends `out`, and closes it once it `is_ending`
    and what was left could be sent.
    """

    def __init__(self, uid: int, due_ms: int) -> None:
        self.uid = uid
        self.role: ClientRole | None = None
        self.client = ""
        self.reader = FrameReader(opening_bound)
        self.out = bytearray()
        self.due_ms: int | None = due_ms
        self.asked: deque[Frame] = deque()
        self.is_busy = False
        self.is_ending = False
        self.is_gone = False
        self.brake: ControllerConnection | None = None
        self.unproved: Hello | None = None  # what it is welcomed for, with a proof

    @property
    def is_heard(self) -> bool:
        """False while what it asked already waits for its turn: one stop of a client at a time."""
        return not (self.is_busy or self.is_ending or self.asked)


class StopRequest(Struct, frozen=True):
    """One stop as it was asked for."""

    peer: EStopPeer
    number: int
    stop: Stop
    time_ms: int


class SyncQuestion(Struct, frozen=True):
    """A gate's question whether it knows of every stop that came before."""

    number: int
    begun: int


class Dropped(Struct, frozen=True):
    """Why connections of one user were ended."""

    uid: int
    code: str
    where: str


class EStopDispatcher:
    """Every connection of one stop process.

    Args:
        robot: whose stop process this is.
        config: who may be what; read once.
        own_uid: the stop process's own user, the only one that may be the gate.
        signer: the gate's own key.
        journal: stops for the gate.
    """

    def __init__(
        self, robot: RobotId, config: GateConfig, *, own_uid: int, signer: Signer, journal: Backlog
    ) -> None:
        self.journal = journal
        self.dropped: Counter[Dropped] = Counter()
        self.touched: list[EStopPeer] = []
        self._robot = robot
        self._config = config
        self._own_uid = own_uid
        self._signer = signer
        self._peers: set[EStopPeer] = set()
        self._due: set[EStopPeer] = set()
        self._ready: deque[EStopPeer] = deque()
        self._users: Counter[int] = Counter()
        self._stops: Stops[StopRequest] = Stops()
        self._gate: EStopPeer | None = None
        self._asking: deque[SyncQuestion] = deque()
        self._unproved: deque[EStopPeer] = deque()

    @property
    def is_waiting(self) -> bool:
        """True while a client waits for the end of a stop."""
        return self._stops.is_waiting

    @property
    def is_lively(self) -> bool:
        """True while time alone can make something happen."""
        return self._stops.is_under_way or bool(self._due)

    @property
    def has_work(self) -> bool:
        """True while `work` has something to do."""
        return bool(self._unproved or self._ready)

    @property
    def has_gate(self) -> bool:
        """True while a gate takes the stops."""
        return self._gate is not None

    def open(self, uid: int, now: Now) -> EStopPeer:
        """Return the state of a new connection; it may be ending already."""
        peer = EStopPeer(uid, now.mono_ms + LIMITS.whole_within_ms)
        self._peers.add(peer)
        self._due.add(peer)
        self._users[uid] += 1
        if uid == OVERFLOW_UID or not (uid == self._own_uid or roles_of(self._config, uid)):
            self._end(peer, _denied(f"user {uid} may be nothing here"))
        elif self._users[uid] > self._config.connections or len(self._peers) > LIMITS.connections:
            self._end(peer, _busy("too many connections"))
        return peer

    def received(self, peer: EStopPeer, data: bytes, now: Now) -> None:
        """Take in bytes of any client; a fault ends this connection alone."""
        try:
            peer.reader.put(data)
            while (item := peer.reader.next()) is not None:
                peer.asked.append(item)
                if peer.role is None:
                    self._serve(peer, now)  # a hello changes the bounds of what follows it
            self._serve(peer, now)
        except AuthGuardError as error:
            self._end(peer, error)
            return
        if peer.role is not None:
            self._mark(peer, now)

    def close(self, peer: EStopPeer, now: Now) -> None:
        """Forget a connection that ended; a second call does nothing.

        A stop that came whole is carried out and recorded all the same: its client may have left
        because no answer came.
        """
        if peer.is_gone:
            return
        left, peer.asked = peer.asked, deque()
        peer.is_gone = peer.is_ending = True
        self._peers.discard(peer)
        self._due.discard(peer)
        self._users -= Counter((peer.uid,))
        if peer is self._gate:
            self._gate = None
            self._asking.clear()
        if peer.brake is not None:
            self._stops.leave(peer.brake)
            self._settle(now)
        for item in left:
            if item.kind is Kind.STOP:
                with suppress(MalformedError):
                    self._stop(peer, read_body(item.body, Stop), item.id, now)

    def tick(self, now: Now) -> None:
        """Do what is due: repeat `HALT`, answer unconfirmed stops, end silent connections."""
        self._stops.remind(now.mono_ms)
        self._settle(now)
        late = [p for p in self._due if p.due_ms is not None and p.due_ms <= now.mono_ms]
        for peer in late:
            self._end(peer, MalformedError("expected a whole message in time", where="frame"))

    def work(self, now: Now) -> None:
        """Do what was put off: one more stop of each client that sent several, and one proof.

        A signature takes as long as many stops, so that stops come between any two.
        """
        for _ in range(len(self._ready)):
            peer = self._ready.popleft()
            try:
                self._serve(peer, now)
            except AuthGuardError as error:
                self._end(peer, error)
        if self._unproved:
            self._prove(self._unproved.popleft(), now)

    def _serve(self, peer: EStopPeer, now: Now) -> None:
        """Carry out what a client asked, at most one stop: then it is the others' turn."""
        while peer.asked and not (peer.is_busy or peer.is_ending):
            item = peer.asked.popleft()
            if item.kind is Kind.STOP:
                self._stop(peer, read_body(item.body, Stop), item.id, now)
                return
            if item.kind is Kind.STOOD:
                self._stood(peer, read_body(item.body, Stood), item.id, now)
            elif item.kind is Kind.HEARD:
                self._heard(read_body(item.body, Heard))
            elif item.kind is Kind.SYNC:
                self._sync(peer, read_body(item.body, Nothing), item.id)
            else:
                self._hello(peer, read_body(item.body, Hello), now)

    def _stop(self, peer: EStopPeer, stop: Stop, number: int, now: Now) -> None:
        peer.is_busy = True
        self._stops.stop(StopRequest(peer, number, stop, now.utc_ms), now.mono_ms)
        self._settle(now)

    def _stood(self, peer: EStopPeer, stood: Stood, number: int, now: Now) -> None:
        if peer.brake is not None:
            self._stops.stood(peer.brake, number, said=stood, now_ms=now.mono_ms)
            self._settle(now)

    def _heard(self, heard: Heard) -> None:
        if not self.journal.heard(heard.n):
            raise MalformedError("this stop was never sent", where="heard.n")
        self._tell_gate()

    def _sync(self, peer: EStopPeer, _: Nothing, number: int) -> None:
        """Answer once this gate was sent every suspending stop that came before its question."""
        if peer is self._gate:
            self._asking.append(SyncQuestion(number, self._stops.begun))
            self._tell_gate()

    def _hello(self, peer: EStopPeer, hello: Hello, now: Now) -> None:
        if hello.protocol != PROTOCOL:
            raise MalformedError(f"expected the protocol `{PROTOCOL}`", where="hello.protocol")
        if peer.role is not None:
            raise MalformedError("a second hello came", where="frame.kind")
        if hello.role is not ClientRole.GATE:
            client_role(self._config, peer.uid, hello.role)
        elif peer.uid != self._own_uid:
            raise _denied(f"user {peer.uid} may not be `{hello.role}` here")
        peer.role, peer.client = hello.role, hello.client
        peer.reader.bound = frame_bound(hello.role)
        if hello.nonce is None:
            self._welcome(peer, hello, now)
        else:
            peer.unproved = hello
            self._unproved.append(peer)

    def _prove(self, peer: EStopPeer, now: Now) -> None:
        """Welcome a client that waits for a proof, unless that came first of a stop of its own."""
        hello, peer.unproved = peer.unproved, None
        if hello is not None:
            self._welcome(peer, hello, now)

    def _welcome(self, peer: EStopPeer, hello: Hello, now: Now) -> None:
        if peer.is_ending:
            return
        self._send(peer, Kind.WELCOME, 0, welcome_of(hello, self._config, self._signer))
        if hello.role is ClientRole.CONTROLLER:
            peer.brake = ControllerConnection(
                lambda number: self._send(peer, Kind.HALT, number, Halt()), lambda: not peer.out
            )
            self._stops.join(peer.brake, now.mono_ms)
        elif hello.role is ClientRole.GATE:
            if self._gate is not None:
                self._end(self._gate, _busy("another gate has connected"))
            self._gate = peer
            self._asking.clear()
            self.journal.begin()
            self._tell_gate()

    def _settle(self, now: Now) -> None:
        """Answer every stop that is over, then keep it for the gate."""
        over = self._stops.settled(now.mono_ms)
        for settled in over:
            self._prove(settled.asked.peer, now)
            self._answer(settled)
        for settled in over:
            self._keep(settled)
        if over:
            self._tell_gate()

    def _answer(self, settled: Settled[StopRequest]) -> None:
        peer = settled.asked.peer
        answer = Stopped(
            stopped=settled.stopped, controller=settled.controller, after_ms=settled.after_ms
        )
        self._send(peer, Kind.REPLY, settled.asked.number, answer)
        peer.is_busy = False
        if peer.asked:
            self._ready.append(peer)

    def _keep(self, settled: Settled[StopRequest]) -> None:
        asked = settled.asked
        if asked.peer.role is None:  # pragma: no cover - nobody asks before a hello
            raise RuntimeError("a stop without a client was carried out")
        self.journal.add(
            StopHeard(
                epoch=self.journal.epoch,
                n=self.journal.next_n,
                by=asked.peer.client,
                uid=asked.peer.uid,
                role=asked.peer.role,
                time_ms=asked.time_ms,
                why=asked.stop.why,
                key=asked.stop.key,
                stood_ms=settled.after_ms if settled.stopped else None,
                stops=None if settled.said is None else settled.said.stops,
                life=0 if settled.said is None else settled.said.life,
            )
        )

    def _tell_gate(self) -> None:
        gate = self._gate
        if gate is None:
            return
        for stop in self.journal.to_send():
            self._send(gate, Kind.EVENT, 0, stop)
        if self.journal.is_told:
            while self._asking and self._asking[0].begun <= self._stops.over:
                self._send(gate, Kind.REPLY, self._asking.popleft().number, Nothing())

    def _mark(self, peer: EStopPeer, now: Now) -> None:
        """Give a message that has begun its time, from its first byte on."""
        if not peer.reader.unfinished:
            peer.due_ms = None
            self._due.discard(peer)
        elif peer.due_ms is None:
            peer.due_ms = now.mono_ms + LIMITS.whole_within_ms
            self._due.add(peer)

    def _send(self, peer: EStopPeer, kind: Kind, number: int, body: object) -> None:
        if peer.is_ending:
            return
        peer.out += frame(kind, number, body)
        self.touched.append(peer)
        if len(peer.out) > (
            LIMITS.unread_gate_bytes if peer is self._gate else LIMITS.unread_bytes
        ):
            self._end(peer, _busy("the client does not read"))

    def _end(self, peer: EStopPeer, error: AuthGuardError) -> None:
        """Tell a client why, as far as it listens, and let it go."""
        if peer.is_ending:
            return
        peer.is_ending = True
        peer.out += frame(Kind.ERROR, 0, to_fault(error))
        self.touched.append(peer)
        self.dropped[Dropped(peer.uid, str(error.reason), error.where)] += 1


def frame_bound(role: ClientRole) -> Callable[[int], int]:
    """Return the longest body of each kind that a role may send to the stop process.

    Every connection but the controller's and the gate's may stop, and do nothing else.
    """
    kinds = {ClientRole.CONTROLLER: (Kind.STOOD,), ClientRole.GATE: (Kind.HEARD, Kind.SYNC)}
    known = {int(kind): BOUND[kind] for kind in kinds.get(role, (Kind.STOP,))}
    return lambda kind: known.get(kind, 0)


def _denied(message: str) -> AuthenticityError:
    return AuthenticityError(message, reason=Reason.ROLE_DENIED, where="peer")


def _busy(message: str) -> EnvironmentFault:
    return EnvironmentFault(message, reason=Reason.BUSY, where="connection")
