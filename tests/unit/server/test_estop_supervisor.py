# SPDX-License-Identifier: Apache-2.0
"""A stop lane serves for as long as its gate does, and the gate hears of every stop."""

from __future__ import annotations

import asyncio
import os
import resource
import signal
import time
from collections.abc import Awaitable, Callable, Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path

import msgspec
import pytest

from authguard_r.core.encoding import Tag
from authguard_r.core.errors import AuthGuardError, EnvironmentFault
from authguard_r.core.token import sign_object
from authguard_r.estop import run_folder as lane_place
from authguard_r.estop import supervisor as lane_keeper
from authguard_r.estop.connection import EStopConnection
from authguard_r.estop.files import EStopFiles
from authguard_r.estop.run_folder import PID, SOCKET, await_end, is_served
from authguard_r.estop.supervisor import EStopSupervisor
from authguard_r.keys.signer import folder_signer
from authguard_r.wire.messages import ClientRole, StopHeard
from fixtures import estop_fixtures, scenarios
from fixtures.limits import bounded
from unit.server.demo_site import PATIENCE_S


class Listener:
    """What a gate hears."""

    def __init__(self) -> None:
        self.stops: list[StopHeard] = []
        self.lost: list[AuthGuardError | None] = []
        self.connections = 0
        self.silences = 0
        self.answers = 0
        self.settled = True

    def stopped(self, heard: StopHeard) -> None:
        self.stops.append(heard)

    def stop_process_lost(self, why: AuthGuardError | None) -> None:
        self.lost.append(why)

    def stop_process_silent(self, *, is_silent: bool) -> None:
        self.silences += is_silent
        self.answers += not is_silent

    def connected(self) -> None:
        self.connections += 1


@pytest.fixture
def files() -> Iterator[EStopFiles]:
    made = estop_fixtures.files()
    yield made
    with suppress(OSError, ValueError):
        os.kill(lane_pid(made), signal.SIGKILL)


def lane_pid(files: EStopFiles) -> int:
    return int((files.run / PID).read_text())


def keeping(recorder: EStopSupervisor, work: Callable[[Listener], Awaitable[None]]) -> Listener:
    """Keep a lane while something is done."""
    listener = Listener()

    async def whole() -> None:
        task = asyncio.create_task(recorder.keep(listener, listener.connected))
        try:
            async with asyncio.timeout(2 * PATIENCE_S):
                await work(listener)
        finally:
            task.cancel()
            with suppress(asyncio.CancelledError):
                await task

    asyncio.run(whole())
    return listener


async def until(holds: Callable[[], object]) -> None:
    while not holds():
        await asyncio.sleep(0.01)


def stop(files: EStopFiles, why: str = "") -> None:
    hand = estop_fixtures.Client(files.run)
    hand.hello(ClientRole.OPERATOR)
    hand.stop(why)


def test_a_lane_that_dies_is_told_of_and_started_again(files: EStopFiles) -> None:
    recorder = EStopSupervisor(files)
    recorder.start()
    first = lane_pid(files)

    async def work(listener: Listener) -> None:
        await until(lambda: listener.connections == 1)
        await asyncio.to_thread(stop, files, "one")
        await until(lambda: listener.stops)
        os.kill(first, signal.SIGKILL)
        await until(lambda: lane_pid_or_none(files) not in {None, first})
        await until(lambda: listener.connections >= 2)
        await asyncio.to_thread(stop, files, "two")
        await until(lambda: any(told.why == "two" for told in listener.stops))

    try:
        heard = keeping(recorder, work)
    finally:
        recorder.end()
    # what it was not yet told to be recorded, the next lane says again
    assert list(dict.fromkeys(stop.why for stop in heard.stops)) == ["one", "two"]
    assert heard.lost[0] is None
    assert lane_pid_or_none(files) is None  # what was started here ends with us


def lane_pid_or_none(files: EStopFiles) -> int | None:
    try:
        os.kill(lane_pid(files), 0)
    except (OSError, ValueError):
        return None
    return lane_pid(files)


def test_the_lane_is_told_that_a_stop_was_heard_only_when_it_has_taken_its_effect(
    files: EStopFiles,
) -> None:
    recorder = EStopSupervisor(files)
    recorder.start()

    async def owed(listener: Listener) -> None:
        listener.settled = False
        await until(lambda: listener.connections)
        await asyncio.to_thread(stop, files, "one")
        await until(lambda: listener.stops)
        await asyncio.sleep(
            3 * lane_keeper.LIMITS.stop_heard_s
        )  # several times it could have been said

    async def nothing(listener: Listener) -> None:
        await until(lambda: listener.connections)
        await asyncio.to_thread(stop, files, "two")
        await until(lambda: listener.stops)

    try:
        keeping(recorder, owed)
        assert [stop.why for stop in keeping(recorder, owed_again).stops] == ["one"]
        assert [stop.why for stop in keeping(recorder, nothing).stops] == ["two"]
    finally:
        recorder.end()


