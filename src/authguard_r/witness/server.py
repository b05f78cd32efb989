# SPDX-License-Identifier: Apache-2.0
"""The witness's listener: many connections, one thread, and no client waits for a slow one.

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
from types import FrameType
from typing import Any

from msgspec import Struct

from authguard_r.integrations.http_listener.admission import (
    AdmissionControl,
    AdmissionLimits,
    fitting,
)
from authguard_r.wire.json_log import Lines
from authguard_r.witness.exchange import MAX_HEAD, Broken, HttpRequest, RequestReader, answer_bytes
from authguard_r.witness.rules import MAX_BYTES
from authguard_r.witness.service import TEXT, Witness, WitnessResponse

PATH = "/add-checkpoint"
_CHUNK = 1 << 16
_CONTINUE = b"HTTP/1.1 100 Continue\r\n\r\n"


#: Of `authguard witness serve`.
LIMITS = AdmissionLimits(connections=256, idle_s=60.0, head=MAX_HEAD, body=MAX_BYTES)
#: Connections that are taken in before those that are there already have their turn.
AT_ONCE = 16
#: An end is heard within this, in seconds.
LINGER_S = 2.0


class WitnessReady(Struct, frozen=True, kw_only=True):
    """A witness that serves, as it says so: a gate's configuration takes `url` and `key`."""

    ready: bool
    name: str
    key: str
    url: str
    logs: int
    pid: int


class _WitnessConnection:
    """One connection."""

    def __init__(self, link: socket.socket, until: float) -> None:
        self.link = link
        self.reader = RequestReader()
        self.out = bytearray()
        self.until = until
        self.ends = False
        self.drains = False
        self.is_gone = False


