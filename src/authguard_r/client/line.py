# SPDX-License-Identifier: Apache-2.0
"""The asynchronous client's end of a socket: bytes to the session, and news to who waits for it.

Spec page: docs/spec/gate-protocol.md#connections
"""

from __future__ import annotations

import asyncio
import socket
from typing import cast

from authguard_r.client.session import ClientSession, unreachable
from authguard_r.client.start import CHUNK


class SessionLine(asyncio.Protocol):
    """Feeds a session from a transport and wakes the tasks that wait for it.

    Args:
        session: what the bytes mean.
        wire: the socket under the transport.
    """

    def __init__(self, session: ClientSession, wire: socket.socket) -> None:
        self.session = session
        self._wire = wire
        self._changed = asyncio.Event()
        self._writable = asyncio.Event()
        self._writable.set()
        self._lost = asyncio.Event()
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Keep the transport."""
        self._transport = cast("asyncio.Transport", transport)

    def data_received(self, data: bytes) -> None:
        """Take in what came; a peer that talks nonsense is hung up on."""
        self.session.receive(data)
        if self.session.broken is not None:
            self.hang_up()
        self._wake()

    def connection_lost(self, exc: Exception | None) -> None:
        """Read what the peer said before it hung up, then note that nothing more comes."""
        self._drain()
        why = getattr(exc, "strerror", None) or exc
        self.session.end(None if exc is None else unreachable(f"the connection failed: {why}"))
        self._writable.set()
        self._lost.set()
        self._wake()

    def pause_writing(self) -> None:
        """Note that the gate does not read."""
        self._writable.clear()

    def resume_writing(self) -> None:
        """Note that it reads again."""
        self._writable.set()

    async def write(self, data: bytes) -> None:
        """Send the bytes; return when the gate has room for more."""
        cast("asyncio.Transport", self._transport).write(data)
        await self._writable.wait()

    async def changed(self) -> None:
        """Return when something has come."""
        await self._changed.wait()

    def hang_up(self) -> None:
        """Let go of the connection."""
        if self._transport is not None:
            self._transport.abort()

    async def lost(self) -> None:
        """Return when the connection is gone."""
        await self._lost.wait()

    def _wake(self) -> None:
        self._changed.set()
        self._changed = asyncio.Event()

    def _drain(self) -> None:
        """Read what is left: a write that failed closes the transport before it was read."""
        try:
            while self.session.broken is None and (data := self._wire.recv(CHUNK)):
                self.session.receive(data)
        except OSError:
            return
