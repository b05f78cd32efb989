# SPDX-License-Identifier: Apache-2.0
"""A client as the gate sees it, and the order in which clients are served.

One request of one client at a time, in turn: a client that sends much delays only
itself. The gate drops excess frames by their header, before it parses a byte of their body.
Spec page: docs/spec/gate-protocol.md#turns
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Protocol

import msgspec

from authguard_r.core.identifiers import Identifier
from authguard_r.core.reasons import Reason
from authguard_r.wire.frames import Frame, frame, raw_frame
from authguard_r.wire.gate_limits import LIMITS
from authguard_r.wire.messages import ClientRole, Fault, Kind

#: Served before all others: their messages keep the robot safe.
_URGENT = frozenset({ClientRole.CONTROLLER, ClientRole.ESTIMATOR})
#: Encoded once: who floods gets it often.
_BUSY = msgspec.json.encode(
    Fault(
        code=Reason.BUSY,
        message="a proposal of this client is still being decided",
        where="proposal",
    )
)


class ClientLine(Protocol):
    """A client's connection."""

    def write(self, data: bytes) -> None:
        """Send bytes, or keep them until they can be sent."""
        ...

    def pause(self) -> None:
        """Stop reading until `resume`."""
        ...

    def resume(self) -> None:
        """Read on."""
        ...

    def drop(self, why: str) -> None:
        """Close at once."""
        ...


class ServedClient:
    """One connected client after its hello.

    Args:
        line: its connection.
        role: what it may do.
        name: its user and its own name, for the log: `u1001.arm-planner`.
        uid: its user.

    `clogged` is a client that does not read: what it asked waits until it does, so that answers
    that are not read are not made. `queued` says that it stands in the queue.
    """

    def __init__(self, line: ClientLine, *, role: ClientRole, name: Identifier, uid: int) -> None:
        self.line = line
        self.role = role
        self.name = name
        self.uid = uid
        self.waiting: deque[Frame | Callable[[], None]] = deque()
        self.proposing = False
        self.watching: int | None = None
        self.gone = False
        self.clogged = False
        self.queued = False
        self.shed = 0
        self.paused = False
        self.heard_ms = 0

    @property
    def urgent(self) -> bool:
        """True for those who keep the robot safe."""
        return self.role in _URGENT

    def reply(self, number: int, body: object) -> None:
        """Answer a request."""
        self._send(Kind.REPLY, number, body)

    def error(self, number: int, fault: Fault) -> None:
        """Answer a request that was refused."""
        self._send(Kind.ERROR, number, fault)

    def event(self, number: int, body: object) -> None:
        """Tell something in between."""
        self._send(Kind.EVENT, number, body)

    def tell(self, kind: Kind, body: object, number: int) -> None:
        """Send a message that answers nothing: to a controller."""
        self._send(kind, number, body)

    def _send(self, kind: Kind, number: int, body: object) -> None:
        if not self.gone:
            self.line.write(frame(kind, number, body))


class FairQueue:
    """Who is served next.

    Args:
        shed: called with a client whose proposal was shed; it is already answered.
    """

    def __init__(self, shed: Callable[[ServedClient], None]) -> None:
        self._shed = shed
        self._urgent: deque[ServedClient] = deque()
        self._normal: deque[ServedClient] = deque()

    def __bool__(self) -> bool:
        return bool(self._urgent or self._normal)

    def came(self, client: ServedClient, item: Frame) -> None:
        """Take in a frame: it waits for its turn, or is shed."""
        if item.kind is Kind.PROPOSE:
            if client.proposing:
                self._refuse(client, item)
                return
            client.proposing, client.shed = True, 0
        self.put(client, item)

    def put(
        self, client: ServedClient, item: Frame | Callable[[], None], *, first: bool = False
    ) -> None:
        """Let something of a client wait for its turn; `first` before what it asked since."""
        (client.waiting.appendleft if first else client.waiting.append)(item)
        self.reads(client)
        _flow(client)

    def reads(self, client: ServedClient) -> None:
        """Serve what waits of a client that was put aside: it reads again, or it is gone."""
        if client.waiting and not client.queued:
            client.queued = True
            (self._urgent if client.urgent else self._normal).append(client)

    def take(self) -> tuple[tuple[ServedClient, Frame | Callable[[], None]], ...]:
        """Return what is to be done in this turn: one urgent thing and one other."""
        return (*self._next(self._urgent), *self._next(self._normal))

    def done(self, client: ServedClient) -> None:
        """Say that the client's proposal was answered: it may make the next one."""
        client.proposing = False
        _flow(client)

    def _refuse(self, client: ServedClient, item: Frame) -> None:
        client.shed += 1
        if not client.gone:
            client.line.write(raw_frame(Kind.ERROR, item.id, _BUSY))
        self._shed(client)
        _flow(client)

    def _next(
        self, queue: deque[ServedClient]
    ) -> tuple[tuple[ServedClient, Frame | Callable[[], None]], ...]:
        while queue:
            client = queue.popleft()
            client.queued = False
            if client.gone:
                _forget(client)
            if client.waiting and not client.clogged:
                item = client.waiting.popleft()
                self.reads(client)
                _flow(client)
                return ((client, item),)
        return ()


def _forget(client: ServedClient) -> None:
    """Drop the requests of a client that is gone; actions that were started run to completion."""
    begun = [item for item in client.waiting if not isinstance(item, Frame)]
    client.waiting = deque(begun)


def _flow(client: ServedClient) -> None:
    """Read on, or stop reading, as much waits or was shed."""
    much = client.proposing and client.shed >= LIMITS.shed_proposals
    paused = much or len(client.waiting) >= LIMITS.waiting_requests
    if paused is not client.paused:
        client.paused = paused
        (client.line.pause if paused else client.line.resume)()
