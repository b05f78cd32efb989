# SPDX-License-Identifier: Apache-2.0
"""A client that waits: one blocking Unix socket, no threads, no event loop.

Its methods are named as the in-process enforcer's and its management's are.
Spec page: docs/spec/gate-protocol.md
"""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from time import monotonic, sleep
from types import TracebackType
from typing import Any, Self

from authguard_r.client.approvals import asking, read_questions, signed_answer, the_one
from authguard_r.client.blocking_stop import OwnLine, stop_now
from authguard_r.client.handshake import GateVerifier, Handshake
from authguard_r.client.session import ClientSession, SentRequest, answer_of, done_of, unreachable
from authguard_r.client.start import CHUNK, TIMEOUT_MS, begin, fresh, late, unanswered
from authguard_r.core.approval import ApprovalVerdict
from authguard_r.core.errors import RefusedError
from authguard_r.core.identifiers import Digest, RobotId
from authguard_r.core.principals import Signer
from authguard_r.core.reasons import Reason
from authguard_r.wire.approval_request import Question
from authguard_r.wire.frames import Frame
from authguard_r.wire.messages import (
    Attest,
    ClientRole,
    Close,
    Emergency,
    Evaluate,
    Explain,
    Kind,
    Nothing,
    Observe,
    Order,
    OrderKind,
    Propose,
    Records,
    Sample,
    Welcome,
)
from authguard_r.wire.sockets import AGAIN_S


