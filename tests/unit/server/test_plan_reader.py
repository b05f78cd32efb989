# SPDX-License-Identifier: Apache-2.0
"""A long plan is read elsewhere and says the same; what reads it may die and the gate goes on."""

from __future__ import annotations

import asyncio
import errno
import os
import re
import resource
import signal
import threading
from collections.abc import Awaitable, Callable, Iterator
from multiprocessing import Pipe
from pathlib import Path
from typing import Any

import msgspec
import pytest

from authguard_r.core.errors import AuthGuardError, EnvironmentFault, MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.normalize import Binder, Dialect, Plan, read_plan
from authguard_r.server.plan_reader import PlanReader, _serve, parsed
from authguard_r.wire.gate_limits import LIMITS
from fixtures import scenarios
from unit.server.demo_site import PATIENCE_S, SCAN

REPLIES = sorted((scenarios.HOSPITAL / "replies").glob("*.json"))
LONG = b"\n" * 60_000
Read = Plan | AuthGuardError


def binder() -> Binder:
    return Binder(scenarios.site(), scenarios.binding())


def inline(data: bytes, dialect: Dialect = Dialect.AUTO) -> Read:
    try:
        return read_plan(data, binder=binder(), dialect=dialect)
    except AuthGuardError as error:
        return error


def same(one: Read, two: Read) -> bool:
    if isinstance(one, Plan) or isinstance(two, Plan):
        return one == two
    return (one.reason, one.where, one.message) == (two.reason, two.where, two.message)


class Desk:
    """A reader in its loop, and what it gave back."""

    def __init__(self, **bounds: Any) -> None:
        bounds.setdefault("within_s", PATIENCE_S)
        self.reader = PlanReader(scenarios.site(), scenarios.binding(), **bounds)
        self.taken: list[Read] = []
        self.users = 0

    def read(self, data: bytes, *, uid: int | None = None, wanted: bool = True) -> None:
        """Ask for a plan to be read; every one is another user's unless the test says whose."""
        self.users += 1
        whose = -self.users if uid is None else uid
        self.reader.read(data, Dialect.AUTO, self.taken.append, uid=whose, wanted=lambda: wanted)

    async def until(self, count: int) -> None:
        async with asyncio.timeout(PATIENCE_S):
            while len(self.taken) < count:
                await asyncio.sleep(0.002)

    @property
    def pid(self) -> int:
        assert self.reader._process is not None
        pid = self.reader._process.pid
        assert pid is not None
        return pid

    async def listening(self) -> None:
        """Return when the process has read its first plan."""
        self.read(SCAN + LONG)
        await self.until(1)
        self.taken.clear()


def run(work: Callable[[Desk], Awaitable[None]], **bounds: Any) -> None:
    async def whole() -> None:
        session = Desk(**bounds)
        try:
            await work(session)
        finally:
            session.reader.close()
            session.reader.close()  # a second time does nothing

    asyncio.run(whole())


def test_a_long_plan_read_elsewhere_says_what_it_says_here() -> None:
    plans = [path.read_bytes() + b"\n" * LIMITS.short_plan_bytes for path in REPLIES]
    plans += [SCAN + LONG, b"fly_to(" + LONG, b"\xff" * 5_000, b"[" * 20_000, b'"' * 5_000]

    async def work(session: Desk) -> None:
        for count, data in enumerate(plans, 1):
            session.read(data)
            if count % LIMITS.long_plans == 0:
                await session.until(count)
        await session.until(len(plans))
        for data, taken in zip(plans, session.taken, strict=True):
            assert same(taken, inline(data))
        assert sum(isinstance(taken, Plan) for taken in session.taken) >= len(REPLIES) // 2

    run(work)


def test_a_longest_plan_keeps_nobody_waiting_for_a_process_that_starts() -> None:
    async def work(session: Desk) -> None:
        session.read(SCAN + b"\n" * ((1 << 18) - len(SCAN)))
        assert (
            session.taken == []
        )  # it imports the whole program first, and a full line would block
        os.kill(session.pid, signal.SIGSTOP)  # and were it to hang: nobody waits for that either
        await asyncio.sleep(0)
        os.kill(session.pid, signal.SIGCONT)
        await session.until(1)
        assert isinstance(session.taken[0], Plan)

    run(work)


