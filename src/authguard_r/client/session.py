# SPDX-License-Identifier: Apache-2.0
"""One connection to a gate, without a socket: bytes go in, answers come out.

Both clients hold one. Each input of a peer ends in an answer to a request that was made, or in one
error that every later call raises again: nothing is guessed and no call waits for ever. Spec page:
docs/spec/gate-protocol.md
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

import msgspec
from msgspec import Struct

from authguard_r.client.handshake import Handshake, hello, require_welcome
from authguard_r.core.errors import (
    AuthenticityError,
    AuthGuardError,
    EnvironmentFault,
    MalformedError,
)
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.wire.faults import from_fault
from authguard_r.wire.frames import Frame, FrameReader, frame, raw_frame, read_body
from authguard_r.wire.messages import (
    BOUND,
    MAX_ANSWER,
    MAY,
    ClientRole,
    Fault,
    Fence,
    Kind,
    OrderKind,
    Welcome,
)

#: Most memory for answers that were not taken yet, in bytes; a frame costs some by itself.
MAX_HELD = 1 << 24
_FRAME_COST = 1_024
#: Longest greeting or error, in bytes.
_SHORT = 1 << 16
#: What a gate sends to a controller without being asked.
PUSHED = frozenset({Kind.DISPATCH, Kind.RENEW, Kind.HALT, Kind.FORWARD})
#: Who receives messages without a request.
_TOLD = frozenset({ClientRole.CONTROLLER, ClientRole.GATE})
_ANSWERS = {Kind.WELCOME: _SHORT, Kind.ERROR: _SHORT, Kind.REPLY: MAX_ANSWER}


class SentRequest(Struct, frozen=True):
    """A request on its way: its number, and the bytes to send."""

    number: int
    data: bytes


class _Exchange:
    """One request and what has come for it.

    Args:
        stays: its answer opens a subscription instead of ending it.
    """

    __slots__ = ("answered", "frames", "ignored", "stays")

    def __init__(self, *, stays: bool) -> None:
        self.stays = stays
        self.answered = False
        self.ignored = False
        self.frames: deque[Frame] = deque()


class ClientSession:
    """The client's side of one connection.

    `handshake` is what it says and demands first; `welcome` is the gate's, once it is verified;
    `broken` is why nothing goes on.

    Args:
        handshake: who the client is and what it demands of the gate.
        nonce: fresh random bytes, base64url.
        now: reads the clock, for the gate's certificate.
    """

    def __init__(self, handshake: Handshake, *, nonce: str, now: Callable[[], Now]) -> None:
        self.welcome: Welcome | None = None
        self.broken: AuthGuardError | None = None
        #: Estimators: the gate's newest fence that has come; 0 before the first.
        self.fence = 0
        self.handshake = handshake
        self._nonce = nonce
        self._now = now
        self._reader = FrameReader(self._bound)
        self._next = 1
        self._is_loose = False
        self._exchanges: dict[int, _Exchange] = {}
        self._pushed: deque[Frame] = deque()
        self._held = 0

    def hello(self) -> bytes:
        """Return the first message's bytes."""
        return frame(Kind.HELLO, 0, hello(self.handshake, self._nonce))

    def request(self, kind: Kind, message: object, *, stays: bool = False) -> SentRequest:
        """Return a request to send; its answer is taken by its number.

        Args:
            kind: what it is.
            message: its body.
            stays: it subscribes: events follow its answer.

        Raises:
            MalformedError: it is longer than the gate reads.
            AuthenticityError: the client's role may not ask this.
            AuthGuardError: the connection is broken.
        """
        sent = self._sent(kind, message)
        self._exchanges[sent.number] = _Exchange(stays=stays)
        return sent

    def loose(self, kind: Kind, message: object, *, number: int | None = None) -> SentRequest:
        """Return a message to send whose answer, if any comes, is taken by `take_pushed`.

        Args:
            kind: what it is.
            message: its body.
            number: of the gate's own frame that it answers; a new one when absent.

        Raises:
            AuthGuardError: as `request`.
        """
        self._is_loose = True
        return self._sent(kind, message, number)

    def receive(self, data: bytes) -> None:
        """Take in what the peer sent; what is wrong with it is `broken` from then on."""
        try:
            for item in self._reader.feed(data):
                self._route(item)
        except AuthGuardError as error:
            self.end(error)

    def end(self, why: AuthGuardError | None = None) -> None:
        """Note that nothing more comes; the first reason stays.

        Args:
            why: what is wrong; None: the gate closed the connection.
        """
        if self.broken is None:
            middle = " in the middle of a message" if self._reader.unfinished else ""
            self.broken = why or unreachable(f"the gate closed the connection{middle}")

    def take(self, number: int) -> Frame | None:
        """Return the next frame for a request, None when none has come yet.

        Raises:
            AuthGuardError: none will come.
        """
        exchange = self._exchanges[number]
        if not exchange.frames:
            self.require_open()
            return None
        item = exchange.frames.popleft()
        self._held -= _cost(item)
        if _is_over(exchange) and not exchange.frames:
            del self._exchanges[number]
        return item

    def take_pushed(self) -> Frame | None:
        """Return the next frame that answers no request, None when none has come yet.

        Raises:
            AuthGuardError: none will come.
        """
        if not self._pushed:
            self.require_open()
            return None
        item = self._pushed.popleft()
        self._held -= _cost(item)
        return item

    def abandon(self, number: int) -> None:
        """Drop further answers to a request: its caller waits no longer."""
        exchange = self._exchanges.get(number)
        if exchange is None:
            return
        self._held -= sum(_cost(item) for item in exchange.frames)
        exchange.frames.clear()
        exchange.ignored = True
        if _is_over(exchange):
            del self._exchanges[number]

    def require_open(self) -> None:
        """Require that the connection goes on.

        Raises:
            AuthGuardError: why it does not.
        """
        if self.broken is not None:
            raise self.broken

    def _sent(self, kind: Kind, message: object, number: int | None = None) -> SentRequest:
        self.require_open()
        role = self.handshake.role
        if kind not in MAY[role]:
            raise AuthenticityError(
                f"a client in the role `{role}` may not ask `{kind.name.lower()}`",
                reason=Reason.ROLE_DENIED,
                where="request",
            )
        body = msgspec.json.encode(message)
        if len(body) > BOUND[kind]:
            raise MalformedError(
                f"expected a request of at most {BOUND[kind]} bytes, got {len(body)}",
                where="request",
                reason=Reason.INPUT_TOO_LARGE,
            )
        if number is None:
            number, self._next = self._next, self._next % 0xFFFF_FFFF + 1
        return SentRequest(number, raw_frame(kind, number, body))

    def _bound(self, kind: int) -> int:
        """Return the longest body of what a gate may send to this role."""
        if kind in PUSHED:
            return _SHORT if self.handshake.role is ClientRole.CONTROLLER else 0
        return MAX_ANSWER if kind == Kind.EVENT else _ANSWERS.get(kind, 0)  # type: ignore[call-overload]

    def _route(self, item: Frame) -> None:
        if self.welcome is None:
            self._welcomed(item)
        elif item.kind is Kind.ERROR and item.id == 0:
            raise from_fault(read_body(item.body, Fault))
        elif item.kind is Kind.EVENT and item.id == 0 and self._is_estimator:
            self.fence = read_body(item.body, Fence).fence
        elif item.kind in PUSHED or self._is_told(item):
            self._hold(self._pushed, item)
        elif item.kind is Kind.WELCOME:
            raise MalformedError("a second welcome came", where="frame.kind")
        else:
            self._answer(item)

    def _welcomed(self, item: Frame) -> None:
        if item.kind is Kind.ERROR:
            raise from_fault(read_body(item.body, Fault))
        if item.kind is not Kind.WELCOME:
            raise MalformedError(f"expected a welcome, got {item.kind.name}", where="frame.kind")
        welcome = read_body(item.body, Welcome)
        require_welcome(welcome, self.handshake, nonce=self._nonce, now=self._now())
        self.welcome = welcome

    @property
    def _is_estimator(self) -> bool:
        return self.handshake.role is ClientRole.ESTIMATOR

    def _is_told(self, item: Frame) -> bool:
        """True for an event without a request: only machines take such."""
        return item.kind is Kind.EVENT and item.id == 0 and self.handshake.role in _TOLD

    def _answer(self, item: Frame) -> None:
        exchange = self._exchanges.get(item.id)
        if exchange is None and self._is_loose and 0 < item.id < self._next:
            self._hold(self._pushed, item)
            return
        is_event = item.kind is Kind.EVENT
        if (
            exchange is None
            or _is_over(exchange)
            or (exchange.answered and item.kind is Kind.REPLY)
        ):
            raise MalformedError(
                f"an answer to request {item.id} came, which is not open", where="frame.id"
            )
        if not is_event:
            exchange.answered = True
            exchange.stays = exchange.stays and item.kind is Kind.REPLY
        if not exchange.ignored:
            self._hold(exchange.frames, item)
        elif _is_over(exchange):
            del self._exchanges[item.id]

    def _hold(self, where: deque[Frame], item: Frame) -> None:
        self._held += _cost(item)
        if self._held > MAX_HELD:
            raise unreachable("more came than was taken: the client reads too slowly")
        where.append(item)