async def owed_again(listener: Listener) -> None:
    """Let a gate that comes after hear of it, and settle it later."""
    listener.settled = False
    await until(lambda: listener.stops)
    await asyncio.sleep(2 * lane_keeper.LIMITS.stop_heard_s)
    listener.settled = True
    await asyncio.sleep(
        2 * lane_keeper.LIMITS.stop_heard_s
    )  # at the latest when it lets go, it is said


def test_a_lane_that_serves_answers_that_everything_was_told_and_none_is_nobody_to_ask(
    files: EStopFiles,
) -> None:
    recorder = EStopSupervisor(files)
    answered: list[bool] = []
    assert recorder.sync(lambda: answered.append(True)) is False
    recorder.start()

    async def work(listener: Listener) -> None:
        await until(lambda: listener.connections)
        assert recorder.sync(lambda: answered.append(True)) is True
        await until(lambda: answered)

    try:
        keeping(recorder, work)
        assert recorder.sync(lambda: answered.append(True)) is False  # it was let go of
    finally:
        recorder.end()
    assert answered == [True]


def test_a_lane_that_hangs_is_told_of_once_and_is_there_again_when_it_answers(
    files: EStopFiles, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A process that is held stays connected: nobody could stop by it, and nobody would know."""
    bounded(monkeypatch, lane_keeper, stop_replaced_looks=1_000_000)
    recorder = EStopSupervisor(files)
    assert not recorder.alive
    recorder.start()
    seen: list[bool] = []

    async def work(listener: Listener) -> None:
        await until(lambda: listener.connections and recorder.alive)
        os.kill(lane_pid(files), signal.SIGSTOP)
        await until(lambda: listener.silences)
        seen.append(recorder.alive)
        await asyncio.sleep(
            10 * lane_keeper.LIMITS.stop_ask_s
        )  # several times it could have been said again
        os.kill(lane_pid(files), signal.SIGCONT)
        await until(lambda: recorder.alive and listener.answers == 2)  # at first, and again
        seen.append(listener.silences == 1)
        os.kill(lane_pid(files), signal.SIGKILL)
        await until(lambda: listener.lost)
        seen.append(listener.silences == 1)  # one that is gone is another matter

    try:
        heard = keeping(recorder, work)
    finally:
        recorder.end()
    assert seen == [False, True, True]
    assert heard.lost[0] is None


def test_what_a_lane_is_asked_before_its_welcome_waits_for_it_and_ends_nothing(
    files: EStopFiles,
) -> None:
    recorder = EStopSupervisor(files)
    recorder.start()
    answered: list[int] = []
    lost: list[AuthGuardError | None] = []

    async def ask() -> None:
        link = EStopConnection(files.run / SOCKET, lambda _: None, lost.append)
        await link.connect()
        for number in range(3):
            link.sync(partial(answered.append, number))
        assert link.welcome is None
        async with asyncio.timeout(PATIENCE_S):
            await until(lambda: len(answered) == 3 or lost)
            assert lost == []
            link.close()
            await until(lambda: lost)

    try:
        asyncio.run(ask())
    finally:
        recorder.end()
    assert answered == [0, 1, 2]


def test_a_lane_that_hangs_counts_as_gone_at_once_and_is_replaced(files: EStopFiles) -> None:
    recorder = EStopSupervisor(files)
    recorder.start()
    first = lane_pid(files)
    late: list[float] = []

    async def work(listener: Listener) -> None:
        await until(lambda: listener.connections and recorder.alive)
        held = time.monotonic()
        os.kill(first, signal.SIGSTOP)
        await until(lambda: not recorder.alive)
        late.append(time.monotonic() - held)
        await until(lambda: listener.connections >= 2 and recorder.alive)

    try:
        heard = keeping(recorder, work)
        assert lane_pid(files) != first
        assert late[0] < 1.0  # `WITHIN_S`, and what this process is late
    finally:
        recorder.end()
    assert heard.silences == 1
    assert heard.lost == [None]


def test_a_lane_that_is_ending_is_not_taken_for_one_that_serves(files: EStopFiles) -> None:
    """The kernel closes the connection before the socket: between the two, it takes another."""
    recorder = EStopSupervisor(files)
    try:
        for _ in range(8):
            recorder.start()
            pid = lane_pid(files)
            assert is_served(files.run / SOCKET)
            os.kill(pid, signal.SIGKILL)
            await_end(pid, PATIENCE_S)
            assert not is_served(files.run / SOCKET)
        await_end(pid, PATIENCE_S)  # it is a zombie now, and ended
        held = time.monotonic()
        await_end(os.getpid(), 0.05)
        assert time.monotonic() - held >= 0.05  # a living process: the wait has an end
    finally:
        recorder.end()


def test_a_gate_with_a_thousand_open_files_starts_its_lane_all_the_same(files: EStopFiles) -> None:
    """`select` takes no file number above 1023; a gate with many connections has such numbers."""
    before, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
    held = [os.dup(2) for _ in range(1_100)]
    recorder = EStopSupervisor(files)
    try:
        recorder.start()
        assert is_served(files.run / SOCKET)
    finally:
        recorder.end()
        for file in held:
            os.close(file)
        resource.setrlimit(resource.RLIMIT_NOFILE, (before, most))


def test_a_lane_that_cannot_record_a_stop_is_not_replaced(files: EStopFiles) -> None:
    """It is silent for the gate's own fault, and what it keeps is the stop that is owed."""
    recorder = EStopSupervisor(files)
    recorder.start()
    first = lane_pid(files)

    async def work(listener: Listener) -> None:
        await until(lambda: listener.connections and recorder.alive)
        listener.settled = False
        os.kill(first, signal.SIGSTOP)
        await asyncio.sleep(
            2 * lane_keeper.LIMITS.stop_replaced_looks * lane_keeper.LIMITS.stop_ask_s
        )
        listener.settled = True
        os.kill(first, signal.SIGCONT)
        await until(lambda: recorder.alive)

    try:
        keeping(recorder, work)
        assert lane_pid(files) == first
    finally:
        recorder.end()


def test_a_lane_of_a_gate_that_was_killed_is_adopted_and_ends_with_the_next(
    files: EStopFiles,
) -> None:
    killed, heir = EStopSupervisor(files), EStopSupervisor(files)
    killed.start()
    for _ in range(3):
        stop(files)

    async def work(listener: Listener) -> None:
        await until(lambda: len(listener.stops) == 3)

    heir.start()
    numbers = [stop.n for stop in keeping(heir, work).stops]
    assert sorted(set(numbers)) == numbers  # all of them were before the gate was there
    heir.end()
    assert lane_pid_or_none(files) is None
    killed.end()


@pytest.mark.parametrize("number", [signal.SIGCONT, signal.SIGSTOP])
def test_a_lane_that_hangs_at_the_end_is_left_behind_no_more_than_one_that_serves(
    files: EStopFiles, number: signal.Signals, monkeypatch: pytest.MonkeyPatch
) -> None:
    bounded(monkeypatch, lane_place, end_s=0.5)
    recorder = EStopSupervisor(files)
    recorder.start()
    pid = lane_pid(files)
    os.kill(pid, number)
    recorder.end()
    assert not Path(f"/proc/{pid}").exists()


def test_a_lane_that_was_started_by_hand_serves_on(files: EStopFiles) -> None:
    with estop_fixtures.process(files):
        recorder = EStopSupervisor(files)
        recorder.start()
        recorder.end()
        stop(files)


def test_a_lane_that_cannot_be_started_is_tried_again_and_the_gate_told(
    files: EStopFiles, monkeypatch: pytest.MonkeyPatch
) -> None:
    bounded(monkeypatch, lane_keeper, stop_retry_s=0.01)
    broken = msgspec.structs.replace(files, key=Path("/nowhere"))
    recorder = EStopSupervisor(broken)
    with pytest.raises(EnvironmentFault):
        recorder.start()

    async def work(listener: Listener) -> None:
        await until(lambda: len(listener.lost) >= 2)
        recorder._files = files  # somebody mended it
        await until(lambda: listener.connections)

    try:
        listener = keeping(recorder, work)
    finally:
        recorder.end()
    assert all(isinstance(why, EnvironmentFault) for why in listener.lost)


def test_a_lane_of_another_configuration_is_retired_and_one_of_this_started(
    files: EStopFiles,
) -> None:
    old, new = EStopSupervisor(files), EStopSupervisor(files)
    old.start()
    first = lane_pid(files)
    signer = folder_signer(scenarios.trust_folder(), "site-authority-1")
    files.config.write_bytes(sign_object(estop_fixtures.config(connections=3), Tag.GATE, signer))
    try:
        new.start()
        assert lane_pid(files) != first
        new.start()  # its own stays
        assert len(new._started) == 1
    finally:
        new.end()
        old.end()


@pytest.mark.parametrize("config", ["another", "gone"])
def test_a_stale_lane_that_hangs_is_killed_and_another_one_serves(
    files: EStopFiles, config: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    bounded(monkeypatch, lane_place, end_s=0.5)
    recorder = EStopSupervisor(files)
    recorder.start()
    place = files.run / lane_keeper.CONFIG
    if config == "gone":
        place.unlink()
    else:
        place.write_text("another")
    pid = lane_pid(files)
    os.kill(pid, signal.SIGSTOP)
    recorder.start()
    assert lane_pid(files) != pid
    recorder.end()


def test_a_stale_lane_that_does_not_end_is_a_fault(
    files: EStopFiles, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whose number nobody knows, nobody can end."""
    bounded(monkeypatch, lane_place, end_s=0.1)
    recorder = EStopSupervisor(files)
    recorder.start()
    (files.run / lane_keeper.CONFIG).write_text("another")
    pid = lane_pid(files)
    (files.run / PID).write_text("nobody")
    with pytest.raises(EnvironmentFault, match="does not end"):
        EStopSupervisor(files).start()
    (files.run / PID).write_text(str(pid))
    recorder.end()