class GateClient:
    """One connection to a gate, or to its stop process. Not for two threads at once.

    A timeout ends the waiting, not the request: what the gate does about it goes on. To learn of
    it, ask again under the same key.

    Args:
        line: a connected socket; it belongs to the client from now on.
        session: fresh, made for this connection.
        path: the socket that it leads to.
        timeout_ms: longest time to wait for an answer.
    """

    def __init__(
        self, line: socket.socket, session: ClientSession, *, path: Path, timeout_ms: int
    ) -> None:
        self._line = line
        self._path = path
        self._session = session
        self._timeout_ms = timeout_ms
        self._streams: dict[Digest, int] = {}

    @classmethod
    def connect(
        cls,
        path: Path,
        *,
        role: ClientRole,
        client: str | None = None,
        verifier: GateVerifier | None = None,
        robot: RobotId | None = None,
        allow_shadow: bool = False,
        timeout_ms: int = TIMEOUT_MS,
    ) -> Self:
        """Return a client that the gate has welcomed.

        Args:
            path: the socket.
            role: what to be there.
            client: the name in the gate's log; the role's when absent.
            verifier: with one, the gate proves that it holds its key.
            robot: whose gate it must be; None takes any.
            allow_shadow: take a gate that releases nothing, as a planner or controller.
            timeout_ms: longest time to wait for this and for every answer.

        Raises:
            EnvironmentFault: no process listens there, or no answer came in time.
            AuthenticityError: not the gate that was meant, or the role is not this user's.
            RefusedError: the gate is in shadow mode.
            MalformedError: what answers is no gate.
        """
        handshake = Handshake(
            role=role,
            client=client if client is not None else str(role),
            verifier=verifier,
            robot=robot,
            allow_shadow=allow_shadow,
        )
        line = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        made = cls(line, begin(handshake), path=path, timeout_ms=timeout_ms)
        try:
            made._open()
        except BaseException:
            made.close()
            raise
        return made

    @property
    def welcome(self) -> Welcome:
        """What the gate said of itself."""
        welcome = self._session.welcome
        if welcome is None:  # pragma: no cover - `connect` returns after the welcome
            raise RuntimeError("the gate has not welcomed this client")
        return welcome

    def propose(
        self,
        plan: bytes,
        *,
        dialect: str = "auto",
        key: str | None = None,
        on_step: Callable[[dict[str, Any]], object] | None = None,
        timeout_ms: int | None = None,
        repair: bool = False,
    ) -> dict[str, Any]:
        """Have a plan decided and carried out; return the report of every step.

        Args:
            plan: exactly what the planner wrote.
            dialect: how it is written.
            key: names the proposal; the same key again returns what is recorded. Fresh when absent.
            on_step: called with each step's decision while the plan goes on.
            timeout_ms: longest time to wait; None waits as long as the robot moves.
            repair: let the gate decide the repair of a step that only the safety gate refused,
                once, like a new proposal; the step's report then has `repairs`.

        Raises:
            AuthGuardError: nothing was decided under this key.
        """
        own = key if key is not None else fresh()
        message = Propose(key=own, plan=plan, dialect=dialect, repair=repair)
        return self._ask(Kind.PROPOSE, message, on_event=on_step, timeout_ms=timeout_ms)

    def open_stream(self, plan: bytes, *, dialect: str = "auto", key: str | None = None) -> Digest:
        """Propose one velocity for a time; return the release that `sample` then changes.

        Raises:
            RefusedError: it was not released; the message holds the report.
            AuthGuardError: as `propose`.
        """
        message = Propose(key=key if key is not None else fresh(), plan=plan, dialect=dialect)
        sent = self._session.request(Kind.PROPOSE, message)
        deadline = _deadline(self._timeout_ms)
        self._send(sent.data, deadline)
        said = answer_of(self._next(sent.number, deadline, self._timeout_ms))
        if "ticket" not in said:
            raise RefusedError(f"not released: {said}", reason=Reason.LEASE_ENDED, where="stream")
        ticket = Digest(said["ticket"])
        self._streams[ticket] = sent.number
        return ticket

    def sample(self, ticket: Digest, params: dict[str, int]) -> bool:
        """Change an open stream's velocities; False when zero was sent in their place."""
        said = self._quick(Kind.SAMPLE, Sample(ticket=ticket, params=params))
        return said.get("forwarded") is True

    def close_stream(self, ticket: Digest) -> None:
        """End an open stream; `stream_ended` says how it ended."""
        self._quick(Kind.CLOSE, Close(ticket=ticket))

    def stream_ended(self, ticket: Digest) -> dict[str, Any]:
        """Wait for a stream's end and return the plan's final answer."""
        number = self._streams.pop(ticket)
        return answer_of(self._next(number, _deadline(self._timeout_ms), self._timeout_ms))

    def emergency(
        self, capability: str, *, key: str | None = None, timeout_ms: int | None = None
    ) -> dict[str, Any]:
        """Call a capability of the emergency policy; return its result.

        Args:
            capability: which; the policy says the rest.
            key: names the call; the same key again returns the same answer. Fresh when absent.
            timeout_ms: longest time to wait; None waits as long as the robot moves.
        """
        message = Emergency(key=key if key is not None else fresh(), capability=capability)
        return self._ask(Kind.EMERGENCY, message, on_event=None, timeout_ms=timeout_ms)

    def observe(self, channel: str, text: str) -> None:
        """Tell the gate what the planner was shown, before it proposes."""
        self._quick(Kind.OBSERVE, Observe(channel=channel, text=text))

    @property
    def fence(self) -> int:
        """The newest fence that has come: what is measured after it is read carries it."""
        return self._session.fence

    def attest(self, token: bytes) -> None:
        """Hand in a signed snapshot; fences come with the answer."""
        self._quick(Kind.SNAPSHOT, Attest(token=token))

    def activate(self, token: bytes, *, confirmation: bytes | None = None) -> dict[str, Any]:
        """Take in a signed mission and make it active; return its standing."""
        return self._order(OrderKind.ACTIVATE, token, confirmation)

    def issue(self, token: bytes, *, confirmation: bytes | None = None) -> dict[str, Any]:
        """Hand in a signed mission without activating it; return its standing."""
        return self._order(OrderKind.ISSUE, token, confirmation)

    def command(self, token: bytes) -> dict[str, Any]:
        """Carry out a signed command; return the mission's standing."""
        return self._order(OrderKind.COMMAND, token)

    def select(self, token: bytes) -> dict[str, Any]:
        """Take in a signed choice of one row; return the mission's standing."""
        return self._order(OrderKind.SELECT, token)

    def approve(self, token: bytes, *, why: str = "") -> dict[str, Any]:
        """Hand in a signed answer to an approval request; return what it is worth.

        Args:
            token: the signed answer.
            why: the approver's words, for the log; no planner hears of them.
        """
        return self._quick(Kind.ORDER, Order(act=OrderKind.APPROVE, token=token, why=why))

    def approvals(self) -> tuple[Question, ...]:
        """Return every open approval request of the active mission."""
        return read_questions(self._quick(Kind.APPROVALS, asking())).requests

    def approval(self, counter: int) -> Question:
        """Return the open request with this number; `client.shown` reads its bytes.

        Raises:
            RefusedError: no open request has it.
        """
        return the_one(read_questions(self._quick(Kind.APPROVALS, asking(counter))), counter)

    def answer(
        self, question: Question, verdict: ApprovalVerdict, signer: Signer, *, why: str = ""
    ) -> dict[str, Any]:
        """Sign an answer to a request as it was shown and hand it in; return what it is worth.

        Args:
            question: the request, from `approval` or `approvals`.
            verdict: approve or deny; a denial gives a reason.
            signer: the approver's key.
            why: for the log; no planner hears of it.

        Raises:
            AuthGuardError: the text differs from the bytes to sign, or the gate refused it.
        """
        return self._quick(Kind.ORDER, signed_answer(question, verdict, signer, why=why))

    def template(self, token: bytes, *, confirmation: bytes | None = None) -> dict[str, Any]:
        """Take in a signed mission template, or withdraw one; return its standing."""
        return self._order(OrderKind.TEMPLATE, token, confirmation)

    def revocations(self, signed: bytes) -> dict[str, Any]:
        """Hand in an authority's next revocation list; return what was taken in."""
        return self._order(OrderKind.REVOCATIONS, signed)

    def accept_store(self, token: bytes) -> dict[str, Any]:
        """Hand in a signed order to go on with a store that was put back; return what became."""
        return self._order(OrderKind.ACCEPT_STORE, token)

    def shred(self, token: bytes) -> dict[str, Any]:
        """Hand in a signed order to destroy sealed fields of the log; return what has begun."""
        return self._order(OrderKind.SHRED, token)

    def evaluate(self, plan: bytes, *, dialect: str = "auto") -> dict[str, Any]:
        """Return what the gate would decide; nothing is used, recorded or released."""
        return self._quick(Kind.EVALUATE, Evaluate(plan=plan, dialect=dialect))

    def status(self) -> dict[str, Any]:
        """Return the robot, its mission, its open leases and who was last heard."""
        return self._quick(Kind.STATUS, Nothing())

    def records(self, first: int, count: int = 100) -> dict[str, Any]:
        """Return a page of the log."""
        return self._quick(Kind.RECORDS, Records(first=first, count=count))

    def explain(self, seq: int | None = None) -> dict[str, Any]:
        """Return why a record says what it says; without a number, the last refusal."""
        return self._quick(Kind.EXPLAIN, Explain(seq=seq))

    def metrics(self) -> dict[str, Any]:
        """Return the gate's counts; they hold nothing of any mission."""
        return self._quick(Kind.METRICS, Nothing())

    def watch(self, *, idle_ms: int | None = None) -> Iterator[dict[str, Any]]:
        """Return what happens from now on, as it happens.

        Args:
            idle_ms: longest time between two events; None waits for ever.
        """
        sent = self._session.request(Kind.WATCH, Nothing(), stays=True)
        self._final(sent, None, self._timeout_ms)
        return self._events(sent.number, idle_ms)

    def stop(self, why: str = "") -> dict[str, Any]:
        """Brake and hold: over this connection, and by the other part of this gate at once.

        It asks on until the robot stands. It gives up when the client's `timeout_ms` is over, when
        a controller does not say so within 10 s, or when none is connected for 5 s.

        Args:
            why: for the log; decides nothing.

        Returns:
            Whether a controller was there and said that the robot stands, and after how long.

        Raises:
            AuthGuardError: no answer came in time.
        """
        own = OwnLine(self._line, self._session)
        return stop_now(self._path, own, why=why, within_ms=self._timeout_ms)

    def close(self) -> None:
        """Let go of the connection."""
        self._session.end(unreachable("the connection was closed here"))
        self._line.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _open(self) -> None:
        deadline = _deadline(self._timeout_ms)
        try:
            self._reach(monotonic() + self._timeout_ms / 1_000)
        except (OSError, ValueError) as error:
            raise unanswered(error, self._path) from error
        self._send(self._session.hello(), deadline)
        while self._session.welcome is None:
            self._session.require_open()
            self._receive(deadline, self._timeout_ms)
        self._session.require_open()

    def _reach(self, until: float) -> None:
        """Connect; a socket whose queue is full is tried again."""
        self._line.settimeout(0)
        while True:
            try:
                self._line.connect(str(self._path))
            except BlockingIOError:
                if monotonic() >= until:
                    raise
                sleep(AGAIN_S)
            else:
                return

    def _order(
        self, act: OrderKind, token: bytes, confirmation: bytes | None = None
    ) -> dict[str, Any]:
        order = Order(act=act, token=token, confirmation=confirmation)
        return done_of(act, self._quick(Kind.ORDER, order))

    def _quick(self, kind: Kind, message: object) -> dict[str, Any]:
        return self._ask(kind, message, on_event=None, timeout_ms=self._timeout_ms)

    def _ask(
        self,
        kind: Kind,
        message: object,
        *,
        on_event: Callable[[dict[str, Any]], object] | None,
        timeout_ms: int | None,
    ) -> dict[str, Any]:
        return self._final(self._session.request(kind, message), on_event, timeout_ms)

    def _final(
        self,
        sent: SentRequest,
        on_event: Callable[[dict[str, Any]], object] | None,
        timeout_ms: int | None,
    ) -> dict[str, Any]:
        """Send a request and return its answer; the events before it go to `on_event`."""
        deadline = _deadline(timeout_ms)
        try:
            self._send(sent.data, _deadline(self._timeout_ms))
            while True:
                item = self._next(sent.number, deadline, timeout_ms)
                said = answer_of(item)
                if item.kind is Kind.REPLY:
                    return said
                if on_event is not None:
                    on_event(said)
        except BaseException:
            self._session.abandon(sent.number)
            raise

    def _events(self, number: int, idle_ms: int | None) -> Iterator[dict[str, Any]]:
        try:
            while True:
                yield answer_of(self._next(number, _deadline(idle_ms), idle_ms))
        finally:
            self._session.abandon(number)

    def _next(self, number: int, deadline: float | None, timeout_ms: int | None) -> Frame:
        while True:
            item = self._session.take(number)
            if item is not None:
                return item
            self._receive(deadline, timeout_ms)

    def _receive(self, deadline: float | None, timeout_ms: int | None) -> None:
        """Take in what comes next, or note that nothing will."""
        left = None if deadline is None else max(deadline - monotonic(), 0.001)
        self._line.settimeout(left)
        try:
            data = self._line.recv(CHUNK)
        except TimeoutError as error:
            raise late(timeout_ms) from error
        except OSError as error:
            self._session.end(unreachable(f"the connection failed: {error.strerror or error}"))
            return
        if data:
            self._session.receive(data)
        else:
            self._session.end()

    def _send(self, data: bytes, deadline: float | None) -> None:
        """Send all of it; when the gate hung up, what it said before is still read."""
        left = None if deadline is None else max(deadline - monotonic(), 0.001)
        self._line.settimeout(left)
        try:
            self._line.sendall(data)
        except TimeoutError as error:  # half of it may be out: nothing sensible can follow
            self._session.end(late(self._timeout_ms))
            raise late(self._timeout_ms) from error
        except OSError:
            while self._session.broken is None:
                self._receive(deadline, self._timeout_ms)


def _deadline(timeout_ms: int | None) -> float | None:
    return None if timeout_ms is None else monotonic() + timeout_ms / 1_000
