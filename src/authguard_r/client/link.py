# SPDX-License-Identifier: Apache-2.0
"""Connections of the robot's own processes: made again for ever, logged once for each reason.

How-to: docs/howto/simulator.md
"""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
import time
from collections.abc import Awaitable, Callable, Coroutine
from contextlib import suppress
from pathlib import Path
from typing import Protocol

from authguard_r.client.handshake import GateVerifier, Handshake, Speaks
from authguard_r.client.proof import Conversation, Proven
from authguard_r.core.encoding import b64
from authguard_r.core.errors import AuthGuardError, EnvironmentFault, shown
from authguard_r.core.identifiers import Identifier, RobotId
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.wire.frames import Frame
from authguard_r.wire.messages import ClientRole, Kind

#: First and longest pause between two tries, in seconds.
FIRST_PAUSE_S = 0.05
LONGEST_PAUSE_S = 1.0
#: A server that has not proved itself after so long is let go, in seconds.
WELCOME_S = 2.0
#: Bytes that a server may leave unread before it is let go.
MAX_UNREAD = 1 << 20


def mono_ms() -> int:
    """Return the machine's monotonic clock in milliseconds."""
    return time.monotonic_ns() // 1_000_000


def wall_now() -> Now:
    """Return the machine's clocks."""
    return Now(time.time_ns() // 1_000_000, mono_ms())


class ProcessLog:
    """One line of JSON on standard error for each thing that happens, not for each repeat of it."""

    def __init__(self) -> None:
        self._last: dict[str, tuple[str, str]] = {}

    def say(self, event: str, channel: str, **more: str) -> None:
        """Write a line, unless it would say of its channel what the line before said.

        A write error is ignored: a reader that is gone must not end a process that stops a robot.
        """
        said = (event, str(sorted(more.items())))
        if self._last.get(channel) == said:
            return
        self._last[channel] = said
        line = {"event": event, "channel": channel, **more}
        text = json.dumps({key: shown(value) for key, value in line.items()}) + "\n"
        with suppress(OSError, ValueError):  # ValueError: it is closed
            sys.stderr.write(text)
            sys.stderr.flush()

    def fault(self, channel: str, error: AuthGuardError) -> None:
        """Write down why a server is not listened to."""
        self.say(
            "refused", channel, code=str(error.reason), message=error.message, where=error.where
        )


class ConnectionListener(Protocol):
    """Who a link brings its news to."""

    def opened(self, proven: Proven) -> None:
        """Take note that the server proved itself."""
        ...

    def heard(self, item: Frame) -> None:
        """Take a frame of the proven server.

        Raises:
            MalformedError: it is not what its kind says; the connection ends.
        """
        ...

    def closed(self) -> None:
        """Take note that a connection that was opened is lost."""
        ...


class ProvenConnection(asyncio.Protocol):
    """One connection to a server that must prove itself.

    Args:
        name: of the channel, in the log.
        conversation: the protocol's state.
        listener: hears of it.
        log: where it says why it hung up.
    """

    def __init__(
        self,
        name: str,
        conversation: Conversation,
        *,
        listener: ConnectionListener,
        log: ProcessLog,
    ) -> None:
        self.over = asyncio.Event()
        self.decided = asyncio.Event()  # proved, or over
        self._name = name
        self._conversation = conversation
        self._listener = listener
        self._log = log
        self._transport: asyncio.Transport | None = None

    @property
    def is_proven(self) -> bool:
        """True once the server has proved itself."""
        return self._conversation.proven is not None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Say hello."""
        if not isinstance(transport, asyncio.Transport):  # pragma: no cover - it is a stream
            raise TypeError("expected a stream")
        self._transport = transport
        transport.write(self._conversation.hello())

    def data_received(self, data: bytes) -> None:
        """Read what came; any fault in it ends the connection."""
        try:
            was_proven = self.is_proven
            frames = self._conversation.receive(data)
            proven = self._conversation.proven
            if proven is not None and not was_proven:
                self.decided.set()
                self._log.say("connected", self._name)
                self._listener.opened(proven)
            for item in frames:
                self._listener.heard(item)
        except AuthGuardError as error:
            self._log.fault(self._name, error)
            self.hang_up()

    def connection_lost(self, exc: Exception | None) -> None:  # noqa: ARG002 - gone is gone
        """Tell the listener, if it knew of the connection."""
        self._transport = None
        if not self.over.is_set():
            self.over.set()
            self.decided.set()
            if self.is_proven:
                self._log.say("disconnected", self._name)
                self._listener.closed()

    def send(self, data: bytes) -> None:
        """Send, unless the connection is gone; close it to a server that reads nothing."""
        transport = self._transport
        if transport is None:
            return
        transport.write(data)
        if transport.get_write_buffer_size() > MAX_UNREAD:
            self._log.say("unread", self._name)
            self.hang_up()

    def hang_up(self) -> None:
        """Drop the connection at once."""
        transport = self._transport
        if transport is not None:
            transport.abort()
            self.connection_lost(None)


class PersistentConnection:
    """Keeps one connection to a gate: tries again for ever, with a bounded pause.

    Args:
        path: the server's socket.
        role: what the client is.
        client: its name in the server's log.
        robot: whose gate it must be.
        trust: reads the trust root anew for each connection, so that a revocation counts.
        bounds: the longest body of each kind that may come.
        listener: hears of everything.
        log: where it says what happened.
        allow_shadow: take a server in shadow mode too.
        speaks: the words that the server has to speak; None takes any.
    """

    def __init__(
        self,
        path: Path,
        *,
        role: ClientRole,
        client: Identifier,
        robot: RobotId,
        trust: Callable[[], GateVerifier],
        bounds: dict[Kind, int],
        listener: ConnectionListener,
        log: ProcessLog,
        allow_shadow: bool = False,
        speaks: Speaks | None = None,
    ) -> None:
        self._path = path
        self._speaks = speaks
        self._allow_shadow = allow_shadow
        self._role = role
        self._client = client
        self._robot = robot
        self._trust = trust
        self._bounds = bounds
        self._listener = listener
        self._log = log
        self._link: ProvenConnection | None = None

    def send(self, data: bytes) -> None:
        """Send on the connection that is there now, if one is."""
        if self._link is not None:
            self._link.send(data)

    def hang_up(self) -> None:
        """Drop the connection that is there now; another one is made."""
        if self._link is not None:
            self._link.hang_up()

    async def stay(self) -> None:
        """Keep the connection until this is canceled."""
        pause = FIRST_PAUSE_S
        try:
            while True:
                was_proven = await self._once()
                pause = FIRST_PAUSE_S if was_proven else min(pause * 2, LONGEST_PAUSE_S)
                await asyncio.sleep(pause)
        finally:
            self.hang_up()

    async def _once(self) -> bool:
        """Connect and stay while it lasts; return whether the server ever proved itself."""
        try:
            link = self._new_link()
            path = str(self._path)
            await asyncio.get_running_loop().create_unix_connection(lambda: link, path)
        except AuthGuardError as error:
            self._log.fault(str(self._path.name), error)
            return False
        except OSError as error:
            self._log.say("unreachable", self._path.name, message=error.strerror or str(error))
            return False
        try:
            async with asyncio.timeout(WELCOME_S):  # `wait_for` may lose a cancellation
                await link.decided.wait()
        except TimeoutError:
            self._log.say("no proof in time", self._path.name)
            link.hang_up()
        await link.over.wait()
        self._link = None
        return link.is_proven

    def _new_link(self) -> ProvenConnection:
        handshake = Handshake(
            role=self._role,
            client=self._client,
            verifier=self._trust(),
            robot=self._robot,
            allow_shadow=self._allow_shadow,
            speaks=self._speaks,
        )
        conversation = Conversation(
            handshake, nonce=b64(os.urandom(32)), bounds=self._bounds, now=wall_now
        )
        link = ProvenConnection(
            self._path.name, conversation, listener=self._listener, log=self._log
        )
        self._link = link
        return link


async def run_all(
    tasks: tuple[Coroutine[object, object, None], ...], *, until: asyncio.Event
) -> None:
    """Run until the event is set; a task that ends before has failed, and its error is raised."""
    running = [asyncio.ensure_future(task) for task in tasks]
    waiting = asyncio.ensure_future(until.wait())
    try:
        done, _ = await asyncio.wait((waiting, *running), return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()  # a fault of ours ends the process; it is not kept quiet
    finally:
        for task in (waiting, *running):
            task.cancel()
        await asyncio.gather(waiting, *running, return_exceptions=True)


async def until_signal(serve: Callable[[asyncio.Event], Awaitable[None]]) -> None:
    """Run a process's work until SIGTERM or SIGINT."""
    told = asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().add_signal_handler(number, told.set)
    await serve(told)


def require_folder(run: Path) -> None:
    """Require the folder with the sockets.

    Raises:
        EnvironmentFault: it does not exist.
    """
    if not run.is_dir():
        raise EnvironmentFault(
            f"expected a folder for sockets, got `{run}`",
            reason=Reason.FILE_UNAVAILABLE,
            where=str(run),
        )