def test_a_reader_killed_in_mid_read_loses_that_plan_alone() -> None:
    async def work(session: Desk) -> None:
        await session.listening()
        first = session.pid
        os.kill(first, signal.SIGSTOP)
        session.read(SCAN + LONG)
        session.read(SCAN + LONG)
        os.kill(first, signal.SIGKILL)
        await session.until(2)
        lost, read = session.taken
        assert isinstance(lost, MalformedError)
        assert (lost.reason, lost.where) == (Reason.INPUT_TOO_LARGE, "input")
        assert isinstance(read, Plan)
        assert session.pid != first

    run(work)


def test_a_reader_killed_while_idle_loses_nothing() -> None:
    async def work(session: Desk) -> None:
        await session.listening()
        os.kill(session.pid, signal.SIGKILL)
        async with asyncio.timeout(PATIENCE_S):
            while session.reader._process is not None:
                await asyncio.sleep(0.002)
        session.read(SCAN + LONG)
        await session.until(1)
        assert isinstance(session.taken[0], Plan)

    run(work)


def test_a_plan_for_a_reader_that_just_died_is_refused_and_the_next_one_read() -> None:
    async def work(session: Desk) -> None:
        await session.listening()
        process = session.reader._process
        assert process is not None
        process.kill()
        process.join()  # dead, and the loop has not heard of it yet
        session.read(SCAN + LONG)
        session.read(SCAN + LONG)
        await session.until(2)
        assert isinstance(session.taken[0], MalformedError)
        assert isinstance(session.taken[1], Plan)

    run(work)


def test_a_plan_that_takes_too_long_is_refused_and_its_reader_ended() -> None:
    async def work(session: Desk) -> None:
        session.read(SCAN + LONG)
        first = session.pid
        os.kill(first, signal.SIGSTOP)
        await session.until(1)
        (late,) = session.taken
        assert isinstance(late, MalformedError)
        assert late.reason is Reason.INPUT_TOO_LARGE
        assert session.reader._process is None
        with pytest.raises(ProcessLookupError):
            os.kill(first, 0)

    run(work, within_s=0.2)


def test_a_reader_that_says_nonsense_is_ended() -> None:
    async def work(session: Desk) -> None:
        await session.listening()
        ours, theirs = Pipe()
        line, loop = session.reader._line, asyncio.get_running_loop()
        assert line is not None
        loop.remove_reader(line.fileno())
        loop.add_reader(ours.fileno(), session.reader._answered)
        session.reader._line = ours  # its line, taken over by something else
        theirs.send_bytes(b"{nonsense")
        session.read(SCAN + LONG)
        await session.until(1)
        assert isinstance(session.taken[0], MalformedError)
        assert session.reader._process is None
        line.close()
        theirs.close()

    run(work)


