# SPDX-License-Identifier: Apache-2.0
"""One who is slow, silent, greedy or talks nonsense takes nothing from the others."""

from __future__ import annotations

import json
import os
import resource
import signal
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from authguard_r.integrations.http_listener.access import listening
from authguard_r.integrations.http_listener.admission import AdmissionLimits
from authguard_r.wire.json_log import Lines
from authguard_r.witness.server import LIMITS, PATH, WitnessReady, WitnessServer, run_witness
from authguard_r.witness.service import Witness
from fixtures.witness_process import ORIGIN, SOON_S, Log, make, open_witness

HASTY = replace(LIMITS, first_s=0.2, idle_s=0.2, take_s=0.2)
GET = b"GET / HTTP/1.1\r\n\r\n"


class Door:
    """A server in a thread, and connections to it that say exactly what the test wants."""

    def __init__(self, server: WitnessServer, address: Any, waking: socket.socket) -> None:
        self.server = server
        self._address = address
        self._waking = waking
        self._thread = threading.Thread(target=server.serve)
        self.lines: list[socket.socket] = []

    def start(self) -> None:
        self._thread.start()

    def line(self, data: bytes = b"") -> socket.socket:
        line = socket.create_connection(self._address, timeout=SOON_S)
        self.lines.append(line)
        line.sendall(data)
        return line

    def wake(self) -> None:
        self._waking.send(b"x")

    def end(self) -> None:
        self.wake()
        self._thread.join(SOON_S)
        assert not self._thread.is_alive()


@pytest.fixture
def log() -> Log:
    return Log().grow(20)


@pytest.fixture
def witness(tmp_path: Path, log: Log) -> Iterator[Witness]:
    found = open_witness(make(tmp_path / "w", log))
    yield found
    found.close()


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[Lines]:
    with (tmp_path / "journal").open("wb") as file:
        yield Lines(file.fileno())


def told(tmp_path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (tmp_path / "journal").read_bytes().splitlines()]


@contextmanager
def door(witness: Witness, journal: Lines, limits: AdmissionLimits = LIMITS) -> Iterator[Door]:
    """A server that serves once it is started, and has ended afterwards."""
    listener = listening("127.0.0.1:0")
    woken, waking = socket.socketpair()
    with listener, woken, waking:
        server = WitnessServer(witness, listener, woken, journal=journal, limits=limits)
        made = Door(server, listener.getsockname(), waking)
        made.start()
        try:
            yield made
        finally:
            made.end()
            for line in made.lines:
                line.close()


def post(body: bytes, *more: str) -> bytes:
    head = [f"POST {PATH} HTTP/1.1", f"Content-Length: {len(body)}", *more]
    return "\r\n".join(head).encode() + b"\r\n\r\n" + body


def answer(line: socket.socket) -> tuple[int, bytes]:
    """Return the next answer of a connection."""
    data = b""
    while b"\r\n\r\n" not in data:
        part = line.recv(1)
        assert part, "the connection ended"
        data += part
    length = int(data.lower().partition(b"content-length: ")[2].split(b"\r\n")[0])
    body = b""
    while len(body) < length:
        body += line.recv(length - len(body))
    return int(data.split(b" ")[1]), body


def ended(line: socket.socket) -> bool:
    """Wait until the server ends a connection."""
    try:
        while line.recv(1 << 16):
            pass
    except ConnectionResetError:
        pass
    return True


def test_many_requests_on_one_connection_are_answered_in_order(
    witness: Witness, journal: Lines, log: Log, tmp_path: Path
) -> None:
    with door(witness, journal) as made:
        bodies = [log.ask(0, 5), log.ask(5, 9), log.ask(5, 9), log.ask(9)]
        line = made.line(b"".join(post(body) for body in bodies))
        answers = [answer(line) for _ in bodies]
    assert [status for status, _ in answers] == [200, 200, 409, 200]
    assert answers[2][1] == b"9\n"
    lines = told(tmp_path)
    assert [line["event"] for line in lines] == ["cosigned", "cosigned", "stale", "cosigned"]
    assert {line["log"] for line in lines} == {ORIGIN}


