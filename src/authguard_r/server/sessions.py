# SPDX-License-Identifier: Apache-2.0
"""One connection: who it is, which bytes may come, and how a client that misbehaves is treated.

A connection that says nothing, says too much, never reads, or claims what it may not be is closed;
the other clients do not notice. Spec page: docs/spec/gate-protocol.md#connections
"""

from __future__ import annotations

import asyncio
import resource
from collections.abc import Callable
from typing import Protocol, cast

from authguard_r.access.gate_config import GateConfig
from authguard_r.access.peers import Socket, client_role, peer_of
from authguard_r.core.errors import AuthGuardError, EnvironmentFault, MalformedError
from authguard_r.core.identifiers import Identifier, is_identifier
from authguard_r.core.reasons import Reason
from authguard_r.server.fair_queue import ServedClient
from authguard_r.wire.faults import to_fault
from authguard_r.wire.frames import Frame, FrameReader, frame, read_body
from authguard_r.wire.gate_limits import LIMITS
from authguard_r.wire.messages import PROTOCOL, Hello, Kind, Welcome, opening_bound, request_bound


class ConnectionHost(Protocol):
    """What a connection needs of the service."""

    @property
    def config(self) -> GateConfig:
        """The signed configuration."""
        ...

    def count(self, uid: int) -> int:
        """Return how many connections a user has."""
        ...

    def welcome(self, hello: Hello) -> Welcome:
        """Return the answer to a hello that is taken."""
        ...

    def entered(self, client: ServedClient) -> None:
        """Take a client in.

        Raises:
            AuthGuardError: there is no place for it.
        """
        ...

    def came(self, client: ServedClient, item: Frame, *, alone: bool) -> None:
        """Take in a frame of a client; `alone` when nothing came behind it."""
        ...

    def reads(self, client: ServedClient) -> None:
        """Serve what waits of a client that was put aside: it reads again, or it is gone."""
        ...

    def left(self, session: ServerSession, client: ServedClient | None) -> None:
        """Let a connection go."""
        ...

    def refused(self, name: Identifier, error: AuthGuardError) -> None:
        """Record a connection that was refused before its first request."""
        ...


