# SPDX-License-Identifier: Apache-2.0
"""One connection: its place in the room, and uvicorn's HTTP with an end to its patience.

Spec page: docs/spec/listeners.md
"""

from __future__ import annotations

import asyncio
import time
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol

from authguard_r.integrations.http_listener.access import App, Receive, Scope, Send
from authguard_r.integrations.http_listener.admission import AdmissionControl, AdmissionLimits

#: Where a request's scope has the connection that it came by, and the client's certificates.
GUEST, CHAIN = "authguard_r.guest", "authguard_r.chain"
#: Requests in a second that are read of all strangers together who stay after an answer: each of
#: them has its turn as often as a known client, and there may be many more of them.
STRANGERS = 100


class GoneError(Exception):
    """A request was read, and its connection has ended: the answer could not be sent."""


class HttpConnection:
    """A connected client.

    Args:
        room: where it has a place.
        limits: of the listener.
    """

    def __init__(self, room: AdmissionControl[HttpConnection], limits: AdmissionLimits) -> None:
        self._room = room
        self._transport: asyncio.Transport | None = None
        self._is_gone = False
        self.limits = limits
        #: When its first request has to be there, on the monotonic clock.
        self.until_s = time.monotonic() + limits.first_s

    def arrive(self, transport: asyncio.Transport) -> None:
        """Have a transport: the outermost protocol's."""
        self._transport = transport
        if self._is_gone:
            transport.abort()

    def go(self) -> None:
        """End the connection at once."""
        self._is_gone = True
        if self._transport is not None:
            self._transport.abort()

    def serve(self) -> None:
        """Its request was let in.

        Raises:
            GoneError: it had to go before; a request without an answer would be made again.
        """
        if self._is_gone:
            raise GoneError
        self._room.serve(self)

    def rest(self) -> None:
        """Its request is answered."""
        self._room.rest(self)

    @property
    def pause_s(self) -> float:
        """How long its next request is left unread, in seconds; 0 for a known client."""
        return self._room.strangers / STRANGERS if self._room.is_stranger(self) else 0.0

    def leave(self) -> None:
        """The connection has ended; a second time changes nothing."""
        self._is_gone = True
        self._room.leave(self)


def let_in(scope: Scope) -> None:
    """Mark a request: its sender has shown who they are.

    Raises:
        GoneError: its connection has been ended.
    """
    guest = scope.get(GUEST)
    if guest is not None:
        guest.serve()


class Patient(H11Protocol):
    """HTTP that lets go of a client that neither asks nor reads.

    Args:
        guest: whose connection it is.
        given: what uvicorn's own protocol takes.
    """

    _late: asyncio.TimerHandle
    _unread: asyncio.TimerHandle | None = None
    _next: asyncio.TimerHandle | None = None

    def __init__(self, guest: HttpConnection, **given: Any) -> None:
        super().__init__(**given)
        self._guest = guest

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Wait for a request."""
        super().connection_made(transport)
        if not transport.get_extra_info("sslcontext"):
            self._guest.arrive(transport)
        chain = transport.get_extra_info(CHAIN) or ()
        self.app = _with(self.app, {CHAIN: chain, GUEST: self._guest})
        self._late = self.loop.call_at(self._guest.until_s, self._give_up)

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the connection."""
        self._late.cancel()
        if self._next is not None:
            self._next.cancel()
        self._stop_counting()
        self._guest.leave()
        super().connection_lost(exc)

    def on_response_complete(self) -> None:
        """Wait for the next request; a stranger's is not read at once."""
        self._guest.rest()
        self._late.cancel()
        self._late = self.loop.call_later(self._guest.limits.first_s, self._give_up)
        pause_s = self._guest.pause_s
        if pause_s:
            self.flow.pause_reading()  # what is on its way could begin the next one as well
            self._next = self.loop.call_later(pause_s, super().on_response_complete)
        else:
            super().on_response_complete()

    def timeout_keep_alive_handler(self) -> None:
        """Let go of a client that says nothing more, though it left an answer unread."""
        self.transport.abort()

    def pause_writing(self) -> None:
        """Wait for the client to read."""
        super().pause_writing()
        self._unread = self.loop.call_later(self._guest.limits.take_s, self.transport.abort)

    def resume_writing(self) -> None:
        """Go on."""
        self._stop_counting()
        super().resume_writing()

    def _stop_counting(self) -> None:
        if self._unread is not None:
            self._unread.cancel()

    def _give_up(self) -> None:
        if self.cycle is None or self.cycle.response_complete:
            self.transport.abort()


def _with(app: Any, more: dict[str, Any]) -> App:
    async def serve(scope: Scope, receive: Receive, send: Send) -> None:
        await app({**scope, **more}, receive, send)

    return serve
