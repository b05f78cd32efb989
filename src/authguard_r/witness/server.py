# SPDX-License-Identifier: Apache-2.0
"""The witness's door: many connections, one thread, and nobody waits for somebody who is slow.

Requests are judged one after the other anyway, so more threads would only wait for each other. A
connection has a time for its request, for taking its answer and for saying nothing; when there
are too many, the one that got nothing done for longest makes room.
Spec page: docs/spec/witness.md#http
"""

from __future__ import annotations

import os
import selectors
import signal
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from errno import EMFILE, ENFILE
from functools import partial
from http import HTTPStatus
from ipaddress import IPv4Address, IPv6Address, ip_address
from types import FrameType
from typing import Any

from msgspec import Struct

from authguard_r.core.errors import EnvironmentFault, MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.witness.desk import TEXT, Answer, Witness
from authguard_r.witness.exchange import Broken, Reader, Request, answer_bytes
from authguard_r.witness.journal import Journal

PATH = "/add-checkpoint"
_CHUNK = 1 << 16
_QUEUE = 128
_CONTINUE = b"HTTP/1.1 100 Continue\r\n\r\n"


class Limits(Struct, frozen=True, kw_only=True):
    """How many connections there are, and how long each may take, in seconds.

    Args:
        connections: at one time.
        request_s: from a request's first byte to its last; also until the first one begins.
        idle_s: between two requests.
        answer_s: for taking an answer.
        linger_s: for hearing that the connection ends.
    """

    connections: int = 256
    request_s: float = 10.0
    idle_s: float = 60.0
    answer_s: float = 10.0
    linger_s: float = 2.0


class Address(Struct, frozen=True):
    """Where a witness listens."""

    host: IPv4Address | IPv6Address
    port: int

    def text(self) -> str:
        """Return it as it stands in a URL."""
        return (
            f"[{self.host}]:{self.port}" if self.host.version == 6 else f"{self.host}:{self.port}"
        )


class Ready(Struct, frozen=True, kw_only=True):
    """A witness that serves, as it says so: a gate's configuration takes `url` and `key`."""

    ready: bool
    name: str
    key: str
    url: str
    logs: int
    pid: int


class _Line:
    """One connection."""

    def __init__(self, link: socket.socket, now: float, until: float) -> None:
        self.link = link
        self.reader = Reader()
        self.out = bytearray()
        self.since = now
        self.until = until
        self.ends = False
        self.drains = False