class WitnessServer:
    """Serves a listening socket until a byte comes on another.

    Args:
        witness: whom the requests are for.
        listener: listens already.
        wake: readable once it is to end.
        journal: for a line of each request.
        limits: how many may be connected, and how long each may take.
    """

    def __init__(
        self,
        witness: Witness,
        listener: socket.socket,
        wake: socket.socket,
        *,
        journal: Lines,
        limits: AdmissionLimits,
    ) -> None:
        self._witness = witness
        self._listener = listener
        self._journal = journal
        self._limits = limits
        self._room: AdmissionControl[_WitnessConnection] = AdmissionControl(limits.connections)
        self._waiting: list[_WitnessConnection] = []
        self._is_ending = False
        self._selector = selectors.DefaultSelector()
        listener.settimeout(0)
        self._selector.register(listener, selectors.EVENT_READ, self._accept)
        self._selector.register(wake, selectors.EVENT_READ, self._end)

    def serve(self) -> None:
        """Serve; what was judged before the end is still answered."""
        try:
            while self._room.guests or not self._is_ending:
                for key, _ in self._selector.select(self._pause()):
                    act: Callable[[], None] = key.data
                    act()
                waiting, self._waiting = self._waiting, []
                for line in waiting:
                    self._next(line)
                self._drop_late()
        finally:
            for line in self._room.guests:
                self._drop(line)
            self._selector.close()

    def _pause(self) -> float | None:
        if self._waiting:
            return 0
        soonest = min((line.until for line in self._room.guests), default=None)
        return None if soonest is None else max(0.0, soonest - time.monotonic())

    def _accept(self) -> None:
        for _ in range(AT_ONCE):
            try:
                link, _ = self._listener.accept()
            except OSError as error:  # it is gone already, or there are no more files
                if error.errno in {EMFILE, ENFILE}:
                    self._make_room(self._room.spare())
                return
            self._take(link)

    def _take(self, link: socket.socket) -> None:
        link.settimeout(0)
        line = _WitnessConnection(link, time.monotonic() + self._limits.first_s)
        self._make_room(self._room.enter(line))
        self._selector.register(link, selectors.EVENT_READ, partial(self._read, line))

    def _make_room(self, gone: _WitnessConnection | None) -> None:
        if gone is not None:
            self._drop(gone)
            self._journal.write({"event": "crowded"}, kind="crowded", most=1)

    def _read(self, line: _WitnessConnection) -> None:
        if line.is_gone:
            return
        try:
            data = line.link.recv(_CHUNK)
        except OSError:
            data = b""
        if not data:
            self._drop(line)
        elif not line.drains:
            if line.reader.is_empty:
                line.until = time.monotonic() + self._limits.first_s
            line.reader.feed(data)
            self._next(line)

    def _next(self, line: _WitnessConnection) -> None:
        """Answer the next request of a connection, if it is there."""
        if line.is_gone:
            return
        asked = line.reader.next()
        if asked is None:
            if line.reader.waits:
                line.reader.waits = False
                with suppress(OSError):  # nothing else is on its way, so it fits
                    line.link.send(_CONTINUE)
            return
        stays = isinstance(asked, HttpRequest) and asked.stays and not self._is_ending
        answer = self._answered(asked)
        bodiless = isinstance(asked, HttpRequest) and asked.method == "HEAD"
        line.out += answer_bytes(
            answer.status, answer.content, answer.body, stays=stays, bodiless=bodiless
        )
        line.ends = not stays
        self._room.stir(line)
        line.until = time.monotonic() + self._limits.take_s
        self._write(line)

    def _write(self, line: _WitnessConnection) -> None:
        if line.is_gone:
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

    def _written(self, line: _WitnessConnection) -> None:
        """Go on with a connection that has its answer."""
        now = time.monotonic()
        if line.ends:
            # closed at once, what it still sends would make the system throw the answer away
            line.drains, line.until = True, now + LINGER_S
            with suppress(OSError):
                line.link.shutdown(socket.SHUT_WR)
        elif line.reader.is_empty:
            line.until = now + self._limits.idle_s
        else:
            line.until = now + self._limits.first_s
            self._waiting.append(line)

    def _answered(self, asked: HttpRequest | Broken) -> WitnessResponse:
        try:
            answer = self._judged(asked)
        except Exception as error:  # noqa: BLE001 - a fault of ours is an answer that signs nothing
            told: dict[str, Any] = {"event": "fault", "what": type(error).__name__}
            answer = WitnessResponse(status=500, body=b"a fault of the witness\n", told=told)
        # who shows no log's signature must not hide what one says that does
        kind = "" if {"log", "what"} & answer.told.keys() else "refused"
        self._journal.write({**answer.told, "status": answer.status}, kind=kind)
        return answer

    def _judged(self, asked: HttpRequest | Broken) -> WitnessResponse:
        if isinstance(asked, Broken):
            return _refused(asked.status)
        if asked.target != PATH:
            return _refused(HTTPStatus.NOT_FOUND)
        if asked.method != "POST":
            return _refused(HTTPStatus.METHOD_NOT_ALLOWED)
        return self._witness.answer(asked.body, time.time_ns() // 1_000_000_000)

    def _watch(
        self, line: _WitnessConnection, events: int, act: Callable[[_WitnessConnection], None]
    ) -> None:
        self._selector.modify(line.link, events, partial(act, line))

    def _drop_late(self) -> None:
        now = time.monotonic()
        for line in [line for line in self._room.guests if line.until <= now]:
            self._drop(line)

    def _drop(self, line: _WitnessConnection) -> None:
        self._room.leave(line)
        line.is_gone = True
        self._selector.unregister(line.link)
        line.link.close()

    def _end(self) -> None:
        """Accept no more connections, and end those that have no answer coming."""
        self._is_ending = True
        for key in tuple(self._selector.get_map().values()):
            if key.data in (self._accept, self._end):
                self._selector.unregister(key.fileobj)
        for line in self._room.guests:
            line.ends = True
            if not line.out:
                self._drop(line)


def run_witness(
    witness: Witness,
    made: socket.socket,
    ready: Callable[[WitnessReady], None],
    *,
    journal: Lines,
    limits: AdmissionLimits = LIMITS,
) -> None:
    """Serve until SIGTERM or SIGINT; the main thread's work.

    Args:
        witness: held; the caller lets it go.
        made: listens.
        ready: called once clients can connect.
        journal: for a line of each request.
        limits: how many may be connected, and how long each may take.

    Raises:
        EnvironmentFault: the process may not open files enough.
    """
    woken, waking = socket.socketpair()
    waking.settimeout(0)
    with woken, waking, _ended_by(waking.fileno(), signal.SIGTERM, signal.SIGINT):
        server = WitnessServer(witness, made, woken, journal=journal, limits=fitting(limits))
        host, port, *_ = made.getsockname()
        identity = witness.book.identity
        told = WitnessReady(
            ready=True,
            name=identity.name,
            key=identity.key,
            url=f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}",
            logs=witness.book.count,
            pid=os.getpid(),
        )
        ready(told)
        server.serve()


def _refused(status: int) -> WitnessResponse:
    body = f"{HTTPStatus(status).phrase}\n".encode("ascii")
    return WitnessResponse(status=status, content=TEXT, body=body, told={"event": "refused"})


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
