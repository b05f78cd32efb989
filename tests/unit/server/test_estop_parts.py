# SPDX-License-Identifier: Apache-2.0
"""The stop lane's parts that touch the machine: files, sockets, signals, the gate's link."""

from __future__ import annotations

import asyncio
import gc
import json
import os
import resource
import selectors
import signal
import socket
import stat
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import msgspec
import pytest

from authguard_r.access.gate_config import GateConfig
from authguard_r.core.errors import (
    AuthenticityError,
    AuthGuardError,
    EnvironmentFault,
    MalformedError,
)
from authguard_r.core.reasons import Reason
from authguard_r.estop import connection
from authguard_r.estop.connection import EStopConnection, start_stop_process
from authguard_r.estop.run_folder import (
    EPOCH,
    FIRST_SPOOL,
    PID,
    SOCKET,
    SPOOL,
    is_served,
    leave_place,
    take_place,
)
from authguard_r.estop.server import EStopServer
from authguard_r.estop.spool import Spool, left_by, next_epoch
from authguard_r.estop.startup import (
    EStopReady,
    Favor,
    ask_favor,
    is_given,
    run_stop_process,
    say_to_stderr,
)
from authguard_r.keys.signer import folder_signer
from authguard_r.wire.frames import frame
from authguard_r.wire.messages import PROTOCOL, SUSPENDING, ClientRole, Kind, StopHeard
from authguard_r.wire.stop_limits import LIMITS
from fixtures import estop_fixtures, scenarios
from fixtures.json_lines import whole_lines
from fixtures.limits import bounded

FULL = "/dev/full"


@pytest.fixture
def run() -> Path:
    return estop_fixtures.files().run


@contextmanager
def serving(
    run: Path, config: GateConfig | None = None, said: list[bytes] | None = None
) -> Iterator[EStopServer]:
    """A lane in a thread of this process."""
    place = take_place(run)
    woken, waking = socket.socketpair()
    lane = EStopServer(
        place,
        scenarios.RID,
        config or estop_fixtures.config(),
        signer=folder_signer(scenarios.trust_folder(), f"gate-{scenarios.RID}"),
        wake=woken.fileno(),
        say=(said if said is not None else []).append,
    )
    thread = threading.Thread(target=lane.serve)
    thread.start()
    try:
        yield lane
    finally:
        waking.send(b"\0")
        thread.join(estop_fixtures.SOON_S)
        assert not thread.is_alive()
        woken.close()
        waking.close()
        leave_place(place)


def spooled(run: Path, name: str = SPOOL) -> list[dict[str, Any]]:
    return whole_lines((run / name).read_bytes())


def counted(run: Path) -> int:
    """Return how many stops of roles that do not suspend the file tells of."""
    last = {line["n"]: 1 + line["more"] for line in spooled(run)}
    return sum(last.values())


def stop(n: int, why: str = "") -> StopHeard:
    return StopHeard(
        epoch=1,
        n=n,
        by="planner",
        uid=5,
        role=ClientRole.PLANNER,
        time_ms=2,
        why=why,
        stood_ms=None,
    )


# the file


def test_what_was_written_is_read_back_and_gone_once_recorded(run: Path) -> None:
    spool = Spool(run / SPOOL)
    assert not spool.is_used
    assert spool.write([stop(1, "smoke"), stop(2)])
    spool.close()
    again = Spool(run / SPOOL)
    assert again.known == (stop(1, "smoke"), stop(2))
    assert again.is_used
    again.clear()
    again.clear()
    again.close()
    assert (run / SPOOL).read_bytes() == b""
    assert stat.S_IMODE((run / SPOOL).stat().st_mode) == 0o600


def test_an_unfinished_line_is_cut_and_foreign_lines_are_passed_over(run: Path) -> None:
    lines = [msgspec.json.encode(stop(n)) for n in (3, 2, 4)]
    data = b"\n".join([lines[0], b"{}", b"\xff", lines[1], lines[2], lines[0][:20]])
    (run / SPOOL).write_bytes(data)
    spool = Spool(run / SPOOL)
    assert [known.n for known in spool.known] == [3, 2, 4]
    assert [known.n for known in left_by(spool)] == [2, 3, 4]
    assert spool.write([stop(5)])
    spool.close()
    assert (run / SPOOL).read_bytes().splitlines()[-2:] == [lines[2], msgspec.json.encode(stop(5))]


