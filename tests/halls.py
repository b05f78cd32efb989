# SPDX-License-Identifier: Apache-2.0
"""Sessions of the gate on real sockets, in a hall that notes what they tell it.

The hall stands where the service does; a session's timers go off when a test says so.
"""

from __future__ import annotations

import asyncio
import json
import os
import socket
from collections.abc import Callable
from typing import Any

from authguard_r.core.errors import AuthGuardError
from authguard_r.core.identifiers import Identifier
from authguard_r.gate.clients import Client
from authguard_r.gate.config import GateConfig, Peer, default_config
from authguard_r.gate.sessions import Session
from authguard_r.wire.frames import Frame, FrameReader, frame
from authguard_r.wire.messages import PROTOCOL, ClientRole, Hello, Kind, Mode, Welcome
from worlds import RID

ROLES = (ClientRole.AUDITOR, ClientRole.OPERATOR, ClientRole.PLANNER)


def config() -> GateConfig:
    """Return a configuration that gives this user most roles."""
    return default_config(RID, (Peer(uid=os.geteuid(), roles=ROLES),), Mode.ENFORCE)


class Noted:
    """A hall that notes what its sessions tell it (`gate.sessions.Hall`)."""

    def __init__(self, *, connections: int = 0, full: AuthGuardError | None = None) -> None:
        self.config = config()
        self.connections = connections
        self.full = full
        self.here: list[Client] = []
        self.requests: list[tuple[Client, Frame]] = []
        self.wrong: list[tuple[str, AuthGuardError]] = []
        self.read_again: list[Client] = []
        self.gone: list[Client | None] = []

    def count(self, uid: int) -> int:
        assert uid == os.geteuid()
        return self.connections + 1

    def welcome(self, hello: Hello) -> Welcome:
        return Welcome(
            protocol=PROTOCOL,
            robot=RID,
            mode=Mode.ENFORCE,
            role=hello.role,
            client=hello.client,
        )

    def entered(self, client: Client) -> None:
        if self.full is not None:
            raise self.full
        self.here.append(client)

    def came(self, client: Client, item: Frame, *, alone: bool) -> None:
        self.requests.append((client, item))

    def reads(self, client: Client) -> None:
        self.read_again.append(client)

    def left(self, session: Session, client: Client | None) -> None:
        assert session.client is client
        self.gone.append(client)

    def refused(self, name: Identifier, error: AuthGuardError) -> None:
        self.wrong.append((name, error))


class Timers:
    """What a session wants done later; it is done when a test says so."""

    def __init__(self) -> None:
        self._set: list[tuple[float, asyncio.TimerHandle]] = []

    def later(self, delay: float, act: Callable[[], None]) -> asyncio.TimerHandle:
        handle = asyncio.TimerHandle(delay, act, (), asyncio.get_running_loop())
        self._set.append((delay, handle))
        return handle

    def waiting(self) -> list[float]:
        """Return after how long each would go off."""
        return [delay for delay, handle in self._set if not handle.cancelled()]

    def fire(self) -> None:
        """Let all of them go off."""
        due, self._set = self._set, []
        for _, handle in due:
            if not handle.cancelled():
                handle._run()


class Door:
    """One session and the other end of its socket.

    Args:
        hall: where the session is.
        pair: both ends; the first is the session's.
    """

    def __init__(self, hall: Noted, pair: tuple[socket.socket, socket.socket]) -> None:
        self.hall = hall
        self.timers = Timers()
        self.session = Session(hall, self.timers.later)
        self.theirs, self.ours = pair
        self.ours.setblocking(False)
        self._reader = FrameReader(lambda _: 1 << 23)
        self.is_closed = False

    async def open(self) -> Door:
        """Let the session begin."""
        loop = asyncio.get_running_loop()
        await loop.connect_accepted_socket(lambda: self.session, self.theirs)
        return self

    async def send(self, *chunks: bytes) -> None:
        """Send chunks, each read by itself."""
        for chunk in chunks:
            await asyncio.get_running_loop().sock_sendall(self.ours, chunk)
            await settle()

    async def hello(self, **changes: Any) -> Door:
        """Be welcomed."""
        await self.send(hello(**changes))
        (welcome,) = await self.answers()
        assert welcome.kind is Kind.WELCOME, welcome
        return self

    async def answers(self) -> list[Frame]:
        """Return what has come; sees whether the connection is closed."""
        await settle()
        found: list[Frame] = []
        while True:
            try:
                data = self.ours.recv(1 << 20)
            except BlockingIOError:
                return found
            except ConnectionResetError:
                data = b""
            if not data:
                self.is_closed = True
                return found
            found += self._reader.feed(data)
            await settle()

    async def fault(self) -> dict[str, Any]:
        """Return the last thing said, which has to be an error, and require the end."""
        last = (await self.answers())[-1]
        assert (last.kind, last.id) == (Kind.ERROR, 0)
        assert self.is_closed
        said: dict[str, Any] = json.loads(last.body)
        return said

    def close(self) -> None:
        """Hang up."""
        self.ours.close()


async def settle() -> None:
    """Let the loop do what it can do now."""
    for _ in range(20):
        await asyncio.sleep(0)


async def enter(hall: Noted) -> Door:
    """Return a new session on a real socket."""
    return await Door(hall, socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)).open()


def hello(**changes: Any) -> bytes:
    """Return the bytes of a hello with something changed."""
    said = {"protocol": PROTOCOL, "role": "planner", "client": "one", **changes}
    return frame(Kind.HELLO, 0, said)