@pytest.mark.parametrize(
    ("sent", "status", "stays"),
    [
        (b"GET / HTTP/1.1\r\n\r\n", 404, True),
        (b"GET /add-checkpoint HTTP/1.1\r\n\r\n", 405, True),
        (b"PUT /add-checkpoint HTTP/1.1\r\nContent-Length: 1\r\n\r\nx", 405, True),
        (b"POST /add-checkpoint/ HTTP/1.1\r\nContent-Length: 0\r\n\r\n", 404, True),
        (b"POST /add-checkpoint?x HTTP/1.1\r\nContent-Length: 0\r\n\r\n", 404, True),
        (b"POST /add-checkpoint HTTP/1.1\r\nContent-Length: 0\r\n\r\n", 400, True),
        (b"POST /add-checkpoint HTTP/1.0\r\nContent-Length: 0\r\n\r\n", 400, False),
        (b"POST /add-checkpoint HTTP/1.1\r\n\r\n", 411, False),
        (b"\x16\x03\x01\x00\r\n\r\n", 400, False),
        (b"\x00" * 9_000, 431, False),
    ],
)
def test_what_is_not_the_one_call_is_refused(
    witness: Witness, journal: Lines, sent: bytes, status: int, stays: bool
) -> None:
    with door(witness, journal) as made:
        line = made.line(sent)
        assert answer(line)[0] == status
        if stays:
            line.sendall(GET)
            assert answer(line)[0] == 404
        else:
            assert ended(line)


def test_an_answer_to_head_has_no_body(witness: Witness, journal: Lines) -> None:
    with door(witness, journal) as made:
        line = made.line(b"HEAD / HTTP/1.1\r\n\r\n" + GET)
        data = b""
        while data.count(b"\r\n\r\n") < 2:
            data += line.recv(1 << 16)
    assert data.count(b"HTTP/1.1 404") == 2
    assert data.split(b"\r\n\r\n")[1].startswith(b"HTTP/1.1 404")


def test_who_waits_to_go_on_is_told_once(witness: Witness, journal: Lines, log: Log) -> None:
    body = log.ask(0)
    with door(witness, journal) as made:
        line = made.line(post(body, "Expect: 100-continue")[: -len(body)])
        assert line.recv(1 << 16) == b"HTTP/1.1 100 Continue\r\n\r\n"
        line.sendall(body[:10])
        line.sendall(body[10:])
        assert answer(line)[0] == 200


def test_an_answer_arrives_although_its_sender_never_stopped(
    witness: Witness, journal: Lines
) -> None:
    head = f"POST {PATH} HTTP/1.1\r\nContent-Length: 99999999\r\n\r\n".encode()
    with door(witness, journal) as made:
        line = made.line(head)
        line.sendall(b"x" * (1 << 20))
        assert answer(line)[0] == 413
        assert ended(line)


@pytest.mark.parametrize("sent", [b"", b"P", post(b"abc")[:-1], GET, GET + b"G"])
def test_who_says_nothing_more_is_let_go(witness: Witness, journal: Lines, sent: bytes) -> None:
    with door(witness, journal, HASTY) as made:
        assert ended(made.line(sent))


def drip(line: socket.socket) -> None:
    """Send a byte now and then, as long as somebody takes it."""
    while True:
        line.sendall(b"x")
        threading.Event().wait(0.01)


def test_who_drips_is_let_go_all_the_same(witness: Witness, journal: Lines) -> None:
    with door(witness, journal, HASTY) as made:
        line = made.line()
        with pytest.raises(OSError, match=r"Broken pipe|reset"):
            drip(line)


def test_who_goes_away_is_forgotten(witness: Witness, journal: Lines, log: Log) -> None:
    with door(witness, journal) as made:
        made.line(b"PO").close()
        line = made.line(post(log.ask(0))[:-5])
        line.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
        line.close()  # reset, not ended
        assert answer(made.line(post(log.ask(0))))[0] == 200


def test_too_many_make_room_for_the_newest(witness: Witness, journal: Lines, log: Log) -> None:
    with door(witness, journal, replace(LIMITS, connections=4)) as made:
        first = made.line(GET)
        assert answer(first)[0] == 404
        silent = [made.line() for _ in range(12)]
        last = made.line(post(log.ask(0)))
        assert answer(last)[0] == 200
        assert ended(first)
        assert all(ended(line) for line in silent[:9])
        # who got something done stays longer than who did not
        for _ in range(3):
            made.line()
            last.sendall(GET)
            assert answer(last)[0] == 404


def idle(
    witness: Witness, journal: Lines, limits: AdmissionLimits = LIMITS
) -> Iterator[WitnessServer]:
    """A server whose loop the test runs by hand."""
    listener = listening("127.0.0.1:0")
    woken, waking = socket.socketpair()
    with listener, woken, waking:
        yield WitnessServer(witness, listener, woken, journal=journal, limits=limits)


by_hand = contextmanager(idle)


def test_when_no_file_is_left_one_connection_makes_room(witness: Witness, journal: Lines) -> None:
    with by_hand(witness, journal) as server:
        server._accept()  # nobody is there any more
        mine, others = socket.socketpair()
        server._take(mine)
        ours = socket.create_connection(server._listener.getsockname(), timeout=SOON_S)
        _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
        before = resource.getrlimit(resource.RLIMIT_NOFILE)
        resource.setrlimit(resource.RLIMIT_NOFILE, (0, most))
        try:
            server._accept()
            server._accept()  # with nobody to drop it waits for better times
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, before)
        assert others.recv(1) == b""
        server._accept()
        assert len(server._room.guests) == 1
        ours.close()
        others.close()
        server._end()
        server.serve()
        server._accept()


