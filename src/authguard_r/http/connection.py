# SPDX-License-Identifier: Apache-2.0
"""Uvicorn's HTTP connection with an end to its patience, and with the client's certificates.

Spec page: docs/spec/http.md#limits
"""

from __future__ import annotations

import asyncio
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol

from authguard_r.http.clients import CHAIN
from authguard_r.listening import App, Receive, Scope, Send

#: The head of a request is whole within this, in seconds, and an answer is taken.
HEAD_S, TAKE_S = 10.0, 10.0


class Patient(H11Protocol):
    """Lets go of a client that neither asks nor reads."""

    _late: asyncio.TimerHandle
    _unread: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Wait for a request."""
        super().connection_made(transport)
        chain = transport.get_extra_info(CHAIN) or ()
        self.app = _with_chain(self.app, chain)
        self._late = self.loop.call_later(HEAD_S, self._give_up)

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the connection."""
        self._late.cancel()
        self._stop_counting()
        super().connection_lost(exc)

    def on_response_complete(self) -> None:
        """Wait for the next request."""
        super().on_response_complete()
        self._late.cancel()
        self._late = self.loop.call_later(HEAD_S, self._give_up)

    def timeout_keep_alive_handler(self) -> None:
        """Let go of a client that says nothing more, though it left an answer unread."""
        self.transport.abort()

    def pause_writing(self) -> None:
        """Wait for the client to read."""
        super().pause_writing()
        self._unread = self.loop.call_later(TAKE_S, self.transport.abort)

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


def _with_chain(app: Any, chain: tuple[bytes, ...]) -> App:
    async def serve(scope: Scope, receive: Receive, send: Send) -> None:
        await app({**scope, CHAIN: chain}, receive, send)

    return serve
