# SPDX-License-Identifier: Apache-2.0
"""Keeps a stop lane serving for as long as the gate does, and hears of every stop.

A lane that dies is started again; one that another gate started is adopted and left alone at the
end. Spec page: docs/spec/gate-protocol.md#stop-lane
"""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Protocol

from authguard_r.core.errors import AuthGuardError, EnvironmentFault
from authguard_r.core.reasons import Reason
from authguard_r.gate.lane.link import LaneLink, start_lane
from authguard_r.gate.lane.place import PID, SOCKET, is_served
from authguard_r.gate.lane.run import CONFIG, LaneFiles, config_digest
from authguard_r.wire.messages import StopHeard

#: A lane that is gone is looked for this often, in seconds.
RETRY_S = 1.0
#: A lane that is told to end is gone within this, in seconds.
RETIRE_S = 5.0
#: The lane is told what is recorded this often, in seconds; it sends at most 32 stops before.
HEARD_S = 0.1
#: A lane is asked whether it is there this often, in seconds; a process that hangs stays connected.
ASK_S = 1.0
#: One that has not answered after this long is silent, in seconds; a stop takes it one at most.
SILENT_S = 5.0


class Listener(Protocol):
    """Who wants to hear of stops."""

    def stopped(self, heard: StopHeard) -> None:
        """Record a stop that was carried out."""
        ...

    @property
    def settled(self) -> bool:
        """True when everything that was heard has taken its effect on disk."""
        ...

    def lane_lost(self, why: AuthGuardError | None) -> None:
        """Say that no stop is heard of."""
        ...

    def lane_silent(self, *, is_silent: bool) -> None:
        """Say whether the lane, which is connected, does not answer; told when that changes."""
        ...


class LaneKeeper:
    """One robot's stop lane, as its gate keeps it.

    Args:
        files: what a lane is started with.
    """

    def __init__(self, files: LaneFiles) -> None:
        self._files = files
        self._started: list[subprocess.Popen[bytes]] = []
        self._link: LaneLink | None = None
        self._asked_s: float | None = None  # when it was asked what it has not answered

    @property
    def alive(self) -> bool:
        """True while a lane is connected and answers."""
        late = self._asked_s is not None and time.monotonic() - self._asked_s >= SILENT_S
        return self._link is not None and self._link.connected and not late

    def start(self) -> None:
        """Start a lane unless one serves.

        Raises:
            EnvironmentFault: none serves and none can be started.
        """
        retire_stale(self._files)
        started = start_lane(self._files)
        if started is not None:
            self._started.append(started)

    def end(self) -> None:
        """End what was started here; a lane that was adopted serves on."""
        for process in self._started:
            process.terminate()
            process.wait()

    def sync(self, done: Callable[[], None]) -> bool:
        """Ask whether every stop that the lane made was heard of; False when none serves.

        Args:
            done: called when it was.
        """
        if self._link is None or not self._link.connected:
            return False
        self._link.sync(done)
        return True

    async def keep(self, listener: Listener, connected: Callable[[], None]) -> None:
        """Be connected, and again whenever the connection was lost, until canceled.

        Args:
            listener: hears of every stop, and of the lane's loss.
            connected: called whenever stops are heard of from now on.
        """
        while True:
            lost = asyncio.Event()
            try:
                close = await self._connect(listener, lost)
            except AuthGuardError as error:
                listener.lane_lost(error)
                await asyncio.sleep(RETRY_S)
                await self._restart()
                continue
            connected()
            try:
                await self._watch(listener, lost)
            finally:
                close()
            await self._restart()

    async def _watch(self, listener: Listener, lost: asyncio.Event) -> None:
        """Ask the lane whether it is there, again and again, until the connection is lost."""
        self._asked_s, is_told = None, False
        listener.lane_silent(is_silent=False)
        while not lost.is_set():
            if self._asked_s is None:  # one question at a time: a lane that hangs gets no heap
                self._asked_s = time.monotonic()
                self.sync(self._answered)
            with suppress(TimeoutError):
                async with asyncio.timeout(ASK_S):  # `wait_for` can lose a cancellation (3.11)
                    await lost.wait()
            is_silent = not (self.alive or lost.is_set())
            if is_silent is not is_told:
                listener.lane_silent(is_silent=is_silent)
            is_told = is_silent

    def _answered(self) -> None:
        self._asked_s = None

    async def _connect(self, listener: Listener, lost: asyncio.Event) -> Callable[[], None]:
        """Return what says that the last stops are recorded, and lets go of the lane."""
        recorded: list[int] = []

        def on_stop(heard: StopHeard) -> None:
            listener.stopped(heard)
            if not recorded:  # one word for all of a moment: a flood of stops waits in the lane
                loop.call_later(HEARD_S, say)
            recorded.append(heard.n)

        def say() -> None:
            """Say what is recorded, unless a suspension is owed: the lane tells of it again then.

            A gate that dies meanwhile has it on no disk of its own.
            """
            if recorded and listener.settled:
                for n in recorded:
                    link.heard(n)
                recorded.clear()
            elif recorded and not lost.is_set():
                loop.call_later(HEARD_S, say)

        def on_lost(why: AuthGuardError | None) -> None:
            if not lost.is_set():
                listener.lane_lost(why)
                lost.set()

        def close() -> None:
            lost.set()  # what ends now is our own doing
            say()
            link.close()

        loop = asyncio.get_running_loop()
        link = LaneLink(self._files.run / SOCKET, on_stop, on_lost)
        await link.connect()
        self._link = link
        return close

    async def _restart(self) -> None:
        """Start it again beside the loop: leases go on being looked at meanwhile."""
        for process in self._started:
            process.poll()  # reaps one that ended
        try:
            await asyncio.to_thread(self.start)
        except AuthGuardError:
            await asyncio.sleep(RETRY_S)


def retire_stale(files: LaneFiles) -> None:
    """End a lane that serves by another configuration than this one: its users are not these.

    Raises:
        EnvironmentFault: it does not end.
    """
    place = files.run / SOCKET
    if not is_served(place) or _config_of(files) == config_digest(files):
        return
    with suppress(OSError, ValueError):
        os.kill(int((files.run / PID).read_text()), signal.SIGTERM)
    until = time.monotonic() + RETIRE_S
    while is_served(place):
        if time.monotonic() > until:
            raise EnvironmentFault(
                "a stop lane serves by another configuration and does not end: end it",
                reason=Reason.STORE_UNAVAILABLE,
                where=str(files.run / PID),
            )
        time.sleep(RETIRE_S / 100)


def _config_of(files: LaneFiles) -> str | None:
    try:
        return (files.run / CONFIG).read_text()
    except OSError:
        return None
