# SPDX-License-Identifier: Apache-2.0
"""A client for an event loop; many requests may wait at once, and no task runs behind the caller.

Its methods are named as the in-process enforcer's and its management's are.
Spec page: docs/spec/gate-protocol.md
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import msgspec

from authguard_r.client.approvals import asking, read_questions, signed_answer, the_one
from authguard_r.client.handshake import GateVerifier, Handshake, Speaks
from authguard_r.client.line import SessionLine
from authguard_r.client.session import OnEvent, SentRequest, answer_of, done_of, unreachable
from authguard_r.client.start import TIMEOUT_MS, begin, fresh, late, unanswered
from authguard_r.client.stopping import stop_of, stopped_of
from authguard_r.core.approval import ApprovalVerdict
from authguard_r.core.identifiers import RobotId
from authguard_r.core.principals import Signer
from authguard_r.wire.approval_request import Question
from authguard_r.wire.frames import Frame
from authguard_r.wire.messages import (
    Attest,
    ClientRole,
    Evaluate,
    Explain,
    Kind,
    Nothing,
    Observe,
    Order,
    OrderKind,
    Propose,
    Records,
    Stop,
    Stopped,
    Welcome,
)
from authguard_r.wire.sockets import reach


class AsyncGateClient:
    """One connection to a gate, or to its stop process.

    A timeout or a cancellation ends the waiting, not the request: what the gate does about it goes
    on. To learn of it, ask again under the same key.

    Args:
        line: the connection.
        path: the socket that it leads to.
        timeout_ms: longest time to wait for an answer.
    """

    def __init__(self, line: SessionLine, *, path: Path, timeout_ms: int) -> None:
        self._line = line
        self._path = path
        self._session = line.session
        self._timeout_ms = timeout_ms

    @classmethod
    async def connect(
        cls,
        path: Path,
        *,
        role: ClientRole,
        client: str | None = None,
        verifier: GateVerifier | None = None,
        robot: RobotId | None = None,
        allow_shadow: bool = False,
        speaks: Speaks | None = None,
        timeout_ms: int = TIMEOUT_MS,
    ) -> Self:
        """Return a client that the gate has welcomed; arguments and errors as `GateClient`'s.

        `speaks`: the words that the gate has to speak; None takes any.
        """
        handshake = Handshake(
            role=role,
            client=client if client is not None else str(role),
            verifier=verifier,
            robot=robot,
            allow_shadow=allow_shadow,
            speaks=speaks,
        )
        wire = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        made = cls(SessionLine(begin(handshake), wire), path=path, timeout_ms=timeout_ms)
        try:
            async with asyncio.timeout(timeout_ms / 1_000):
                await made._open(wire)
        except TimeoutError as error:
            made._close(wire)
            raise late(timeout_ms) from error
        except BaseException:
            made._close(wire)
            raise
        return made

    @property
    def welcome(self) -> Welcome:
        """What the gate said of itself."""
        welcome = self._session.welcome
        if welcome is None:  # pragma: no cover - `connect` returns after the welcome
            raise RuntimeError("the gate has not welcomed this client")
        return welcome

    @property
    def is_open(self) -> bool:
        """True until the connection has broken."""
        return self._session.broken is None

    async def propose(
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
        return await self._final(self._session.request(Kind.PROPOSE, message), on_step, timeout_ms)

    async def observe(self, channel: str, text: str) -> None:
        """Tell the gate what the planner was shown, before it proposes."""
        await self.ask(Kind.OBSERVE, Observe(channel=channel, text=text))

    @property
    def fence(self) -> int:
        """The newest fence that has come: what is measured after it is read carries it."""
        return self._session.fence

    async def attest(self, token: bytes) -> None:
        """Hand in a signed snapshot; fences come with the answer."""
        await self.ask(Kind.SNAPSHOT, Attest(token=token))

    async def activate(self, token: bytes, *, confirmation: bytes | None = None) -> dict[str, Any]:
        """Take in a signed mission and make it active; return its standing."""
        return await self._order(OrderKind.ACTIVATE, token, confirmation)

    async def issue(self, token: bytes, *, confirmation: bytes | None = None) -> dict[str, Any]:
        """Hand in a signed mission without activating it; return its standing."""
        return await self._order(OrderKind.ISSUE, token, confirmation)

    async def command(self, token: bytes) -> dict[str, Any]:
        """Carry out a signed command; return the mission's standing."""
        return await self._order(OrderKind.COMMAND, token)

    async def select(self, token: bytes) -> dict[str, Any]:
        """Take in a signed choice of one row; return the mission's standing."""
        return await self._order(OrderKind.SELECT, token)

    async def approve(self, token: bytes, *, why: str = "") -> dict[str, Any]:
        """Hand in a signed answer to an approval request; return what it is worth.

        Args:
            token: the signed answer.
            why: the approver's words, for the log; no planner hears of them.
        """
        return await self.ask(Kind.ORDER, Order(act=OrderKind.APPROVE, token=token, why=why))

    async def approvals(self) -> tuple[Question, ...]:
        """Return every open approval request of the active mission."""
        return read_questions(await self.ask(Kind.APPROVALS, asking())).requests

    async def approval(self, counter: int) -> Question:
        """Return the open request with this number; `client.shown` reads its bytes.

        Raises:
            RefusedError: no open request has it.
        """
        return the_one(read_questions(await self.ask(Kind.APPROVALS, asking(counter))), counter)

    async def answer(
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
        return await self.ask(Kind.ORDER, signed_answer(question, verdict, signer, why=why))

    async def template(self, token: bytes, *, confirmation: bytes | None = None) -> dict[str, Any]:
        """Take in a signed mission template, or withdraw one; return its standing."""
        return await self._order(OrderKind.TEMPLATE, token, confirmation)

    async def revocations(self, signed: bytes) -> dict[str, Any]:
        """Hand in an authority's next revocation list; return what was taken in."""
        return await self._order(OrderKind.REVOCATIONS, signed)

    async def accept_store(self, token: bytes) -> dict[str, Any]:
        """Hand in a signed order to go on with a store that was put back; return what became."""
        return await self._order(OrderKind.ACCEPT_STORE, token)

    async def shred(self, token: bytes) -> dict[str, Any]:
        """Hand in a signed order to destroy sealed fields of the log; return what has begun."""
        return await self._order(OrderKind.SHRED, token)

    async def evaluate(self, plan: bytes, *, dialect: str = "auto") -> dict[str, Any]:
        """Return what the gate would decide; nothing is used, recorded or released."""
        return await self.ask(Kind.EVALUATE, Evaluate(plan=plan, dialect=dialect))

    async def status(self) -> dict[str, Any]:
        """Return the robot, its mission, its open leases and who was last heard."""
        return await self.ask(Kind.STATUS, Nothing())

    async def records(self, first: int, count: int = 100) -> dict[str, Any]:
        """Return a page of the log."""
        return await self.ask(Kind.RECORDS, Records(first=first, count=count))

    async def explain(self, seq: int | None = None) -> dict[str, Any]:
        """Return why a record says what it says; without a number, the last refusal."""
        return await self.ask(Kind.EXPLAIN, Explain(seq=seq))

    async def metrics(self) -> dict[str, Any]:
        """Return the gate's counts; they hold nothing of any mission."""
        return await self.ask(Kind.METRICS, Nothing())

    async def watch(self, *, idle_ms: int | None = None) -> AsyncIterator[dict[str, Any]]:
        """Return what happens from now on, as it happens.

        Args:
            idle_ms: longest time between two events; None waits for ever.
        """
        sent = self._session.request(Kind.WATCH, Nothing(), stays=True)
        await self._final(sent, None, self._timeout_ms)
        return self._events(sent.number, idle_ms)

    async def stop(self, why: str = "") -> dict[str, Any]:
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

        async def ask(stop: Stop) -> Stopped:
            return stopped_of(await self.ask(Kind.STOP, stop))

        stop = stop_of(self._path, self._session, ask, why)
        reached = await stop.confirmed(within_ms=self._timeout_ms)
        said: dict[str, Any] = msgspec.to_builtins(reached.answer)
        return said

    async def send(self, kind: Kind, message: object, *, number: int | None = None) -> int:
        """Send a message without waiting for an answer; one that comes is among `frames`.

        Args:
            kind: what it is.
            message: its body.
            number: of the gate's own frame that it answers; a new one when absent.

        Returns:
            Its number, which an answer carries back.
        """
        sent = self._session.loose(kind, message, number=number)
        await self._write(sent.data)
        return sent.number

    async def frames(self) -> AsyncIterator[Frame]:
        """Yield what the gate sends by itself, and what answers `send`, in the order it came.

        Raises:
            AuthGuardError: nothing more comes, and why.
        """
        while True:
            yield await self._wait(self._session.take_pushed, None)

    async def ask(self, kind: Kind, message: object) -> dict[str, Any]:
        """Send a request and return its answer, which comes at once."""
        return await self._final(self._session.request(kind, message), None, self._timeout_ms)

    async def close(self) -> None:
        """Let go of the connection."""
        self._session.end(unreachable("the connection was closed here"))
        self._line.hang_up()
        await self._line.lost()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        await self.close()

    async def _open(self, wire: socket.socket) -> None:
        loop = asyncio.get_running_loop()
        try:
            await reach(wire, self._path)
        except (OSError, ValueError) as error:
            raise unanswered(error, self._path) from error
        await loop.create_unix_connection(lambda: self._line, sock=wire)
        await self._line.write(self._session.hello())
        while self._session.welcome is None:
            self._session.require_open()
            await self._line.changed()
        self._session.require_open()

    def _close(self, wire: socket.socket) -> None:
        self._line.hang_up()
        wire.close()

    async def _order(
        self, act: OrderKind, token: bytes, said: bytes | None = None
    ) -> dict[str, Any]:
        order = Order(act=act, token=token, confirmation=said)
        return done_of(act, await self.ask(Kind.ORDER, order))

    async def _final(
        self, sent: SentRequest, on_event: OnEvent | None, timeout_ms: int | None
    ) -> dict[str, Any]:
        """Send a request and return its answer; the events before it go to `on_event`."""
        loop = asyncio.get_running_loop()
        deadline = None if timeout_ms is None else loop.time() + timeout_ms / 1_000
        try:
            await self._write(sent.data)
            async with asyncio.timeout_at(deadline):
                return await self._answer(sent.number, on_event)
        except BaseException as error:
            self._session.abandon(sent.number)
            if isinstance(error, TimeoutError):
                raise late(timeout_ms) from error
            raise

    async def _answer(self, number: int, on_event: OnEvent | None) -> dict[str, Any]:
        while True:
            item = await self._wait(lambda: self._session.take(number), None)
            said = answer_of(item)
            if item.kind is Kind.REPLY:
                return said
            if on_event is not None:
                on_event(said)

    async def _events(self, number: int, idle_ms: int | None) -> AsyncIterator[dict[str, Any]]:
        try:
            while True:
                yield answer_of(await self._wait(lambda: self._session.take(number), idle_ms))
        finally:
            self._session.abandon(number)

    async def _wait(self, take: Callable[[], Frame | None], idle_ms: int | None) -> Frame:
        """Return the next frame that `take` finds."""
        try:
            async with asyncio.timeout(None if idle_ms is None else idle_ms / 1_000):
                while True:
                    item = take()
                    if item is not None:
                        return item
                    await self._line.changed()
        except TimeoutError as error:
            raise late(idle_ms) from error

    async def _write(self, data: bytes) -> None:
        """Send the bytes; a gate that does not read loses the connection."""
        try:
            async with asyncio.timeout(self._timeout_ms / 1_000):
                await self._line.write(data)
        except TimeoutError as error:
            self._session.end(late(self._timeout_ms))
            self._line.hang_up()
            raise late(self._timeout_ms) from error