def test_who_takes_no_answers_is_waited_for_and_holds_nobody(
    witness: Witness, journal: Lines
) -> None:
    with by_hand(witness, journal) as server:
        mine, others = socket.socketpair()
        others.settimeout(SOON_S)
        mine.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1)
        server._take(mine)
        (line,) = server._room.guests
        asked = 0
        while not line.out:  # until no answer fits any more
            others.send(GET)
            server._read(line)
            asked += 1
        assert server._pause() is not None
        server._write(line)  # still nothing fits
        assert line.out
        thread = threading.Thread(target=server.serve)
        server._end()  # what was judged is still answered
        assert line.ends
        thread.start()
        got = b""
        while part := others.recv(1 << 16):
            got += part
        others.close()
        thread.join(SOON_S)
        assert got.count(b"HTTP/1.1 404") == asked


def test_what_comes_for_a_connection_that_is_gone_is_nothing(
    witness: Witness, journal: Lines
) -> None:
    with by_hand(witness, journal) as server:
        mine, others = socket.socketpair()
        server._take(mine)
        (line,) = server._room.guests
        line.reader.feed(GET)
        server._drop(line)
        for act in (server._read, server._next, server._write):
            act(line)
        assert not line.out
        assert others.recv(1) == b""
        others.close()
        # its other end is gone before the answer
        mine, others = socket.socketpair()
        server._take(mine)
        (line,) = server._room.guests
        others.send(GET)
        others.close()
        server._read(line)
        assert server._room.guests == ()
        server._end()
        server.serve()


def test_lines_that_are_open_when_the_loop_breaks_are_closed(
    witness: Witness, journal: Lines, monkeypatch: pytest.MonkeyPatch
) -> None:
    with by_hand(witness, journal) as server:
        mine, others = socket.socketpair()
        server._take(mine)
        monkeypatch.setattr(server, "_pause", lambda: 1 // 0)
        with pytest.raises(ZeroDivisionError):
            server.serve()
        assert others.recv(1) == b""
        others.close()


def test_an_end_closes_at_once_who_has_nothing_coming(witness: Witness, journal: Lines) -> None:
    with door(witness, journal) as made:
        silent, half, told_off = made.line(), made.line(post(b"abc")[:-1]), made.line(b"\r\n\r\n")
        assert answer(told_off)[0] == 400
        assert answer(made.line(GET))[0] == 404
        made.end()
        assert ended(silent)
        assert ended(half)
        assert ended(told_off)


def test_a_fault_of_ours_is_an_answer_that_signs_nothing(
    witness: Witness, journal: Lines, log: Log, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with door(witness, journal) as made:
        with monkeypatch.context() as patched:
            patched.setattr(witness, "_key", None)
            status, body = answer(made.line(post(log.ask(0))))
        assert (status, body) == (500, b"a fault of the witness\n")
        assert answer(made.line(post(log.ask(0))))[0] == 200
    assert told(tmp_path)[0]["event"] == "fault"


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_it_serves_until_it_is_told_to_end(
    witness: Witness, journal: Lines, log: Log, number: signal.Signals
) -> None:
    seen: list[WitnessReady] = []
    before = signal.getsignal(number)

    def asks(ready: WitnessReady) -> None:
        seen.append(ready)
        host, _, port = ready.url.partition("//")[2].rpartition(":")

        def ask() -> None:
            with socket.create_connection((host, int(port)), timeout=SOON_S) as line:
                line.sendall(post(log.ask(0)))
                statuses.append(answer(line)[0])
            os.kill(os.getpid(), number)

        threads.append(threading.Thread(target=ask))
        threads[0].start()

    statuses: list[int] = []
    threads: list[threading.Thread] = []
    with listening("127.0.0.1:0") as made:
        run_witness(witness, made, asks, journal=journal)
    threads[0].join(SOON_S)
    assert statuses == [200]
    assert (seen[0].logs, seen[0].pid) == (1, os.getpid())
    assert seen[0].key == witness.book.identity.key
    assert signal.getsignal(number) is before


def test_strangers_hide_nothing_that_is_said_of_a_log(
    witness: Witness, journal: Lines, log: Log, tmp_path: Path
) -> None:
    with door(witness, journal) as made:
        for _ in range(3 * LIMITS.lines):
            assert answer(made.line(GET))[0] == 404
        assert answer(made.line(post(log.ask(0))))[0] == 200
    assert [line["event"] for line in told(tmp_path)].count("cosigned") == 1