class ServerSession(asyncio.BufferedProtocol):
    """One connection (`fair_queue.ClientLine`).

    Args:
        host: the service.
        later: `loop.call_later`.
    """

    def __init__(
        self,
        host: ConnectionHost,
        later: Callable[[float, Callable[[], None]], asyncio.TimerHandle],
    ) -> None:
        self._host = host
        self._later = later
        self._buffer = bytearray(LIMITS.chunk_bytes)
        self._reader = FrameReader(opening_bound)
        self._transport: asyncio.Transport | None = None
        self._timer: asyncio.TimerHandle | None = None  # for its hello, its reading or its end
        self._frame_timer: asyncio.TimerHandle | None = None
        self._paused = False
        self._over = False
        self.client: ServedClient | None = None
        self.uid = -1
        self.name = Identifier("unknown")

    # asyncio

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Ask the kernel who is there; a user with too many connections gets none."""
        self._transport = cast("asyncio.Transport", transport)
        self._transport.set_write_buffer_limits(high=LIMITS.unread_bytes)
        try:
            sock = transport.get_extra_info("socket")
            peer = peer_of(cast("Socket", sock))
            self.uid, self.name = peer.uid, Identifier(f"u{peer.uid}")
            if self._host.count(peer.uid) > self._host.config.connections:
                raise EnvironmentFault(
                    "too many connections of this user", reason=Reason.BUSY, where="connection"
                )
            _require_room(sock.fileno())
        except AuthGuardError as error:
            self._refuse(error)
            return
        self._timer = self._later(
            LIMITS.hello_s, lambda: self._refuse(MalformedError("no hello in time", where="hello"))
        )

    def get_buffer(self, sizehint: int) -> bytearray:  # noqa: ARG002 - the chunk is always ours
        """Return where the next bytes go."""
        return self._buffer

    def buffer_updated(self, nbytes: int) -> None:
        """Cut what came into frames and hand them on."""
        self._reader.put(memoryview(self._buffer)[:nbytes])
        self._await_rest(anew=self._cut())

    def _cut(self) -> bool:
        """Hand on what is whole, unless the client is to wait; True when there was something."""
        cut = False
        try:
            while not (self._over or self._paused) and (item := self._reader.next()) is not None:
                cut = True
                self._came(item)  # a hello changes the bounds of what follows it
        except AuthGuardError as error:
            self._refuse(error)
        return cut

    def eof_received(self) -> bool:
        """End the connection: a client that closes its side wants nothing more."""
        return False

    def connection_lost(self, exc: Exception | None) -> None:  # noqa: ARG002 - it is gone
        """Forget the client; half of a message is the last that the log says of it."""
        if self._reader.unfinished and not self._over:
            why = MalformedError("the connection ended within a message", where="frame")
            self._host.refused(self.name, why)
        self._end()
        if self.client is not None:
            self.client.clogged = False
            self._host.reads(self.client)  # nothing waits for a reader any more
        self._host.left(self, self.client)

    def pause_writing(self) -> None:
        """Give a client that does not read a little time to do so; it is not served meanwhile."""
        if self._over or self.client is None:
            return
        self.client.clogged = True
        self._cancel()
        self._timer = self._later(LIMITS.read_s, lambda: self.drop("it does not read"))

    def resume_writing(self) -> None:
        """Go on: it has read."""
        if self._over or self.client is None:
            return
        self._cancel()
        self.client.clogged = False
        self._host.reads(self.client)

    # Line

    def write(self, data: bytes) -> None:
        """Send, or keep until it can be sent."""
        if self._transport is not None and not self._transport.is_closing():
            self._transport.write(data)

    def pause(self) -> None:
        """Stop reading; the rest of a frame is not waited for meanwhile."""
        if self._transport is not None and not self._transport.is_closing():
            self._paused = True
            self._transport.pause_reading()
            self._cancel_frame()

    def resume(self) -> None:
        """Read on."""
        if self._transport is not None and not self._transport.is_closing():
            self._paused = False
            self._transport.resume_reading()
            self._cut()
            self._await_rest(anew=True)

    def drop(self, why: str) -> None:
        """Close at once and record why."""
        fault = EnvironmentFault(why, reason=Reason.BUSY, where="connection")
        self._host.refused(self.name, fault)
        self._end()
        if self._transport is not None:
            self._transport.abort()

    def end(self) -> None:
        """Send what waits, then close; a client that reads too slowly loses the rest."""
        self._end()
        if self._transport is not None:
            self._transport.close()
            self._timer = self._later(LIMITS.read_s, self._transport.abort)

    # what comes

    def _came(self, item: Frame) -> None:
        if self.client is None:
            self._hello(item)
        else:
            self._host.came(self.client, item, alone=not self._reader.unfinished)

    def _hello(self, item: Frame) -> None:
        """Take the first message; anything wrong with it ends the connection."""
        hello = read_body(item.body, Hello)
        if hello.protocol != PROTOCOL:
            raise MalformedError(
                f"expected the protocol `{PROTOCOL}`, got `{hello.protocol}`",
                where="hello.protocol",
            )
        role = client_role(self._host.config, self.uid, hello.role)
        name = f"u{self.uid}.{hello.client}"
        if not is_identifier(name):
            raise MalformedError("expected a shorter name", where="hello.client")
        client = ServedClient(self, role=role, name=Identifier(name), uid=self.uid)
        self._host.entered(client)
        self._cancel()
        self.client, self.name = client, client.name
        bounds = request_bound(role)
        self._reader.bound = lambda kind: bounds.get(kind, 0)
        self.write(frame(Kind.WELCOME, item.id, self._host.welcome(hello)))

    def _refuse(self, error: AuthGuardError) -> None:
        """Say why, then close: only this client is lost."""
        self._host.refused(self.name, error)
        self.write(frame(Kind.ERROR, 0, to_fault(error)))
        self.end()

    def _await_rest(self, *, anew: bool) -> None:
        """Give a frame that has begun its time; a trickle of bytes does not prolong it."""
        waits = self._reader.unfinished and not (self._over or self._paused or not self.client)
        if anew or not waits:
            self._cancel_frame()
        if waits and self._frame_timer is None:
            late = MalformedError("a message did not end in time", where="frame")
            self._frame_timer = self._later(LIMITS.frame_s, lambda: self._refuse(late))

    def _end(self) -> None:
        """Take nothing in any more."""
        self._over = True
        self._cancel()
        self._cancel_frame()
        if self.client is not None:
            self.client.gone = True

    def _cancel(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _cancel_frame(self) -> None:
        if self._frame_timer is not None:
            self._frame_timer.cancel()
            self._frame_timer = None


def _require_room(file: int) -> None:
    """Require that files are left beside this connection's, for the store and those refused.

    The kernel gives out the lowest free number, so a connection's says how many are in use.

    Raises:
        EnvironmentFault: too few are left.
    """
    most, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if file >= most - LIMITS.kept_files:
        raise EnvironmentFault("too many connections", reason=Reason.BUSY, where="connection")