def test_a_reader_without_memory_refuses_and_the_gate_has_enough() -> None:
    """The plan takes tens of megabytes to read: more than what may lie free in any process."""
    greedy = (SCAN + b"\n") * (250_000 // len(SCAN + b"\n"))
    messages: list[str] = []

    async def work(session: Desk) -> None:
        session.read(greedy)
        await session.until(1)
        (refused,) = session.taken
        assert isinstance(refused, MalformedError)
        assert refused.reason is Reason.INPUT_TOO_LARGE
        messages.append(refused.message)
        limits = Path(f"/proc/{session.pid}/limits").read_text() if session.reader._process else ""
        messages.append(limits)

    run(work, memory_bytes=1 << 29)  # with memory it is refused for what it is: too many calls
    run(work, memory_bytes=1 << 24)
    with_memory, limits, without, _ = messages
    assert re.search(rf"Max address space +{1 << 29} +{1 << 29} ", limits)
    # without, it says so, or dies of it: either way that plan alone is lost
    assert without in {"out of memory", f"expected a plan that is read within {PATIENCE_S} s"}
    assert without != with_memory


def refuses(session: Desk, *, uid: int | None = None) -> None:
    with pytest.raises(EnvironmentFault) as refused:
        session.read(SCAN + LONG, uid=uid)
    assert (refused.value.reason, refused.value.where) == (Reason.BUSY, "proposal")


def test_one_user_keeps_only_two_long_plans_waiting_and_another_is_read() -> None:
    async def work(session: Desk) -> None:
        for _ in range(LIMITS.long_plans_of_user):
            session.read(SCAN + LONG, uid=1)
        refuses(session, uid=1)
        session.read(SCAN + LONG, uid=2)
        await session.until(LIMITS.long_plans_of_user + 1)
        assert all(isinstance(plan, Plan) for plan in session.taken)
        session.read(SCAN + LONG, uid=1)  # its turn has come and gone: there is place again
        await session.until(LIMITS.long_plans_of_user + 2)

    run(work)


def test_no_more_than_sixteen_long_plans_wait_however_many_users_there_are() -> None:
    async def work(session: Desk) -> None:
        for _ in range(LIMITS.long_plans):
            session.read(SCAN + LONG)
        refuses(session)
        assert len(session.reader._queue) == LIMITS.long_plans == 16
        await session.until(LIMITS.long_plans)
        assert all(isinstance(plan, Plan) for plan in session.taken)

    run(work)


def test_a_plan_that_nobody_waits_for_when_its_turn_comes_is_not_read() -> None:
    async def work(session: Desk) -> None:
        await session.listening()
        session.read(SCAN + LONG)
        for _ in range(2):
            session.read(SCAN + LONG, wanted=False)
        session.read(SCAN + LONG)
        session.read(SCAN + LONG, wanted=False)
        await session.until(5)
        read = [isinstance(plan, Plan) for plan in session.taken]
        assert sorted(read) == [False, False, False, True, True]
        assert session.taken.count(None) == 3
        assert not session.reader._queue

    run(work)


@pytest.mark.parametrize("missing", ["files", "processes"])
def test_where_no_reader_can_be_started_every_plan_is_refused_and_the_next_is_tried(
    missing: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def work(session: Desk) -> None:
        with monkeypatch.context() as machine:
            machine.setattr(*NOTHING_LEFT[missing])
            session.read(SCAN + LONG)
        assert [isinstance(plan, MalformedError) for plan in session.taken] == [True]
        assert not session.reader._queue
        session.read(SCAN + LONG)
        await session.until(2)
        assert isinstance(session.taken[1], Plan)

    run(work)


def fails(*_: object, **__: object) -> None:
    raise OSError(errno.EAGAIN, "nothing left")


#: What the machine refuses, by what it has no more of.
NOTHING_LEFT: dict[str, tuple[str, object]] = {
    "files": ("multiprocessing.connection.Pipe", fails),
    "processes": ("multiprocessing.context.SpawnProcess.start", fails),
}


# the process's own side


@pytest.fixture
def interrupts() -> Iterator[None]:
    before = signal.getsignal(signal.SIGINT)
    yield
    signal.signal(signal.SIGINT, before)


def test_the_process_reads_until_its_gate_is_gone(interrupts: None) -> None:
    ours, theirs = Pipe()
    ours.send_bytes(b"auto\n" + SCAN)
    ours.send_bytes(b"python\nfly_to(")
    # nobody's memory is bounded by this one: it is the process of the tests
    _, most = resource.getrlimit(resource.RLIMIT_AS)
    got: list[bytes] = []

    def gate() -> None:
        got.extend(ours.recv_bytes() for _ in range(3))
        ours.close()

    thread = threading.Thread(target=gate)
    thread.start()
    _serve(theirs, scenarios.site(), scenarios.binding(), most)
    thread.join(PATIENCE_S)
    assert got[0] == b""
    plan, fault = (msgspec.json.decode(said) for said in got[1:])
    assert len(plan["plan"]["steps"]) == 1
    assert (fault["plan"], fault["reason"]) == (None, "MALFORMED")
    theirs.close()


def test_memory_that_is_used_up_is_a_refusal() -> None:
    class Exhausted(Binder):
        def spellings(self) -> Any:
            raise MemoryError

        def __getattribute__(self, name: str) -> Any:
            raise MemoryError

    said = parsed(b"auto\n" + SCAN, Exhausted.__new__(Exhausted))
    assert (said.plan, said.reason) == (None, Reason.INPUT_TOO_LARGE)