def test_a_file_that_cannot_be_opened_is_done_without(run: Path) -> None:
    (run / SPOOL).symlink_to(run / "elsewhere")
    spool = Spool(run / SPOOL)
    assert not spool.is_open
    assert not spool.write([stop(1)])
    spool.clear()
    spool.close()
    assert not (run / "elsewhere").exists()


def test_the_file_does_not_grow_without_end(run: Path) -> None:
    (run / SPOOL).write_bytes(msgspec.json.encode(stop(1)) + b"\n" + b"x" * LIMITS.spool_bytes)
    spool = Spool(run / SPOOL)
    assert [known.n for known in spool.known] == [1]
    fill = [stop(n, "x" * 200) for n in range(2, 30_000)]
    assert not spool.write(fill)
    assert spool.write(fill[:100])
    spool.close()


def test_a_full_disk_takes_none_of_what_it_does_not_take_whole(run: Path) -> None:
    """A limit on the file's size is a disk that takes a part of a write, then nothing."""
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    spool = Spool(run / SPOOL)
    assert spool.write([stop(1)])
    size = (run / SPOOL).stat().st_size
    resource.setrlimit(resource.RLIMIT_FSIZE, (size + 10, hard))
    try:
        assert not spool.write([stop(2)])
        assert (run / SPOOL).stat().st_size == size
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
        assert not spool.write([stop(2)])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, before)
    assert spool.write([stop(2)])
    spool.close()
    assert [line["n"] for line in spooled(run)] == [1, 2]


def test_a_file_that_cannot_be_emptied_is_emptied_later(run: Path) -> None:
    spool = Spool(run / SPOOL)
    assert spool.write([stop(1)])
    file, spool._file = spool._file, os.open(FULL, os.O_RDONLY)
    spool.clear()
    assert spool.is_used
    os.close(spool._file)
    spool._file = file
    spool.clear()
    assert not spool.is_used
    spool.close()


# the place


def test_only_the_folder_s_group_reaches_the_socket(run: Path) -> None:
    before = os.umask(0o022)
    os.umask(before)
    place = take_place(run)
    seen = (run / SOCKET).stat()
    assert stat.S_IMODE(seen.st_mode) == 0o660
    assert seen.st_gid == run.stat().st_gid
    assert (run / PID).read_text() == f"{os.getpid()}\n"
    assert os.umask(before) == before
    leave_place(place)
    assert list(run.iterdir()) == [run / "gate.token"]


def test_a_second_lane_is_refused_and_the_first_serves_on(run: Path) -> None:
    place = take_place(run)
    with pytest.raises(EnvironmentFault, match="serves here already"):
        take_place(run)
    (run / PID).unlink()  # somebody tidied up
    with pytest.raises(EnvironmentFault, match="serves here already"):
        take_place(run)
    assert is_served(run / SOCKET)
    leave_place(place)
    assert not is_served(run / SOCKET)


def test_a_dead_socket_is_replaced_and_nothing_else_is(run: Path) -> None:
    dead = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    dead.bind(str(run / SOCKET))
    dead.close()
    leave_place(take_place(run))
    (run / SOCKET).write_text("precious")
    with pytest.raises(EnvironmentFault, match="cannot serve here"):
        take_place(run)
    assert (run / SOCKET).read_text() == "precious"


def test_a_folder_that_cannot_be_used_is_named(run: Path) -> None:
    with pytest.raises(EnvironmentFault, match="expected a folder") as caught:
        take_place(run / "nowhere")
    assert caught.value.where == str(run / "nowhere")
    (run / PID).symlink_to(run / "elsewhere")
    with pytest.raises(EnvironmentFault, match="cannot serve here"):
        take_place(run)


