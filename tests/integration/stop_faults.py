# SPDX-License-Identifier: Apache-2.0
"""Faults between a person's stop and a robot that moves, and what becomes of the stop.

Used by the tests, and by `benchmarks/stop_faults.py`, which repeats each fault.
"""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from authguard_r.client import GateClient
from authguard_r.client.stopping import Answers, StopEverywhere, StopReply
from authguard_r.wire.frames import frame
from authguard_r.wire.messages import PROTOCOL, ClientRole, Hello, Kind, Stop
from fixtures.gate_process import RunningGate, until
from integration.test_gate_bounds import Yard, now_ms

#: More connections than a stop socket's queue holds.
QUEUE = 1_100


class Asked:
    """A stop on its way, in a thread of its own, from a moment on; a context manager.

    Args:
        run: the run folder.
        why: its name in the log.
    """

    def __init__(self, run: Path, why: str) -> None:
        self._stop = StopEverywhere(run, why=why, client="hand")
        self.told: list[str] = []
        self.reached: StopReply | None = None
        self.answered_ms = 0
        self.at_ms = now_ms()
        self._thread = threading.Thread(target=self._ask, daemon=True)
        self._thread.start()

    @property
    def answers(self) -> Answers:
        """What each part has said so far."""
        return self._stop.answers

    def confirmed(self) -> StopReply:
        """Return the answer, waiting for it."""
        found: StopReply = until(lambda: self.reached, "an answer to the stop")
        return found

    def _ask(self) -> None:
        reached = asyncio.run(self._stop.confirmed(self._tell))  # a fault of it shows
        self.answered_ms = now_ms()
        self.reached = reached

    def _tell(self, answers: Answers) -> None:
        self.told += [part.words for part, one in answers.items() if not one.has_stopped]


@contextmanager
def frozen(*pids: int) -> Iterator[None]:
    """Hold processes for a while; one that was replaced meanwhile is left alone."""
    for pid in pids:
        os.kill(pid, signal.SIGSTOP)
    try:
        yield
    finally:
        for pid in pids:
            if Path(f"/proc/{pid}").exists():
                os.kill(pid, signal.SIGCONT)


@contextmanager
def no_fault(yard: Yard) -> Iterator[None]:
    """Leave everything as it is."""
    assert yard.gate.alive
    yield


@contextmanager
def lane_frozen(yard: Yard) -> Iterator[None]:
    """Hold the stop process."""
    with frozen(lane_of(yard.gate)):
        yield


@contextmanager
def lane_frozen_full(yard: Yard) -> Iterator[None]:
    """Hold the stop process while its socket's queue is full."""
    with ExitStack() as stack, frozen(lane_of(yard.gate)):
        for _ in range(QUEUE):
            waits = stack.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_STREAM))
            waits.settimeout(0)
            try:
                waits.connect(str(yard.gate.stop_socket))
            except BlockingIOError:
                break
        else:
            raise AssertionError("the queue never filled")
        yield


@contextmanager
def lane_killed(yard: Yard) -> Iterator[None]:
    """Kill the stop process."""
    os.kill(lane_of(yard.gate), signal.SIGKILL)
    yield


@contextmanager
def gate_frozen(yard: Yard) -> Iterator[None]:
    """Hold the gate."""
    with frozen(yard.gate.pid):
        yield


@contextmanager
def gate_killed(yard: Yard) -> Iterator[None]:
    """Kill the gate; another one is started when the robot stands."""
    yard.gate.kill9()
    yield
    yard.gate.start_gate()


@contextmanager
def both_frozen(yard: Yard) -> Iterator[None]:
    """Hold the gate and the stop process."""
    with frozen(lane_of(yard.gate), yard.gate.pid):
        yield


@contextmanager
def both_killed(yard: Yard) -> Iterator[None]:
    """Kill the gate and the stop process; another gate is started when the robot stands."""
    lane = lane_of(yard.gate)
    yard.gate.kill9()
    os.kill(lane, signal.SIGKILL)
    yield
    yard.gate.start_gate()


@contextmanager
def disk_frozen(yard: Yard) -> Iterator[None]:
    """Let the store's disk take nothing; the store lies on a file system of its own."""
    folder = str(yard.gate.store.parent)
    subprocess.run(["fsfreeze", "--freeze", folder], check=True)
    try:
        time.sleep(0.2)  # the gate meets it
        yield
    finally:
        subprocess.run(["fsfreeze", "--unfreeze", folder], check=True)


#: What may happen right before a person stops the robot.
FAULTS: dict[str, Callable[[Yard], object]] = {
    "none": no_fault,
    "the stop process is frozen": lane_frozen,
    "the stop process is frozen, its socket full": lane_frozen_full,
    "the stop process is killed": lane_killed,
    "the gate is frozen": gate_frozen,
    "the gate is killed": gate_killed,
    "both are frozen": both_frozen,
    "both are killed": both_killed,
}


def lane_of(gate: RunningGate) -> int:
    """Return the stop process."""
    found: int = until(lambda: gate.lane_pid, "a stop process")
    return found


def leaves_a_stop(path: Path, why: str) -> None:
    """Send a stop and leave before anybody has read it: a client that is killed."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as line:
        line.connect(str(path))
        hello = Hello(protocol=PROTOCOL, role=ClientRole.OPERATOR, client="hand")
        line.sendall(frame(Kind.HELLO, 0, hello) + frame(Kind.STOP, 1, Stop(why=why, key=why)))


def serves(gate: RunningGate) -> None:
    """Wait until a stop process answers the gate, and a robot answers that one."""

    def answers() -> bool:
        with gate.client(ClientRole.AUDITOR, "looks") as client:
            return bool(client.status()["lane"]["alive"])

    def stands() -> bool:
        with GateClient.connect(
            gate.stop_socket, role=ClientRole.AUDITOR, client="looks"
        ) as client:
            return bool(client.stop("looks")["stopped"])

    until(answers, "a stop process that answers")
    until(stands, "a robot that hears of stops")
