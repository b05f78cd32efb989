# SPDX-License-Identifier: Apache-2.0
"""Keeps a stop process serving for as long as the gate does, and hears of every stop.

A stop process that dies is started again, and one that hangs is replaced. At the end no stop
process that a gate started is left; one that was started by hand serves on.
Spec page: docs/spec/gate-protocol.md#stop-lane
"""

from __future__ import annotations

import asyncio
import math
import subprocess
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Protocol

from authguard_r.core.errors import AuthGuardError
from authguard_r.estop.connection import EStopConnection, start_stop_process
from authguard_r.estop.files import CONFIG, EStopFiles, config_digest
from authguard_r.estop.run_folder import (
    SOCKET,
    await_end,
    end_stop_process,
    is_of_gate,
    is_served,
    kill,
)
from authguard_r.wire.gate_limits import LIMITS
from authguard_r.wire.messages import StopHeard


class StopListener(Protocol):
    """Who wants to hear of stops."""

    def stopped(self, heard: StopHeard) -> None:
        """Record a stop that was carried out."""
        ...

    @property
    def settled(self) -> bool:
        """True when everything that was heard has taken its effect on disk."""
        ...

    def stop_process_lost(self, why: AuthGuardError | None) -> None:
        """Report that stops are not heard of any more."""
        ...

    def stop_process_silent(self, *, is_silent: bool) -> None:
        """Say whether a connected stop process answers; called when that changes."""
        ...


class EStopSupervisor:
    """One robot's stop process, as its gate keeps it.

    Args:
        files: what a stop process is started with.
    """

    def __init__(self, files: EStopFiles) -> None:
        self._files = files
        self._started: list[subprocess.Popen[bytes]] = []
        self._link: EStopConnection | None = None
        self._asked_s: float | None = None  # when it was asked what it has not answered
        self._answered_s = -math.inf  # when it was asked what it answered last
        self._looks = 0  # without an answer

    @property
    def alive(self) -> bool:
        """True while the stop process answers in time: a stop would be carried out."""
        return time.monotonic() - self._answered_s <= LIMITS.stop_within_s

    def start(self) -> None:
        """Start a stop process unless one serves.

        Raises:
            EnvironmentFault: none serves and none can be started.
        """
        retire_stale(self._files)
        started = start_stop_process(self._files)
        if started is not None:
            self._started.append(started)

    def end(self) -> None:
        """End the stop process that this gate or one before it started.

        Raises:
            EnvironmentFault: it does not end.
        """
        if is_of_gate(self._files.run):
            end_stop_process(self._files.run)
        for process in self._started:
            process.terminate()
            try:
                process.wait(LIMITS.stop_end_s)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def sync(self, done: Callable[[], None]) -> bool:
        """Ask whether every stop that the stop process made was heard of; False when none serves.

        Args:
            done: called when it was.
        """
        if self._link is None or not self._link.connected:
            return False
        self._link.sync(done)
        return True

    async def keep(self, listener: StopListener, connected: Callable[[], None]) -> None:
        """Be connected, and again whenever the connection was lost, until canceled.

        Args:
            listener: hears of every stop, and of the stop process's loss.
            connected: called whenever stops are heard of from now on.
        """
        while True:
            lost = asyncio.Event()
            try:
                close = await self._connect(listener, lost)
            except AuthGuardError as error:
                listener.stop_process_lost(error)
                await asyncio.sleep(LIMITS.stop_retry_s)
                await self._restart()
                continue
            connected()
            try:
                await self._watch(listener, lost)
            finally:
                close()
            await self._restart()

    async def _watch(self, listener: StopListener, lost: asyncio.Event) -> None:
        """Ask the stop process again and again whether it works, until the connection is lost."""
        self._asked_s, is_told = None, False
        listener.stop_process_silent(is_silent=False)
        while not lost.is_set():
            if not self._is_asked:  # one question at a time: a stop process that hangs gets no heap
                self._ask_again()
            with suppress(TimeoutError):
                async with asyncio.timeout(
                    LIMITS.stop_ask_s
                ):  # `wait_for` can lose a cancellation (3.11)
                    await lost.wait()
            self._looks += 1
            waits = self._is_asked and not lost.is_set()
            if is_told is not (waits and self._looks >= LIMITS.stop_silent_looks):
                is_told = not is_told
                listener.stop_process_silent(is_silent=is_told)
            if waits and self._looks >= LIMITS.stop_replaced_looks and listener.settled:
                self._replace()

    def _replace(self) -> None:
        """Kill a stop process that hangs; its end is noticed, and another one started."""
        if self._link is not None and self._link.pid is not None:
            kill(self._link.pid)

    @property
    def _is_asked(self) -> bool:
        return self._asked_s is not None

    def _ask_again(self) -> None:
        self._looks, self._asked_s = 0, time.monotonic()
        self.sync(self._answered)

    def _answered(self) -> None:
        self._answered_s, self._asked_s = self._asked_s or -math.inf, None
        if time.monotonic() - self._answered_s > LIMITS.stop_ask_s:  # this process was late
            self._ask_again()

    async def _connect(self, listener: StopListener, lost: asyncio.Event) -> Callable[[], None]:
        """Connect; return a function that reports the last recorded stops and closes the line."""
        recorded: list[int] = []

        def on_stop(heard: StopHeard) -> None:
            listener.stopped(heard)
            if not recorded:  # one message for many: a flood of stops waits in the stop process
                loop.call_later(LIMITS.stop_heard_s, say)
            recorded.append(heard.n)

        def say() -> None:
            """Say what is recorded, unless a suspension is owed; then the stop is sent again.

            A gate that dies meanwhile has it on no disk of its own.
            """
            if recorded and listener.settled:
                for n in recorded:
                    link.heard(n)
                recorded.clear()
            elif recorded and not lost.is_set():
                loop.call_later(LIMITS.stop_heard_s, say)

        def on_lost(why: AuthGuardError | None) -> None:
            if not lost.is_set():
                listener.stop_process_lost(why)
                lost.set()

        def close() -> None:
            lost.set()  # what ends now is our own doing
            say()
            link.close()

        loop = asyncio.get_running_loop()
        link = EStopConnection(self._files.run / SOCKET, on_stop, on_lost)
        await link.connect()
        self._link = link
        return close

    async def _restart(self) -> None:
        """Start it again beside the loop: leases go on being looked at meanwhile."""
        # a process that is ending may still accept a connection
        if self._link is not None and self._link.pid is not None:
            await asyncio.to_thread(await_end, self._link.pid, LIMITS.stop_within_s)
        for process in self._started:
            process.poll()  # reaps one that ended
        try:
            await asyncio.to_thread(self.start)
        except AuthGuardError:
            await asyncio.sleep(LIMITS.stop_retry_s)


def retire_stale(files: EStopFiles) -> None:
    """End a stop process that serves with another configuration: its users are other ones.

    Raises:
        EnvironmentFault: it does not end.
    """
    if is_served(files.run / SOCKET) and _config_of(files) != config_digest(files):
        end_stop_process(files.run)


def _config_of(files: EStopFiles) -> str | None:
    try:
        return (files.run / CONFIG).read_text()
    except OSError:
        return None