def test_a_lock_file_that_cannot_be_written_holds_nothing(
    run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("authguard_r.estop.run_folder.PID", "../../dev/full")
    with pytest.raises(EnvironmentFault, match="cannot serve here"):
        take_place(run)


def test_a_socket_with_a_full_queue_is_served(run: Path) -> None:
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    listener.bind(str(run / SOCKET))
    listener.listen(0)
    waiting = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    waiting.connect(str(run / SOCKET))
    assert is_served(run / SOCKET)
    waiting.close()
    listener.close()


# the loop


def test_a_stop_goes_through_the_loop_and_into_the_file(run: Path) -> None:
    with serving(run):
        client = estop_fixtures.Client(run)
        client.hello(ClientRole.PLANNER)
        with estop_fixtures.obedient_robot(run):
            assert estop_fixtures.stops(client, "smoke")["controller"] is True
            estop_fixtures.until(lambda: spooled(run), "the spool's first line")
        estop_fixtures.until(lambda: not client.stop("later")["controller"], "the robot's end")
        client.close()
    assert [line["why"] for line in spooled(run)][:: len(spooled(run)) - 1] == ["smoke", "later"]


def test_what_waits_when_the_lane_ends_is_written(run: Path) -> None:
    with serving(run):
        robot, client = estop_fixtures.Robot(run), estop_fixtures.Client(run)
        client.hello(ClientRole.PLANNER)
        client.say(Kind.STOP, {}, 1)
        robot.halted()
    assert [line["stood_ms"] for line in spooled(run)] == [None]
    assert client.next() is None


def test_a_gate_that_records_leaves_the_file_empty_and_one_that_does_not_fills_it(
    run: Path,
) -> None:
    with serving(run) as lane:
        client, gate = estop_fixtures.Client(run), estop_fixtures.Client(run)
        client.hello(ClientRole.PLANNER)
        client.stop()
        estop_fixtures.until(lambda: len(spooled(run)) == 1, "the spool's line")
        gate.hello(ClientRole.GATE)
        assert gate.told(Kind.EVENT)["n"] == 1
        gate.say(Kind.HEARD, {"n": 1})
        estop_fixtures.until(lambda: not spooled(run), "the spool's emptying")
        assert len(lane.journal) == 0
        client.stop()
        assert gate.told(Kind.EVENT)["n"] == 2
        estop_fixtures.until(lambda: [line["n"] for line in spooled(run)] == [2], "the second line")


def test_pipelined_stops_are_all_answered_in_turn(run: Path) -> None:
    with serving(run), estop_fixtures.obedient_robot(run):
        client = estop_fixtures.Client(run)
        client.hello(ClientRole.PLANNER)
        client.line.sendall(b"".join(frame(Kind.STOP, n, {}) for n in range(500)))
        answered = [client.next() for _ in range(500)]
        assert [item.id for item in answered if item is not None] == list(range(500))


def test_a_client_that_never_reads_is_dropped_and_delays_nobody(run: Path) -> None:
    with serving(run):
        deaf, client = estop_fixtures.Client(run), estop_fixtures.Client(run)
        deaf.hello(ClientRole.PLANNER)
        client.hello(ClientRole.PLANNER)
        deaf.line.settimeout(0)

        def is_dropped() -> bool:
            try:
                deaf.line.send(frame(Kind.STOP, 1, {}) * 50)
            except BlockingIOError:
                pass
            except OSError:
                return True
            assert client.stop()["controller"] is False
            return False

        estop_fixtures.until(is_dropped, "the deaf client's end")
        assert client.stop()["controller"] is False


def test_a_slow_reader_gets_everything_once_it_reads(run: Path) -> None:
    with serving(run):
        slow = estop_fixtures.Client(run)
        slow.hello(ClientRole.PLANNER)
        slow.line.sendall(frame(Kind.STOP, 1, {}) * 700)
        estop_fixtures.until(lambda: counted(run) == 700, "the last stop")
        for _ in range(700):
            assert slow.told(Kind.REPLY)["controller"] is False


def test_what_was_ended_is_said_once_with_its_count(run: Path) -> None:
    said: list[bytes] = []
    with serving(run, said=said):
        for _ in range(3):
            wrong = estop_fixtures.Client(run)
            wrong.line.sendall(b"\xff" * 64)
            assert wrong.dropped()["where"] == "frame.kind"
        estop_fixtures.until(lambda: said, "a line in the log")
    assert json.loads(said[0]) == {
        "ended": 1,
        "uid": os.geteuid(),
        "code": "MALFORMED",
        "where": "frame.kind",
    }


def test_a_disk_that_takes_nothing_delays_no_stop_and_is_asked_seldom(run: Path) -> None:
    with serving(run) as lane:
        client = estop_fixtures.Client(run)
        client.hello(ClientRole.PLANNER)
        file, lane.spool._file = lane.spool._file, os.open(FULL, os.O_WRONLY)
        for _ in range(3):
            client.stop()
        assert spooled(run) == []
        os.close(lane.spool._file)
        lane.spool._file = file
        estop_fixtures.until(lambda: len(spooled(run)) == 3, "the spool")


def test_more_stops_than_one_write_takes_are_written_in_order(run: Path) -> None:
    with turning(run) as lane:
        for number in range(1, LIMITS.batch * 2 + 1):
            lane.journal.others.keep(stop(number), is_fresh=True)
            lane.journal.first.keep(stop(LIMITS.batch * 2 + number), is_fresh=True)
        lane._turn()
        assert [line["n"] for line in spooled(run)] == list(range(1, LIMITS.batch + 1))
        assert len(spooled(run, FIRST_SPOOL)) == LIMITS.batch * 2  # an operator's waits for nothing
        lane._turn()
        assert [line["n"] for line in spooled(run)] == list(range(1, LIMITS.batch * 2 + 1))


def test_an_operator_s_stop_is_in_a_file_that_no_flood_fills_and_the_next_lane_has_it(
    run: Path,
) -> None:
    with serving(run) as lane:
        planner, operator, gate = (
            estop_fixtures.Client(run),
            estop_fixtures.Client(run),
            estop_fixtures.Client(run),
        )
        planner.hello(ClientRole.PLANNER)
        operator.hello(ClientRole.OPERATOR)
        gate.hello(ClientRole.GATE)  # one that listens and hears nothing
        lane.spool._most = 0
        planner.stop("flood")
        operator.stop("mine")
        estop_fixtures.until(lambda: spooled(run, FIRST_SPOOL), "the operator's line")
        assert lane.journal.others.is_fresh
        events = [gate.told(Kind.EVENT) for _ in range(2)]
        gate.say(Kind.HEARD, {"n": events[0]["n"]})
        epoch = lane.journal.epoch
        left = (run / FIRST_SPOOL).read_bytes()  # all that a kill would leave
    (run / SPOOL).unlink()
    (run / FIRST_SPOOL).write_bytes(left)
    with serving(run) as lane:
        gate = estop_fixtures.Client(run)
        gate.hello(ClientRole.GATE)
        event = gate.told(Kind.EVENT)
        assert (event["why"], event["epoch"], event["n"]) == ("mine", epoch, 2)
        assert lane.journal.epoch > epoch
        gate.say(Kind.HEARD, {"n": 2})
        estop_fixtures.until(lambda: not spooled(run, FIRST_SPOOL), "the emptying")


@pytest.mark.parametrize(
    ("said", "known", "wall_ms", "epoch"),
    [
        (None, (), 500, 500),
        (b"900", (), 500, 901),
        (b"900", (), 1_000, 1_000),
        (b"400", (1_200,), 500, 1_201),
        (b"what", (), 500, 500),
        (b"9" * 16, (), 500, 500),
        (b"", (499,), 500, 500),
    ],
)
def test_a_clock_that_was_set_back_makes_no_smaller_epoch(
    run: Path, said: bytes | None, known: tuple[int, ...], wall_ms: int, epoch: int
) -> None:
    if said is not None:
        (run / EPOCH).write_bytes(said)
    left = tuple(msgspec.structs.replace(stop(1), epoch=each) for each in known)
    assert next_epoch(run / EPOCH, wall_ms, left) == epoch
    assert next_epoch(run / EPOCH, wall_ms, left) > epoch


def test_a_name_that_cannot_be_written_down_is_done_without(run: Path) -> None:
    assert next_epoch(run / "nowhere" / EPOCH, 500, ()) == 500
    assert next_epoch(Path(FULL), 500, ()) == 500


def test_only_an_operator_s_stop_suspends() -> None:
    assert frozenset({ClientRole.OPERATOR}) == SUSPENDING


@contextmanager
def turning(run: Path) -> Iterator[EStopServer]:
    """A lane whose turns the test makes."""
    place = take_place(run)
    signer = folder_signer(scenarios.trust_folder(), f"gate-{scenarios.RID}")
    woken, waking = socket.socketpair()
    lane = EStopServer(
        place,
        scenarios.RID,
        estop_fixtures.config(),
        signer=signer,
        wake=woken.fileno(),
        say=lambda _: None,
    )
    yield lane
    waking.send(b"\0")
    lane.serve()
    woken.close()
    waking.close()
    leave_place(place)


def test_a_client_that_was_ended_in_this_turn_is_not_served_in_it(run: Path) -> None:
    with turning(run) as lane:
        client = estop_fixtures.Client(run)
        lane._turn()
        (peer,) = lane._lines
        client.line.sendall(b"\xff" * 9)
        lane._turn()
        lane._serve(peer, selectors.EVENT_READ)
        assert client.dropped()["where"] == "frame.kind"
        assert not lane._lines


def test_a_flood_of_connections_is_taken_in_few_turns_with_others_in_between(run: Path) -> None:
    with turning(run) as lane, selectors.DefaultSelector() as selector:
        selector.register(lane._listener, selectors.EVENT_READ)
        lines = estop_fixtures.many(run, LIMITS.accepted_at_once + 5)
        lane._turn()
        assert selector.select(0)
        lane._turn()
        assert not selector.select(0)
        for line in lines:
            line.close()


def test_a_client_that_leaves_without_reading_is_let_go(run: Path) -> None:
    with turning(run) as lane:
        client = estop_fixtures.Client(run)
        client.say(Kind.HELLO, {"protocol": PROTOCOL, "role": "planner", "client": "p"})
        lane._turn()
        lane._turn()
        client.close()
        lane._turn()
        assert not lane._lines


def test_a_connection_that_is_broken_in_the_middle_is_let_go(run: Path) -> None:
    with serving(run):
        client = estop_fixtures.Client(run)
        client.hello(ClientRole.PLANNER)
        for how in (b"\0\0", frame(Kind.STOP, 1, {}) * 400):
            other = estop_fixtures.Client(run)
            other.hello(ClientRole.PLANNER)
            other.line.sendall(how)
            other.line.close()
            assert client.stop()["controller"] is False


def test_when_no_connection_is_left_for_anybody_those_that_are_there_are_served(
    run: Path,
) -> None:
    with serving(run):
        client = estop_fixtures.Client(run)
        client.hello(ClientRole.PLANNER)
        taken: list[int] = []
        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        waiting = estop_fixtures.many(run, 1)
        extra = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        resource.setrlimit(resource.RLIMIT_NOFILE, (extra.fileno() + 1, hard))
        try:
            while True:
                taken.append(os.dup(0))
        except OSError:
            extra.connect(str(run / SOCKET))
            assert client.stop()["controller"] is False
        finally:
            for number in taken:
                os.close(number)
            resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
        assert estop_fixtures.until(lambda: estop_fixtures.open_of([*waiting, extra]) == 2)
        for line in (*waiting, extra):
            line.close()


def test_a_flood_of_connections_gets_what_one_user_may_have(run: Path) -> None:
    with serving(run, estop_fixtures.config(connections=5)):
        client = estop_fixtures.Client(run)
        client.hello(ClientRole.PLANNER)
        lines = estop_fixtures.many(run, 200)
        estop_fixtures.until(lambda: estop_fixtures.open_of(lines) <= 4, "the end of the excess")
        assert client.stop()["controller"] is False
        for line in lines:
            line.close()
    assert LIMITS.connections > 200


# beginning and end


def seen_by(files: Any, act: Callable[[EStopReady], None], favor: Any = None) -> list[EStopReady]:
    """Run a lane in this thread; another one acts on it, then ends it."""
    seen: list[EStopReady] = []
    failed: list[BaseException] = []

    def other(ready: EStopReady) -> None:
        try:
            act(ready)
        except BaseException as error:  # noqa: BLE001 - raised below, in the test's own thread
            failed.append(error)
        os.kill(os.getpid(), signal.SIGTERM)

    def ready(told: EStopReady) -> None:
        seen.append(told)
        threading.Thread(target=other, args=(told,)).start()

    run_stop_process(files, ready, favor or (lambda: Favor(priority=False, memory=False)))
    if failed:
        raise failed[0]
    return seen


def test_a_lane_says_what_it_is_and_leaves_nothing_behind_but_the_file() -> None:
    files = estop_fixtures.files()
    before = signal.getsignal(signal.SIGTERM)

    def act(ready: EStopReady) -> None:
        client = estop_fixtures.Client(files.run)
        client.hello(ClientRole.PLANNER)
        client.stop("once")
        client.close()

    def favor() -> Favor:
        try:
            return ask_favor(nice=0, lock=0)  # neither priority nor memory is this test's to take
        finally:
            gc.unfreeze()

    (ready,) = seen_by(files, act, favor)
    assert (ready.pid, ready.unheard, ready.spool) == (os.getpid(), 0, True)
    assert (ready.favored, ready.locked) == (True, False)
    left = ["gate.token", FIRST_SPOOL, EPOCH, SPOOL]
    assert sorted(path.name for path in files.run.iterdir()) == left
    assert signal.getsignal(signal.SIGTERM) is before
    (again,) = seen_by(files, lambda ready: None)
    assert again.unheard == 1


def test_what_the_machine_does_not_give_is_done_without() -> None:
    assert not is_given(lambda: os.setpriority(os.PRIO_PROCESS, 2**22 + 1, 0))
    assert is_given(lambda: None)


def test_a_lane_does_not_start_with_another_robot_s_certificate() -> None:
    files = estop_fixtures.files()
    keys = scenarios.trust_folder() / "keys"
    other = msgspec.structs.replace(
        files,
        key=keys / f"gate-{scenarios.OTHER}.key.pem",
        cert=keys / f"gate-{scenarios.OTHER}.cert.pem",
    )
    with pytest.raises(AuthenticityError) as caught:
        run_stop_process(other, lambda ready: None)
    assert caught.value.reason is Reason.ROBOT_MISMATCH
    assert not (files.run / SOCKET).exists()


def test_a_lane_does_not_start_with_a_configuration_that_does_not_hold() -> None:
    files = estop_fixtures.files()
    files.config.write_bytes(files.config.read_bytes().replace(b"A", b"B", 1))
    with pytest.raises((AuthenticityError, MalformedError)):
        run_stop_process(files, lambda ready: None)
    files.config.unlink()
    with pytest.raises(EnvironmentFault):
        run_stop_process(files, lambda ready: None)


def test_the_log_is_written_or_not_but_never_waited_for(capfd: pytest.CaptureFixture[str]) -> None:
    say_to_stderr(b"one\n")
    kept = os.dup(2)
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    try:
        os.dup2(writer, 2)
        with suppress(BlockingIOError):
            while True:
                os.write(writer, b"x" * 4096)
        say_to_stderr(b"two\n")
        os.close(reader)
        say_to_stderr(b"three\n")
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(writer)
    assert capfd.readouterr().err == "one\n"


# the gate's link


def test_a_gate_hears_of_stops_and_forgets_them() -> None:
    files = estop_fixtures.files()
    heard: list[StopHeard] = []
    lost: list[AuthGuardError | None] = []

    async def gate() -> None:
        link = EStopConnection(files.run / SOCKET, heard.append, lost.append)
        await link.connect()
        await soon(lambda: heard)
        link.heard(heard[-1].n)
        assert link.welcome is not None
        assert link.welcome.robot == scenarios.RID
        second = EStopConnection(files.run / SOCKET, heard.append)
        await second.connect()
        await soon(lambda: lost)
        link.heard(1)
        link.close()
        second.close()
        await soon(lambda: second._line is None)

    with serving(files.run) as lane:
        client = estop_fixtures.Client(files.run)
        client.hello(ClientRole.OPERATOR, "anna")
        client.stop("enough")
        asyncio.run(gate())
        estop_fixtures.until(lambda: not lane.journal, "the forgetting")
    assert [(s.by, s.role, s.why) for s in heard] == [("anna", ClientRole.OPERATOR, "enough")]
    assert lost[0] is not None
    assert lost[0].reason is Reason.BUSY


async def soon(true: Callable[[], Any]) -> None:
    end = time.monotonic() + estop_fixtures.SOON_S
    while not true():
        assert time.monotonic() < end
        await asyncio.sleep(0.005)


def test_a_gate_without_a_lane_says_so(run: Path) -> None:
    with pytest.raises(EnvironmentFault, match="does not serve"):
        asyncio.run(EStopConnection(run / SOCKET, lambda stop: None).connect())


def test_a_gate_does_not_believe_another_user_s_lane(
    run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with serving(run):
        own = os.geteuid()
        monkeypatch.setattr("authguard_r.estop.connection.os.geteuid", lambda: own + 1)
        with pytest.raises(AuthenticityError, match="not the gate's own"):
            asyncio.run(EStopConnection(run / SOCKET, lambda stop: None).connect())


def test_a_gate_lets_go_of_a_lane_that_makes_no_sense(run: Path) -> None:
    lost: list[AuthGuardError | None] = []

    async def talk() -> None:
        async def babble(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            writer.write(frame(Kind.EVENT, 0, {"n": 0}))
            writer.close()
            await writer.wait_closed()

        async with await asyncio.start_unix_server(babble, run / SOCKET):
            await EStopConnection(run / SOCKET, lambda stop: None, lost.append).connect()
            await soon(lambda: lost)

    asyncio.run(talk())
    assert isinstance(lost[0], MalformedError)


def test_a_gate_that_asks_is_answered_after_it_heard_and_never_when_the_lane_is_gone(
    run: Path,
) -> None:
    came: list[str] = []

    async def gate(lane_client: estop_fixtures.Client) -> None:
        link = EStopConnection(run / SOCKET, lambda stop: came.append(stop.why))
        link.sync(lambda: came.append("before it was there"))
        assert not link.connected
        await link.connect()
        assert link.connected
        lane_client.say(Kind.STOP, {"why": "mine"}, 1)
        await asyncio.to_thread(lane_client.told, Kind.REPLY)
        link.sync(lambda: came.append("one"))
        link.sync(lambda: came.append("two"))
        await soon(lambda: "two" in came)
        link.sync(lambda: came.append("after its end"))
        link.close()
        await soon(lambda: not link.connected)

    with serving(run):
        client = estop_fixtures.Client(run)
        client.hello(ClientRole.OPERATOR)
        asyncio.run(gate(client))
    assert came == ["mine", "one", "two"]


def test_an_answer_that_nobody_asked_for_ends_the_link(run: Path) -> None:
    lost: list[AuthGuardError | None] = []

    async def talk() -> None:
        async def babble(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            writer.write(frame(Kind.REPLY, 1, {}))
            writer.close()
            await writer.wait_closed()

        async with await asyncio.start_unix_server(babble, run / SOCKET):
            await EStopConnection(run / SOCKET, lambda stop: None, lost.append).connect()
            await soon(lambda: lost)

    asyncio.run(talk())
    assert isinstance(lost[0], MalformedError)
    assert lost[0].where == "frame.id"


def test_a_gate_whose_lane_takes_nobody_says_so(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bounded(monkeypatch, connection, stop_connect_s=0.05)
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    listener.bind(str(run / SOCKET))
    listener.listen(0)
    waiting = estop_fixtures.many(run, 1)
    with pytest.raises(EnvironmentFault, match="queue is full"):
        asyncio.run(EStopConnection(run / SOCKET, lambda stop: None).connect())
    waiting[0].close()
    listener.close()


def test_a_lane_is_started_once_and_outlives_its_starter() -> None:
    files = estop_fixtures.files()
    process = start_stop_process(files)
    assert process is not None
    try:
        assert os.getsid(process.pid) == process.pid
        assert start_stop_process(files) is None
        assert is_served(files.run / SOCKET)
        process.terminate()
        assert process.wait(estop_fixtures.SOON_S) == 0
        assert not (files.run / SOCKET).exists()
    finally:
        process.kill()
        process.wait()


def test_a_lane_that_does_not_serve_is_said_to() -> None:
    files = estop_fixtures.files()
    files.config.unlink()
    with pytest.raises(EnvironmentFault, match="cannot read"):
        start_stop_process(files)
    gone = msgspec.structs.replace(files, run=files.run / "nowhere")
    with pytest.raises(EnvironmentFault, match="does not serve"):
        start_stop_process(gone)


def test_a_lane_that_says_nothing_is_said_not_to_serve(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("authguard_r.estop.connection.sys.executable", "/bin/true")
    with pytest.raises(EnvironmentFault, match="does not say"):
        start_stop_process(estop_fixtures.files())
