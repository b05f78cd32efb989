# SPDX-License-Identifier: Apache-2.0
"""Serves HTTP at a port until it is ended; a flood of connections does not fill its log.

uvicorn speaks HTTP. Who is taken in, this module decides: asyncio's own server takes in more than
there are files for, waits a second at each failure, and writes a traceback of it.
Spec page: docs/spec/listeners.md
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import uvicorn

from authguard_r.client.link import until_signal
from authguard_r.integrations.http_listener.access import App
from authguard_r.integrations.http_listener.admission import (
    AdmissionControl,
    AdmissionLimits,
    fitting,
)
from authguard_r.integrations.http_listener.connection import HttpConnection, Patient
from authguard_r.wire.json_log import Lines

#: Answers that are under way are waited for so long at the end, in seconds.
END_S = 2
#: Connections that are taken in before those that are there already have their turn.
AT_ONCE = 16
#: Without a file for the next connection and without a stranger who could go: waits, in seconds.
AGAIN_S = 0.1

#: Makes the outermost protocol of a connection: HTTP, or TLS around it.
Make = Callable[[HttpConnection, Callable[[], asyncio.Protocol]], asyncio.Protocol]


class Acceptor:
    """Takes in each connection.

    Args:
        made: listens.
        limits: of connections.
        lines: where it is said that a connection had to go.
    """

    def __init__(self, made: socket.socket, limits: AdmissionLimits, lines: Lines) -> None:
        self._made = made
        self._limits = limits
        self._lines = lines
        self._room: AdmissionControl[HttpConnection] = AdmissionControl(limits.connections)
        # a connection has its turn before as many others come as there are places
        self._at_once = max(1, min(AT_ONCE, limits.connections // 8))
        self._coming: set[asyncio.Task[Any]] = set()
        self._loop = asyncio.get_running_loop()
        self._again: asyncio.TimerHandle | None = None
        self._make: Callable[[HttpConnection], asyncio.Protocol]

    def open(self, make: Callable[[HttpConnection], asyncio.Protocol]) -> None:
        """Begin.

        Args:
            make: makes a connection's protocol.
        """
        self._make = make
        self._made.settimeout(0)
        self._loop.add_reader(self._made, self._accept)

    def close(self) -> None:
        """Accept no more connections."""
        if self._again is not None:
            self._again.cancel()
        self._loop.remove_reader(self._made)
        self._made.close()

    def clear(self) -> None:
        """End every connection that is left."""
        for guest in self._room.guests:
            guest.go()

    def _accept(self) -> None:
        for _ in range(self._at_once):
            try:
                link, _ = self._made.accept()
            except (BlockingIOError, InterruptedError, ConnectionAbortedError):
                return
            except OSError:  # no file is left: a missing place is refused
                self._go(self._room.spare())
                self._wait()
                return
            guest = HttpConnection(self._room, self._limits)
            self._go(self._room.enter(guest))
            task = self._loop.create_task(self._connect(guest, link))
            self._coming.add(task)
            task.add_done_callback(self._coming.discard)

    async def _connect(self, guest: HttpConnection, link: socket.socket) -> None:
        try:
            await self._loop.connect_accepted_socket(partial(self._make, guest), link)
        except OSError:  # it has gone already
            link.close()
            guest.leave()

    def _go(self, guest: HttpConnection | None) -> None:
        if guest is not None:
            guest.go()
            self._lines.write({"event": "crowded"}, kind="crowded", most=1)

    def _wait(self) -> None:
        """Look at the port again in a while: by then the closed connection's file is free."""
        self._loop.remove_reader(self._made)
        self._again = self._loop.call_later(
            AGAIN_S, self._loop.add_reader, self._made, self._accept
        )


class _UvicornServer(uvicorn.Server):
    """A server that leaves signals to its process, and its port to a listener.

    Args:
        config: of uvicorn.
        door: takes connections in.
        make: makes the outermost protocol of each.
    """

    def __init__(self, config: uvicorn.Config, door: Acceptor, make: Make) -> None:
        super().__init__(config)
        self._door = door
        self._make = make

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Capture none: a clean end is exit 0."""
        yield

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Begin without a port, then open the door."""
        await super().startup(sockets or [])
        if self.started:
            self._door.open(self._connection)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Close the port, answer what was let in, and end every connection."""
        self._door.close()
        await super().shutdown(sockets or [])
        self._door.clear()

    def _connection(self, guest: HttpConnection) -> asyncio.Protocol:
        inner = partial(
            Patient,
            guest,
            config=self.config,
            server_state=self.server_state,
            app_state=self.lifespan.state,
        )
        return self._make(guest, inner)


def _plain(_: HttpConnection, inner: Callable[[], asyncio.Protocol]) -> asyncio.Protocol:
    return inner()


async def serve_until_signal(
    app: App,
    made: socket.socket,
    limits: AdmissionLimits,
    lines: Lines,
    *,
    make: Make = _plain,
    has_lifespan: bool = False,
) -> None:
    """Serve until SIGTERM or SIGINT.

    Args:
        app: answers; it says of each request that it lets in that it does (`guests.let_in`).
        made: listens; it is closed in the end.
        limits: of the listener.
        lines: where it is said that a connection had to go.
        make: makes the outermost protocol of a connection.
        has_lifespan: the application hears of the beginning and the end.

    Raises:
        EnvironmentFault: the process may not open files enough.
    """
    allowed = fitting(limits)
    config = uvicorn.Config(
        app,
        ws="none",
        lifespan="on" if has_lifespan else "off",
        log_config=None,
        log_level="critical",  # what strangers cause is not written but counted
        access_log=False,
        server_header=False,
        h11_max_incomplete_event_size=allowed.head,
        timeout_keep_alive=round(allowed.idle_s),
        timeout_graceful_shutdown=END_S,
        proxy_headers=False,  # no proxy is trusted
    )
    server = _UvicornServer(config, Acceptor(made, allowed, lines), make)

    def failed(_: asyncio.AbstractEventLoop, said: dict[str, Any]) -> None:
        """Write down that a connection failed: asyncio's own word has no bound."""
        what = type(said.get("exception")).__name__
        lines.write({"event": "fault", "what": what}, kind="fault")

    async def work(told: asyncio.Event) -> None:
        asyncio.get_running_loop().set_exception_handler(failed)
        serving = asyncio.ensure_future(server.serve(sockets=[]))
        waiting = asyncio.ensure_future(told.wait())
        await asyncio.wait((serving, waiting), return_when=asyncio.FIRST_COMPLETED)
        waiting.cancel()
        server.should_exit = True
        await serving

    await until_signal(work)
