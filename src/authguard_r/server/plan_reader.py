# SPDX-License-Identifier: Apache-2.0
"""Long plans are read in a process of their own, so that no text delays a look at a lease.

A planner's text is the most hostile thing that comes in, and reading a quarter of a megabyte of it
takes longer than a turn may. The process holds no key, no store and no socket but the one to its
gate; what it takes too long for is refused and the process ended.
Spec page: docs/spec/gate-protocol.md#propose
"""

from __future__ import annotations

import asyncio
import os
import resource
import signal
from collections import deque
from collections.abc import Callable
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess

import msgspec
from msgspec import Struct

from authguard_r.core.errors import AuthGuardError, EnvironmentFault, MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.normalize import Binder, Dialect, Plan, read_plan
from authguard_r.normalize.binding import Binding
from authguard_r.site.model import Site
from authguard_r.wire.gate_limits import LIMITS

#: Takes a plan that was read, or why it could not be; None: it was not read, because no client
#: waits.
Taken = Callable[[Plan | AuthGuardError | None], None]


class _ReadTask(Struct, frozen=True):
    data: bytes
    dialect: Dialect
    taken: Taken
    uid: int
    wanted: Callable[[], bool]


class _Said(Struct, frozen=True, kw_only=True):
    """What the process answers: a plan, or a fault."""

    plan: Plan | None = None
    reason: Reason = Reason.MALFORMED
    where: str = ""
    message: str = ""


class PlanReader:
    """Reads long plans one after another.

    Args:
        site: the site whose words are meant.
        binding: the planner's tools.
        within_s: longest time to read one plan, in seconds.
        memory_bytes: most memory of the process.
    """

    def __init__(
        self,
        site: Site,
        binding: Binding,
        *,
        within_s: float = LIMITS.parse_s,
        memory_bytes: int = LIMITS.parser_bytes,
    ) -> None:
        self._tools = (site, binding, memory_bytes)
        self._within_s = within_s
        self._queue: deque[_ReadTask] = deque()
        self._process: SpawnProcess | None = None
        self._line: Connection | None = None
        self._deadline: asyncio.TimerHandle | None = None

    def read(
        self,
        data: bytes,
        dialect: Dialect,
        taken: Taken,
        *,
        uid: int,
        wanted: Callable[[], bool],
    ) -> None:
        """Read a plan when its turn comes; `taken` is called from the loop.

        Args:
            data: the plan.
            dialect: how it is written.
            taken: gets the plan, or why it could not be read.
            uid: whose it is.
            wanted: asked when its turn comes: a plan without a waiting client is not read.

        Raises:
            EnvironmentFault: enough wait already, of this user or of all.
        """
        mine = sum(asked.uid == uid for asked in self._queue)
        if mine >= LIMITS.long_plans_of_user or len(self._queue) >= LIMITS.long_plans:
            raise EnvironmentFault(
                "too many long plans wait to be read", reason=Reason.BUSY, where="proposal"
            )
        self._queue.append(_ReadTask(data, dialect, taken, uid, wanted))
        if len(self._queue) == 1:
            self._send()

    def close(self) -> None:
        """End the process."""
        if self._deadline is not None:
            self._deadline.cancel()
        if self._line is not None:
            asyncio.get_event_loop().remove_reader(self._line.fileno())
            self._line.close()
        if self._process is not None:
            self._process.kill()
            self._process.join()
        self._process = self._line = self._deadline = None

    def _send(self) -> None:
        loop = asyncio.get_running_loop()
        self._deadline = loop.call_later(self._within_s, self._failed)
        if self._line is not None:
            self._ask(self._line)
            return
        try:
            self._start()  # it says when it listens: a long plan would fill the line before
        except OSError:  # no process, or no files, to be had
            self._failed()

    def _ask(self, line: Connection) -> None:
        asked = self._queue[0]
        try:
            line.send_bytes(asked.dialect.encode("ascii") + b"\n" + asked.data)
        except OSError:
            self._failed()

    def _start(self) -> None:
        context = get_context("spawn")
        ours, theirs = context.Pipe()
        try:
            process = context.Process(target=_serve, args=(theirs, *self._tools), daemon=True)
            process.start()
        except OSError:
            ours.close()
            raise
        finally:
            theirs.close()
        self._process, self._line = process, ours
        asyncio.get_running_loop().add_reader(ours.fileno(), self._answered)

    def _answered(self) -> None:
        line = self._line
        if line is None:  # pragma: no cover - the reader is removed with the line
            return
        try:
            told = line.recv_bytes()
            said = msgspec.json.decode(told, type=_Said) if told else None
        except (EOFError, OSError, msgspec.DecodeError):
            self._failed()
            return
        if said is None:
            self._ask(line)
            return
        plan = said.plan
        fault = MalformedError(said.message, where=said.where, reason=said.reason)
        self._take(fault if plan is None else plan)

    def _failed(self) -> None:
        """Refuse a plan that its reader did not survive, or did not finish."""
        self.close()
        if self._queue:  # a process that died idle takes nothing with it
            self._take(
                MalformedError(
                    f"expected a plan that is read within {self._within_s} s",
                    where="input",
                    reason=Reason.INPUT_TOO_LARGE,
                )
            )

    def _take(self, plan: Plan | AuthGuardError) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
        done: list[tuple[_ReadTask, Plan | AuthGuardError | None]] = [(self._queue.popleft(), plan)]
        while self._queue and not self._queue[0].wanted():
            done.append((self._queue.popleft(), None))
        if self._queue:
            self._send()
        for asked, answer in done:
            asked.taken(answer)


def _serve(line: Connection, site: Site, binding: Binding, memory_bytes: int) -> None:
    """Say that plans are read here, and read them until the gate is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.nice(LIMITS.parser_nice)
    resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, memory_bytes))
    binder = Binder(site, binding)
    line.send_bytes(b"")
    while True:
        try:
            asked = line.recv_bytes()
        except EOFError:
            return
        line.send_bytes(msgspec.json.encode(parsed(asked, binder)))


def parsed(asked: bytes, binder: Binder) -> _Said:
    """Return what a dialect's name, a line break and a plan say."""
    dialect, _, data = asked.partition(b"\n")
    try:
        plan = read_plan(data, binder=binder, dialect=Dialect(dialect.decode("ascii")))
        return _Said(plan=plan)
    except AuthGuardError as error:
        return _Said(reason=error.reason, where=error.where, message=error.message)
    except MemoryError:
        return _Said(reason=Reason.INPUT_TOO_LARGE, where="input", message="out of memory")
