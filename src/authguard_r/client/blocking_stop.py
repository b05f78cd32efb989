# SPDX-License-Identifier: Apache-2.0
"""A stop of a blocking client: sent at once over its own connection, also without a trust root.

Spec page: docs/spec/gate-protocol.md#a-stop-at-the-gate
"""

from __future__ import annotations

import asyncio
import socket
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from time import monotonic
from typing import Any

import msgspec

from authguard_r.client.session import ClientSession, answer_of, unreachable
from authguard_r.client.start import CHUNK, late
from authguard_r.client.stopping import StopEverywhere, StopReply, stop_of, stopped_of
from authguard_r.core.errors import AuthGuardError
from authguard_r.wire.messages import Kind, Stop, Stopped


class OwnLine:
    """A client's connection, as far as a stop goes.

    Args:
        line: the socket; it is closed once it is of no use.
        session: what its bytes mean.
    """

    def __init__(self, line: socket.socket, session: ClientSession) -> None:
        self._line = line
        self.session = session
        self._asked: int | None = None

    def send(self, stop: Stop) -> None:
        """Send a stop, and wait for nothing.

        Raises:
            AuthGuardError: the connection has broken, or the client's role stops nothing.
        """
        sent = self.session.request(Kind.STOP, stop)
        self._line.settimeout(0)
        try:
            is_whole = self._line.send(sent.data) == len(sent.data)
        except OSError:
            is_whole = False
        if not is_whole:  # half of it may be out: nothing sensible can follow
            self._end("the gate does not read")
        self._asked = sent.number

    async def ask(self, stop: Stop) -> Stopped:
        """Return the answer to a stop, which is sent unless it was.

        Raises:
            AuthGuardError: no answer comes.
        """
        if self._asked is None:
            self.send(stop)
        loop, news = asyncio.get_running_loop(), asyncio.Event()
        try:
            while (answer := self._answer()) is None:
                news.clear()
                loop.add_reader(self._line, news.set)
                try:
                    await news.wait()
                finally:
                    loop.remove_reader(self._line)
                self._read()  # not before: what is read in a task that is canceled would be lost
            return answer
        finally:
            self._forget()

    def wait(self, within_ms: int) -> Stopped:
        """Return the answer to the stop that was sent, without an event loop.

        Raises:
            AuthGuardError: no answer comes, or not in time.
        """
        end = monotonic() + within_ms / 1_000
        try:
            while (answer := self._answer()) is None:
                left = end - monotonic()
                if left <= 0:
                    raise late(within_ms)
                self._line.settimeout(left)
                self._read()
            return answer
        finally:
            self._forget()

    def _answer(self) -> Stopped | None:
        if self._asked is None:
            self.session.require_open()
            raise unreachable("no stop was sent")
        item = self.session.take(self._asked)
        return None if item is None else stopped_of(answer_of(item))

    def _forget(self) -> None:
        if self._asked is not None:
            self.session.abandon(self._asked)
            self._asked = None

    def _read(self) -> None:
        try:
            data = self._line.recv(CHUNK)
        except (BlockingIOError, TimeoutError):
            return
        except OSError as error:
            self._end(f"the connection failed: {error.strerror or error}")
            return
        if data:
            self.session.receive(data)
        else:
            self._end(None)

    def _end(self, why: str | None) -> None:
        self.session.end(None if why is None else unreachable(why))
        self._line.close()


def stop_now(path: Path, own: OwnLine, *, why: str, within_ms: int) -> dict[str, Any]:
    """Stop over a connection that is there and by the other part of its gate, and wait.

    Args:
        path: the socket that it leads to.
        own: the connection.
        why: for the log; decides nothing.
        within_ms: gives up after so long.

    Returns:
        Whether a controller was there and said that the robot stands, and after how long.

    Raises:
        AuthGuardError: no answer came in time.
    """
    stop = stop_of(path, own.session, own.ask, why)
    with suppress(AuthGuardError):  # the connection is of no use: another one is opened
        own.send(stop.stop)
    reached = _confirmed(stop, within_ms)
    said: dict[str, Any] = msgspec.to_builtins(
        own.wait(within_ms) if reached is None else reached.answer
    )
    return said


def _confirmed(stop: StopEverywhere, within_ms: int) -> StopReply | None:
    """Run a stop in an event loop of its own; the caller's, if one runs here, waits too.

    Returns:
        The best answer; None where no file or thread is left for an event loop.

    Raises:
        AuthGuardError: no answer came in time.
    """
    try:
        loop = asyncio.new_event_loop()
    except OSError:
        return None
    try:
        if not _has_loop():
            return _finished(loop, stop, within_ms)
        with ThreadPoolExecutor(1) as pool:
            try:
                future = pool.submit(_finished, loop, stop, within_ms)
            except RuntimeError:
                return None
            try:
                return future.result()
            except BaseException:  # an interrupt of this thread gives up the wait
                if not future.done():
                    loop.call_soon_threadsafe(_cancel_all, loop)
                raise
    finally:
        loop.close()


def _finished(loop: asyncio.AbstractEventLoop, stop: StopEverywhere, within_ms: int) -> StopReply:
    """Run a stop to its end; an interrupt ends it too."""
    task = loop.create_task(stop.confirmed(within_ms=within_ms))
    try:
        return loop.run_until_complete(task)
    finally:
        if not task.done():
            task.cancel()
            with suppress(asyncio.CancelledError):
                loop.run_until_complete(task)


def _cancel_all(loop: asyncio.AbstractEventLoop) -> None:
    for task in asyncio.all_tasks(loop):
        task.cancel()


def _has_loop() -> bool:
    try:
        asyncio.get_running_loop()
    except RuntimeError:
        return False
    return True