class Server:
    """Serves a listening socket until a byte comes on another.

    Args:
        witness: whom the requests are for.
        listener: listens already.
        wake: readable once it is to end.
        journal: for a line of each request.
        limits: of connections and times.
    """

    def __init__(
        self,
        witness: Witness,
        listener: socket.socket,
        wake: socket.socket,
        *,
        journal: Journal,
        limits: Limits,
    ) -> None:
        self._witness = witness
        self._listener = listener
        self._journal = journal
        self._limits = limits
        self._lines: set[_Line] = set()
        self._waiting: list[_Line] = []
        self._is_ending = False
        self._selector = selectors.DefaultSelector()
        listener.settimeout(0)
        self._selector.register(listener, selectors.EVENT_READ, self._accept)
        self._selector.register(wake, selectors.EVENT_READ, self._end)

    def serve(self) -> None:
        """Serve; what was judged before the end is still answered."""
        try:
            while self._lines or not self._is_ending:
                for key, _ in self._selector.select(self._pause()):
                    act: Callable[[], None] = key.data
                    act()
                waiting, self._waiting = self._waiting, []
                for line in waiting:
                    self._next(line)
                self._drop_late()
        finally:
            for line in tuple(self._lines):
                self._drop(line)
            self._selector.close()

    def _pause(self) -> float | None:
        if self._waiting:
            return 0
        soonest = min((line.until for line in self._lines), default=None)
        return None if soonest is None else max(0.0, soonest - time.monotonic())

    def _accept(self) -> None:
        try:
            link, _ = self._listener.accept()
        except OSError as error:  # it is gone already, or there are no more files
            self._make_room(0 if error.errno in {EMFILE, ENFILE} else self._limits.connections)
        else:
            self._take(link)

    def _take(self, link: socket.socket) -> None:
        self._make_room(self._limits.connections - 1)
        link.settimeout(0)
        now = time.monotonic()
        line = _Line(link, now, now + self._limits.request_s)
        self._lines.add(line)
        self._selector.register(link, selectors.EVENT_READ, partial(self._read, line))

    def _make_room(self, most: int) -> None:
        """Drop one connection if there are more than that."""
        if len(self._lines) > most:
            self._drop(min(self._lines, key=lambda line: line.since))

    def _read(self, line: _Line) -> None:
        if line not in self._lines:
            return
        try:
            data = line.link.recv(_CHUNK)
        except OSError:
            data = b""
        if not data:
            self._drop(line)
        elif not line.drains:
            if line.reader.is_empty:
                line.until = time.monotonic() + self._limits.request_s
            line.reader.feed(data)
            self._next(line)

    def _next(self, line: _Line) -> None:
        """Answer the next request of a connection, if it is there."""
        if line not in self._lines:
            return
        asked = line.reader.next()
        if asked is None:
            if line.reader.waits:
                line.reader.waits = False
                with suppress(OSError):  # nothing else is on its way, so it fits
                    line.link.send(_CONTINUE)
            return
        stays = isinstance(asked, Request) and asked.stays and not self._is_ending
        answer = self._answered(asked)
        bodiless = isinstance(asked, Request) and asked.method == "HEAD"
        line.out += answer_bytes(
            answer.status, answer.content, answer.body, stays=stays, bodiless=bodiless
        )
        line.ends = not stays
        line.since = time.monotonic()
        line.until = line.since + self._limits.answer_s
        self._write(line)

    def _write(self, line: _Line) -> None:
        if line not in self._lines:
            return
        try:
            sent = line.link.send(line.out)
        except BlockingIOError:
            sent = 0
        except OSError:
            self._drop(line)
            return
        del line.out[:sent]
        if line.out:
            self._watch(line, selectors.EVENT_WRITE, self._write)
        else:
            self._watch(line, selectors.EVENT_READ, self._read)
            self._written(line)

    def _written(self, line: _Line) -> None:
        """Go on with a connection that has its answer."""
        now = time.monotonic()
        if line.ends:
            # closed at once, what it still sends would make the system throw the answer away
            line.drains, line.until = True, now + self._limits.linger_s
            with suppress(OSError):
                line.link.shutdown(socket.SHUT_WR)
        elif line.reader.is_empty:
            line.until = now + self._limits.idle_s
        else:
            line.until = now + self._limits.request_s
            self._waiting.append(line)

    def _answered(self, asked: Request | Broken) -> Answer:
        try:
            answer = self._judged(asked)
        except Exception as error:  # noqa: BLE001 - a fault of ours is an answer that signs nothing
            told: dict[str, Any] = {"event": "fault", "what": type(error).__name__}
            answer = Answer(status=500, body=b"a fault of the witness\n", told=told)
        self._journal.write({**answer.told, "status": answer.status}, time.time_ns() // 1_000_000)
        return answer

    def _judged(self, asked: Request | Broken) -> Answer:
        if isinstance(asked, Broken):
            return _refused(asked.status)
        if asked.target != PATH:
            return _refused(HTTPStatus.NOT_FOUND)
        if asked.method != "POST":
            return _refused(HTTPStatus.METHOD_NOT_ALLOWED)
        return self._witness.answer(asked.body, time.time_ns() // 1_000_000_000)

    def _watch(self, line: _Line, events: int, act: Callable[[_Line], None]) -> None:
        self._selector.modify(line.link, events, partial(act, line))

    def _drop_late(self) -> None:
        now = time.monotonic()
        for line in [line for line in self._lines if line.until <= now]:
            self._drop(line)

    def _drop(self, line: _Line) -> None:
        self._lines.discard(line)
        self._selector.unregister(line.link)
        line.link.close()

    def _end(self) -> None:
        """Take nobody in any more, and let those go who have no answer coming."""
        self._is_ending = True
        for key in tuple(self._selector.get_map().values()):
            if key.data in (self._accept, self._end):
                self._selector.unregister(key.fileobj)
        for line in tuple(self._lines):
            line.ends = True
            if not line.out:
                self._drop(line)


def read_address(text: str, *, behind_tls: bool) -> Address:
    """Return where to listen.

    Args:
        text: `127.0.0.1:8080` or `[::1]:8080`; port 0 is any that is free.
        behind_tls: it may be an address that others reach.

    Raises:
        MalformedError: it is none, or others could reach it in the clear.
    """
    host, _, port = text.rpartition(":")
    try:
        address = Address(ip_address(host.removeprefix("[").removesuffix("]")), int(port))
    except ValueError as error:
        raise MalformedError("expected an address and a port", where="--listen") from error
    if not (0 <= address.port < 1 << 16 and address.text() == text):
        raise MalformedError("expected an address and a port", where="--listen")
    if not (address.host.is_loopback or behind_tls):
        raise MalformedError(
            "expected an address of this machine alone; others come through a proxy that ends "
            "TLS: --behind-tls",
            where="--listen",
        )
    return address


def listen(address: Address) -> socket.socket:
    """Return a socket that listens there.

    Raises:
        EnvironmentFault: it cannot.
    """
    family = socket.AF_INET6 if address.host.version == 6 else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((str(address.host), address.port))
        listener.listen(_QUEUE)
    except OSError as error:
        listener.close()
        raise EnvironmentFault(
            f"cannot listen: {error.strerror or error}",
            reason=Reason.STORE_UNAVAILABLE,
            where=address.text(),
        ) from error
    return listener


def run_witness(
    witness: Witness,
    address: Address,
    ready: Callable[[Ready], None],
    *,
    journal: Journal,
    limits: Limits | None = None,
) -> None:
    """Serve until SIGTERM or SIGINT; the main thread's work.

    Args:
        witness: held; the caller lets it go.
        address: where to listen.
        ready: called once clients can connect.
        journal: for a line of each request.
        limits: of connections and times.

    Raises:
        EnvironmentFault: nothing can listen there.
    """
    with listen(address) as listener:
        woken, waking = socket.socketpair()
        waking.settimeout(0)
        with woken, waking, _ended_by(waking.fileno(), signal.SIGTERM, signal.SIGINT):
            server = Server(witness, listener, woken, journal=journal, limits=limits or Limits())
            bound = Address(address.host, listener.getsockname()[1])
            identity = witness.book.identity
            told = Ready(
                ready=True,
                name=identity.name,
                key=identity.key,
                url=f"http://{bound.text()}",
                logs=witness.book.count,
                pid=os.getpid(),
            )
            ready(told)
            server.serve()


def _refused(status: int) -> Answer:
    body = f"{HTTPStatus(status).phrase}\n".encode("ascii")
    return Answer(status=status, content=TEXT, body=body, told={"event": "refused"})


@contextmanager
def _ended_by(wake: int, *signals: signal.Signals) -> Iterator[None]:
    """Let signals wake the loop instead of breaking into it."""

    def nothing(number: int, frame: FrameType | None) -> None:
        """The number written to the wake-up file is all that counts."""

    before: list[tuple[signal.Signals, Any]] = [(n, signal.signal(n, nothing)) for n in signals]
    known = signal.set_wakeup_fd(wake)
    try:
        yield
    finally:
        signal.set_wakeup_fd(known)
        for number, handler in before:
            signal.signal(number, handler)
