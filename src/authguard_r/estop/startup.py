# SPDX-License-Identifier: Apache-2.0
"""The stop process's beginning and end: what it reads, how the machine favors it, when it goes.

Spec page: docs/spec/gate-protocol.md#stop-lane
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import resource
import select
import signal
import socket
from collections.abc import Callable, Iterator
from time import time_ns
from types import FrameType

from msgspec import Struct

from authguard_r.access.gate_config import GateConfig, open_gate_config
from authguard_r.core.errors import AuthenticityError
from authguard_r.core.identifiers import RobotId
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.estop.files import CONFIG, EStopFiles, config_digest
from authguard_r.estop.run_folder import SOCKET, leave_place, take_place
from authguard_r.estop.server import EStopServer
from authguard_r.keys.clock_floor import boot_ms, chain_ms, token_ms
from authguard_r.keys.signer import FileSigner, read_signer
from authguard_r.keys.trust import read_file, read_trust
from authguard_r.wire.stop_limits import LIMITS

#: `mlockall(2)`: what is in memory stays there.
_MCL_CURRENT = 1


class EStopReady(Struct, frozen=True, kw_only=True):
    """A stop process that serves.

    Args:
        ready: true.
        robot: whose stop process it is.
        socket: where it listens.
        pid: the process.
        epoch: when it started, milliseconds since 1970, and more than an earlier stop process's.
        unheard: stops that an earlier stop process left and no gate has recorded.
        spool: stops can be written to the file.
        favored: the machine gave it priority over others.
        locked: its memory cannot be swapped out.
    """

    ready: bool
    robot: RobotId
    socket: str
    pid: int
    epoch: int
    unheard: int
    spool: bool
    favored: bool
    locked: bool


class Favor(Struct, frozen=True):
    """What the machine gave the process: priority, and memory that is not swapped out."""

    priority: bool
    memory: bool


def ask_favor(nice: int = LIMITS.priority, lock: int = _MCL_CURRENT) -> Favor:
    """Return what the machine gives: a stop waits for no other process, no disk and no collector.

    What it does not give is no reason not to serve.
    """
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
    gc.collect()
    gc.freeze()
    return Favor(
        priority=is_given(lambda: os.nice(nice)),
        memory=ctypes.CDLL(None).mlockall(lock) == 0,
    )


def is_given(ask: Callable[[], object]) -> bool:
    """Ask the machine for something; false when it is not permitted."""
    try:
        ask()
    except OSError:
        return False
    return True


def run_stop_process(
    files: EStopFiles,
    ready: Callable[[EStopReady], None],
    favor: Callable[[], Favor] = ask_favor,
    *,
    of_gate: bool = False,
) -> None:
    """Serve the run folder's stop socket until SIGTERM or SIGINT; the main thread's work.

    Args:
        files: what it is started with.
        ready: called once clients can connect.
        favor: asks the machine to favor this process.
        of_gate: a gate started it, and a gate that ends ends it.

    Raises:
        EnvironmentFault: a file is missing, or a stop process serves there already.
        MalformedError: the configuration is not valid, or another robot's.
        AuthenticityError: key, certificate or configuration do not hold, or are another robot's.
    """
    signer, config = _read(files)
    place = take_place(files.run, of_gate=of_gate)
    woken, waking = socket.socketpair()
    try:
        waking.settimeout(0)
        lane = EStopServer(
            place, files.robot, config, signer=signer, wake=woken.fileno(), say=say_to_stderr
        )
        (files.run / CONFIG).write_text(config_digest(files))
        with _ended_by(waking.fileno(), signal.SIGTERM, signal.SIGINT):
            given = favor()
            ready(
                EStopReady(
                    ready=True,
                    robot=files.robot,
                    socket=str(files.run / SOCKET),
                    pid=os.getpid(),
                    epoch=lane.journal.epoch,
                    unheard=len(lane.journal),
                    spool=lane.spool.is_open,
                    favored=given.priority,
                    locked=given.memory,
                )
            )
            lane.serve()
    finally:
        woken.close()
        waking.close()
        (files.run / CONFIG).unlink(missing_ok=True)
        leave_place(place)


def say_to_stderr(line: bytes) -> None:
    """Write a line to standard error, unless that would wait."""
    with contextlib.suppress(OSError, ValueError):
        if select.select([], [2], [], 0)[1]:
            os.write(2, line)


def _read(files: EStopFiles) -> tuple[FileSigner, GateConfig]:
    trust = read_trust(files.trust)
    signer = read_signer(files.key, files.cert)
    signed = read_file(files.config)
    # a robot whose machine has no clock yet has to be stopped too
    known_ms = (chain_ms(signer.chain), token_ms(signed))
    now = Now(boot_ms(time_ns() // 1_000_000, trust, *known_ms), 0)
    named, _ = trust.gate_identity(signer.chain, now)
    if named != files.robot:
        raise AuthenticityError(
            f"expected the gate's certificate of `{files.robot}`, got `{named}`'s",
            reason=Reason.ROBOT_MISMATCH,
            where=str(files.cert),
        )
    config = open_gate_config(signed, verifier=trust, now=now, robot=files.robot)
    return signer, config


@contextlib.contextmanager
def _ended_by(wake: int, *signals: signal.Signals) -> Iterator[None]:
    """Let signals wake the loop instead of breaking into it."""

    def nothing(number: int, frame: FrameType | None) -> None:
        """The number written to the wake-up file is all that counts."""

    before = [(number, signal.signal(number, nothing)) for number in signals]
    known = signal.set_wakeup_fd(wake)
    try:
        yield
    finally:
        signal.set_wakeup_fd(known)
        for number, handler in before:
            signal.signal(number, handler)
