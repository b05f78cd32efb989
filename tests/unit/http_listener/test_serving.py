# SPDX-License-Identifier: Apache-2.0
"""A real port, strangers at it, and somebody whose request was let in.

Source: docs/spec/listeners.md#which-connection-is-closed-when-the-limit-is-reached
"""

from __future__ import annotations

import asyncio
import json
import os
import resource
import signal
import socket
from collections.abc import Callable
from pathlib import Path
from threading import Event
from typing import Any

import pytest
from msgspec.structs import replace

from authguard_r.integrations.http_listener.access import listening
from authguard_r.integrations.http_listener.admission import AdmissionControl, AdmissionLimits
from authguard_r.integrations.http_listener.connection import (
    GUEST,
    GoneError,
    HttpConnection,
    let_in,
)
from authguard_r.integrations.http_listener.server import Acceptor, serve_until_signal
from authguard_r.wire.json_log import Lines

LIMITS = AdmissionLimits(connections=4, body=0)
KNOWN = b"GET /known HTTP/1.1\r\nHost: a\r\n\r\n"
SOON_S = 30.0
Address = tuple[str, int]


class Answers:
    """An application that lets `/known` in, and answers it when it is told to."""

    def __init__(self) -> None:
        self.goes_on = Event()
        self.asked = Event()

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        if scope["path"] == "/known":
            let_in(scope)
            self.asked.set()
            await asyncio.to_thread(self.goes_on.wait, SOON_S)
        await send({"type": "http.response.start", "status": 204, "headers": []})
        await send({"type": "http.response.body", "body": b""})


def served(
    said: Callable[[Answers, Address], None], log: Path, limits: AdmissionLimits = LIMITS
) -> list[dict[str, Any]]:
    """Serve while somebody talks in a thread; return what was written."""
    app = Answers()

    async def run() -> None:
        with listening("127.0.0.1:0") as made, log.open("wb") as file:
            address = made.getsockname()
            lines = Lines(file.fileno())
            serving = asyncio.ensure_future(serve_until_signal(app, made, limits, lines))
            try:
                async with asyncio.timeout(2 * SOON_S):
                    await asyncio.to_thread(said, app, address)
            finally:
                app.goes_on.set()
                os.kill(os.getpid(), signal.SIGTERM)
                await serving

    asyncio.run(run())
    return [json.loads(line) for line in log.read_bytes().splitlines()]


def line(address: Address) -> socket.socket:
    return socket.create_connection(address, timeout=SOON_S)


def is_gone(link: socket.socket) -> bool:
    """Wait until the server has let go of a connection."""
    try:
        return link.recv(1) == b""
    except ConnectionResetError:
        return True


def test_strangers_come_and_go_and_who_was_let_in_has_his_answer(tmp_path: Path) -> None:
    def said(app: Answers, address: Address) -> None:
        with line(address) as known:
            known.sendall(KNOWN)
            assert app.asked.wait(SOON_S)
            strangers = [line(address) for _ in range(12)]
            assert all(is_gone(one) for one in strangers[:9])
            app.goes_on.set()
            assert known.recv(1 << 16).startswith(b"HTTP/1.1 204 ")
            more = [line(address) for _ in range(3)]  # who rests goes after all strangers
            assert all(is_gone(one) for one in strangers[9:])
            known.sendall(KNOWN)
            assert known.recv(1 << 16).startswith(b"HTTP/1.1 204 ")
            for one in (*strangers, *more):
                one.close()

    lines = served(said, tmp_path / "log")
    assert {one["event"] for one in lines} == {"crowded"}


def test_when_all_wait_for_answers_who_comes_goes(tmp_path: Path) -> None:
    def said(app: Answers, address: Address) -> None:
        known = [line(address) for _ in range(4)]
        for one in known:
            app.asked.clear()
            one.sendall(KNOWN)
            assert app.asked.wait(SOON_S)
        with line(address) as late:
            assert is_gone(late)
        app.goes_on.set()
        for one in known:
            assert one.recv(1 << 16).startswith(b"HTTP/1.1 204 ")
            one.close()

    served(said, tmp_path / "log")


def test_who_says_nothing_is_let_go_and_the_end_lets_go_of_all(tmp_path: Path) -> None:
    kept: list[socket.socket] = []

    def said(_: Answers, address: Address) -> None:
        with line(address) as silent:
            assert is_gone(silent)
        kept.append(line(address))

    served(said, tmp_path / "log", replace(LIMITS, first_s=0.2))
    assert is_gone(kept[0])
    kept[0].close()


def test_without_a_file_for_the_next_one_a_stranger_makes_place(tmp_path: Path) -> None:
    async def run() -> None:
        with listening("127.0.0.1:0") as made, (tmp_path / "log").open("wb") as file:
            made_address = made.getsockname()
            lines = Lines(file.fileno())
            door = Acceptor(made, LIMITS, lines)
            came: list[HttpConnection] = []

            class Silent(asyncio.Protocol):
                def __init__(self, guest: HttpConnection) -> None:
                    self.guest = guest
                    came.append(guest)

                def connection_made(self, transport: Any) -> None:
                    self.guest.arrive(transport)

                def connection_lost(self, exc: Exception | None) -> None:
                    self.guest.leave()

            door.open(Silent)
            first = await asyncio.to_thread(line, made_address)
            while not came:
                await asyncio.sleep(0.01)
            soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
            second = socket.socket()
            second.setblocking(False)
            resource.setrlimit(resource.RLIMIT_NOFILE, (0, hard))
            try:
                second.connect_ex(made_address)
                while door._again is None:
                    await asyncio.sleep(0.01)
            finally:
                resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
            assert await asyncio.to_thread(is_gone, first)
            while len(came) < 2:
                await asyncio.sleep(0.01)
            door.close()
            door.clear()
            second.setblocking(True)
            assert await asyncio.to_thread(is_gone, second)
            first.close()
            second.close()
            lines.write({"event": "later"})

    async def bounded() -> None:
        async with asyncio.timeout(SOON_S):
            await run()

    asyncio.run(bounded())
    # with no file allowed even the log could not be looked at: it is counted
    assert json.loads((tmp_path / "log").read_bytes())["dropped"] == 1


def test_a_guest_who_was_sent_away_before_he_arrived_does_not_stay() -> None:
    class Transport(asyncio.Transport):
        aborted = False

        def abort(self) -> None:
            self.aborted = True

    async def run() -> None:
        guest, transport = HttpConnection(AdmissionControl(1), LIMITS), Transport()
        guest.go()
        guest.arrive(transport)
        assert transport.aborted

    asyncio.run(run())


def test_a_request_of_a_guest_who_is_gone_is_not_carried_out() -> None:
    guest = HttpConnection(AdmissionControl(1), LIMITS)
    guest.go()
    with pytest.raises(GoneError):
        let_in({"type": "http", GUEST: guest})


def test_a_request_without_a_listener_of_ours_is_let_in_all_the_same() -> None:
    let_in({"type": "http"})


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_it_serves_until_it_is_told_to_end(number: signal.Signals, tmp_path: Path) -> None:
    async def run() -> None:
        with listening("127.0.0.1:0") as made:
            serving = asyncio.ensure_future(
                serve_until_signal(Answers(), made, LIMITS, Lines(2), has_lifespan=False)
            )
            await asyncio.sleep(0.05)
            os.kill(os.getpid(), number)
            async with asyncio.timeout(SOON_S):
                await serving

    asyncio.run(run())