def answer_of(item: Frame) -> dict[str, Any]:
    """Return what an answer or an event says.

    Raises:
        MalformedError: it is no JSON object.
        AuthGuardError: the gate's own refusal.
    """
    if item.kind is Kind.ERROR:
        raise from_fault(read_body(item.body, Fault))
    return read_body(item.body, dict[str, Any])


#: Called with each event before an answer.
OnEvent = Callable[[dict[str, Any]], object]
#: How the answer to an order names its result; to any other, a standing.
_CALLED = {
    OrderKind.REVOCATIONS: "revocations",
    OrderKind.ACCEPT_STORE: "accepted",
    OrderKind.SHRED: "shredding",
}


def done_of(act: OrderKind, said: dict[str, Any]) -> dict[str, Any]:
    """Return the result of an order: a standing, a list or a store that was taken in.

    Raises:
        MalformedError: the answer does not say.
    """
    called = _CALLED.get(act, "standing")
    done = said.get(called)
    if not isinstance(done, dict):
        raise MalformedError("expected the result of the order", where=f"body.{called}")
    return done


def unreachable(message: str, where: str = "gate") -> EnvironmentFault:
    """Return the error of a gate that is not there, does not answer or went away."""
    return EnvironmentFault(message, reason=Reason.SERVICE_UNAVAILABLE, where=where)


def _is_over(exchange: _Exchange) -> bool:
    return exchange.answered and not exchange.stays


def _cost(item: Frame) -> int:
    return len(item.body) + _FRAME_COST
