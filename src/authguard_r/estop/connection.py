# SPDX-License-Identifier: Apache-2.0
"""The gate's end of its stop process: it starts one where none serves, and hears of every stop.

A stop process outlives the gate that started it; the next gate finds it and adopts it.
Spec page: docs/spec/gate-protocol.md#stop-lane
"""

from __future__ import annotations

import asyncio
import os
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import IO, cast

import msgspec

from authguard_r.access.peers import peer_of
from authguard_r.core.errors import (
    AuthenticityError,
    AuthGuardError,
    EnvironmentFault,
    MalformedError,
)
from authguard_r.core.reasons import Reason
from authguard_r.estop.files import EStopFiles, ask
from authguard_r.estop.run_folder import SOCKET, is_readable, is_served
from authguard_r.wire.faults import from_fault
from authguard_r.wire.frames import Frame, FrameReader, frame, read_body
from authguard_r.wire.gate_limits import LIMITS
from authguard_r.wire.messages import (
    PROTOCOL,
    ClientRole,
    Fault,
    Heard,
    Hello,
    Kind,
    Nothing,
    StopHeard,
    Welcome,
)
from authguard_r.wire.sockets import reach

#: What the stop process says when it ended a connection goes here, in the run folder.
LOG = "stop-lane.log"
_MAIN = "import sys; from authguard_r.estop.main import main; sys.exit(main(sys.argv[1:]))"
_BOUND = {int(kind): 1 << 13 for kind in (Kind.WELCOME, Kind.EVENT, Kind.REPLY, Kind.ERROR)}


def start_stop_process(files: EStopFiles) -> subprocess.Popen[bytes] | None:
    """Start a stop process in a session of its own and wait until it serves; None if one serves.

    The process inherits no open file and no session; who keeps the result can reap it.

    Raises:
        EnvironmentFault: it does not serve; nothing of it is left.
    """
    if is_served(files.run / SOCKET):
        return None
    words = [sys.executable, "-c", _MAIN, ask(files)]
    flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC | os.O_NOFOLLOW
    try:
        log = os.open(files.run / LOG, flags, 0o600)
        try:
            process = subprocess.Popen(  # noqa: S603 - our own program, no shell
                words,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=log,
                cwd="/",
                start_new_session=True,
            )
        finally:
            os.close(log)
    except OSError as error:
        raise _unstarted(error.strerror or str(error)) from error
    return _ready(process)


def _ready(process: subprocess.Popen[bytes]) -> subprocess.Popen[bytes]:
    """Return the process once its first line says that it serves."""
    with cast("IO[bytes]", process.stdout) as told:
        line = told.readline() if is_readable(told.fileno(), LIMITS.stop_start_s) else b""
    try:
        said = msgspec.json.decode(line, type=dict[str, object])
    except msgspec.DecodeError:
        said = {}
    if said.get("ready") is True:
        return process
    process.kill()
    process.wait()
    raise _unstarted(_why(said.get("error")))


def _why(error: object) -> str:
    """Return the stop process's own words, as its first line says them."""
    if not isinstance(error, dict):
        return "it does not say that it serves"
    place = f" (at {error['where']})" if error.get("where") else ""
    return f"{error.get('message')}{place}"


class EStopConnection(asyncio.Protocol):
    """The gate's connection to its stop process.

    Args:
        path: the stop socket.
        on_stop: called for each stop, suspending ones first, each of the two kinds in order; one
            that was recorded before may come again after a crash, with the same `epoch` and `n`.
        on_lost: called when the connection ends, with the reason if there is one.
    """

    def __init__(
        self,
        path: Path,
        on_stop: Callable[[StopHeard], None],
        on_lost: Callable[[AuthGuardError | None], None] = lambda _: None,
    ) -> None:
        self._path = path
        self._on_stop = on_stop
        self._on_lost = on_lost
        self._reader = FrameReader(lambda kind: _BOUND.get(kind, 0))
        self._line: asyncio.Transport | None = None
        self._why: AuthGuardError | None = None
        self._asked: dict[int, Callable[[], None]] = {}
        self._number = 0
        self.welcome: Welcome | None = None
        self.pid: int | None = None  # the stop process's process, as the kernel says

    @property
    def connected(self) -> bool:
        """True while the stop process answers."""
        return self._line is not None

    async def connect(self) -> None:
        """Connect; stops come from then on.

        Raises:
            EnvironmentFault: no stop process serves there.
            AuthenticityError: another user's process serves there.
        """
        wire = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            async with asyncio.timeout(LIMITS.stop_connect_s):
                await reach(wire, self._path)
            line, _ = await asyncio.get_running_loop().create_unix_connection(
                lambda: self, sock=wire
            )
        except OSError as error:
            wire.close()
            raise _unstarted(error.strerror or str(error) or "its queue is full") from error
        owner = peer_of(line.get_extra_info("socket"))
        if owner.uid != os.geteuid():
            line.abort()
            raise AuthenticityError(
                f"user {owner.uid} serves the stop socket, not the gate's own",
                reason=Reason.ROLE_DENIED,
                where=str(self._path),
            )
        hello = Hello(protocol=PROTOCOL, role=ClientRole.GATE, client="gate")
        line.write(frame(Kind.HELLO, 0, hello))
        self._line, self.pid = line, owner.pid

    def heard(self, n: int) -> None:
        """Say that this stop, and no other, is recorded; the stop process forgets it."""
        self._say(Kind.HEARD, 0, Heard(n=n))

    def sync(self, done: Callable[[], None]) -> None:
        """Ask whether every suspending stop so far was reported.

        Args:
            done: called when `on_stop` was called for every suspending stop that a controller had
                carried out for this stop process before now; never when the connection is lost
                first.
        """
        if self._line is None:
            return
        self._number += 1
        self._asked[self._number] = done
        if self.welcome is not None:
            self._say(Kind.SYNC, self._number, Nothing())

    def close(self) -> None:
        """Let go of the connection; the stop process serves on."""
        if self._line is not None:
            self._line.close()

    def data_received(self, data: bytes) -> None:
        """Take in what the stop process says."""
        try:
            for item in self._reader.feed(data):
                self._take(item)
        except AuthGuardError as error:
            self._why = error
            self.close()

    def connection_lost(self, exc: Exception | None) -> None:  # noqa: ARG002 - the stop process said why
        """Note that stops are not reported any more."""
        self._line = None
        self._asked.clear()
        self._on_lost(self._why)

    def _take(self, item: Frame) -> None:
        if item.kind is Kind.EVENT:
            self._on_stop(read_body(item.body, StopHeard))
        elif item.kind is Kind.WELCOME:
            self.welcome = read_body(item.body, Welcome)
            for number in self._asked:  # what comes before its welcome ends a connection
                self._say(Kind.SYNC, number, Nothing())
        elif item.kind is Kind.REPLY:
            self._answered(item)
        else:
            raise from_fault(read_body(item.body, Fault))

    def _say(self, kind: Kind, number: int, body: object) -> None:
        if self._line is not None:
            self._line.write(frame(kind, number, body))

    def _answered(self, item: Frame) -> None:
        read_body(item.body, Nothing)
        done = self._asked.pop(item.id, None)
        if done is None:
            raise MalformedError("this was never asked", where="frame.id")
        done()


def _unstarted(why: str) -> EnvironmentFault:
    return EnvironmentFault(
        f"the stop process does not serve: {why}", reason=Reason.SERVICE_UNAVAILABLE, where="stop"
    )
