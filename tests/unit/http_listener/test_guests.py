# SPDX-License-Identifier: Apache-2.0
"""Connections of clients that ask nothing, read nothing, or take their time; plain and with TLS."""

from __future__ import annotations

import asyncio
import gc
import ssl
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any
from weakref import ref

import pytest
import uvicorn
from msgspec.structs import replace
from uvicorn.server import ServerState

from authguard_r.integrations.http.tls import Secured, read_context
from authguard_r.integrations.http_listener import connection
from authguard_r.integrations.http_listener.admission import AdmissionControl, AdmissionLimits
from authguard_r.integrations.http_listener.connection import HttpConnection, Patient, let_in
from fixtures.decision_point import server_certificate, trusting
from fixtures.gate_process import PATIENCE_S

LONG = 32 << 20
LIMITS = AdmissionLimits(connections=8, body=0)
GET = b"GET / HTTP/1.1\r\nHost: a\r\n\r\n"
Streams = tuple[asyncio.StreamReader, asyncio.StreamWriter]


async def long_answer(scope: Any, receive: Any, send: Any) -> None:
    headers = [(b"content-length", str(LONG).encode())]
    await send({"type": "http.response.start", "status": 200, "headers": headers})
    await send({"type": "http.response.body", "body": bytes(LONG)})


async def slow_answer(scope: Any, receive: Any, send: Any) -> None:
    await asyncio.sleep(0.3)
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": b"done"})


async def swallow(scope: Any, receive: Any, send: Any) -> None:
    size, more = 0, True
    while more:
        message = await receive()
        size += len(message["body"])
        more = message["more_body"]
        await asyncio.sleep(0)
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": str(size).encode()})


@asynccontextmanager
async def opened(
    app: Any, *, secure: bool, limits: AdmissionLimits, made: list[Any] | None = None
) -> AsyncIterator[Streams]:
    """Yield one connection to a server of this application; `made` gets its protocol."""
    config = uvicorn.Config(app, log_config=None, log_level="critical", timeout_keep_alive=1)
    config.load()
    state = ServerState()

    def make() -> asyncio.Protocol:
        room: AdmissionControl[HttpConnection] = AdmissionControl(8)
        guest = HttpConnection(room, limits)
        room.enter(guest)

        def inner() -> Patient:
            protocol = Patient(guest, config=config, server_state=state, app_state={})
            if made is not None:
                made.append(ref(protocol))
            return protocol

        return Secured(context, guest, inner) if secure else inner()

    context = read_context(*server_certificate(), client_certificates=False)
    server = await asyncio.get_running_loop().create_server(make, "127.0.0.1", 0)
    async with server:
        port = server.sockets[0].getsockname()[1]
        how = trusting() if secure else None
        reader, writer = await asyncio.open_connection("127.0.0.1", port, ssl=how)
        try:
            yield reader, writer
        finally:
            writer.transport.abort()


def talk(
    app: Any,
    said: Callable[[Any, Any], Awaitable[Any]],
    *,
    secure: bool,
    limits: AdmissionLimits = LIMITS,
) -> Any:
    async def run() -> Any:
        made = opened(app, secure=secure, limits=limits)
        async with asyncio.timeout(60), made as (reader, writer):
            return await said(reader, writer)

    return asyncio.run(run())


async def rest(reader: asyncio.StreamReader) -> bytes:
    """Return what comes until the server lets go."""
    found = b""
    try:
        while got := await reader.read(1 << 20):
            found += got
    except (ConnectionError, ssl.SSLError):
        pass
    return found


@pytest.mark.parametrize("secure", [False, True])
def test_a_client_that_reads_is_sent_everything(secure: bool) -> None:
    async def said(reader: Any, writer: Any) -> int:
        writer.write(GET)
        await reader.readuntil(b"\r\n\r\n")
        return len(await reader.readexactly(LONG))

    assert talk(long_answer, said, secure=secure) == LONG


@pytest.mark.parametrize("secure", [False, True])
def test_a_client_that_reads_nothing_is_let_go(
    secure: bool,
) -> None:
    async def said(reader: Any, writer: Any) -> int:
        writer.write(GET)
        writer.transport.pause_reading()
        await asyncio.sleep(1.5)
        writer.transport.resume_reading()
        return len(await rest(reader))

    assert talk(long_answer, said, secure=secure, limits=replace(LIMITS, take_s=0.3)) < LONG


@pytest.mark.parametrize("secure", [False, True])
def test_a_client_that_asks_nothing_is_let_go(
    secure: bool,
) -> None:
    async def said(reader: Any, writer: Any) -> bytes:
        writer.write(GET[:-2])
        return await rest(reader)

    assert talk(swallow, said, secure=secure, limits=replace(LIMITS, first_s=0.2)) == b""


@pytest.mark.parametrize("secure", [False, True])
def test_a_long_answer_is_waited_for_and_a_silent_client_is_not(
    secure: bool,
) -> None:
    async def said(reader: Any, writer: Any) -> bytes:
        writer.write(GET)
        return await rest(reader)

    limits = replace(LIMITS, first_s=0.1)
    assert talk(slow_answer, said, secure=secure, limits=limits).endswith(
        b"\r\n4\r\ndone\r\n0\r\n\r\n"
    )


def test_a_silent_client_is_let_go_after_its_answer() -> None:
    async def said(reader: Any, writer: Any) -> bytes:
        writer.write(GET)
        return await rest(reader)

    assert b"0" in talk(swallow, said, secure=True)


@pytest.mark.parametrize("secure", [False, True])
def test_what_is_no_request_ends_its_connection(secure: bool) -> None:
    async def said(reader: Any, writer: Any) -> bytes:
        writer.write(b"nonsense\r\n\r\n")
        writer.write(GET)
        return await rest(reader)

    assert talk(swallow, said, secure=secure).startswith(b"HTTP/1.1 400 ")


def test_a_client_that_says_goodbye_is_answered_in_kind() -> None:
    async def said(reader: Any, writer: Any) -> None:
        writer.write(GET)
        await reader.readuntil(b"0\r\n\r\n")
        writer.close()
        await writer.wait_closed()

    assert talk(swallow, said, secure=True) is None


@pytest.mark.parametrize("secure", [False, True])
def test_a_long_body_is_read_as_fast_as_it_is_taken(secure: bool) -> None:
    async def said(reader: Any, writer: Any) -> bytes:
        head = f"POST / HTTP/1.1\r\nHost: a\r\nConnection: close\r\nContent-Length: {LONG}\r\n\r\n"
        writer.write(head.encode() + bytes(LONG))
        return await rest(reader)

    assert str(LONG).encode() in talk(swallow, said, secure=secure)


BODY = b"POST / HTTP/1.1\r\nHost: a\r\nContent-Length: 4\r\n\r\nbody"


class Counting:
    """Answers, and counts how often; whose number is in `known` is let in."""

    def __init__(self, *known: int) -> None:
        self.asked = 0
        self._known = known

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        self.asked += 1
        if self.asked in self._known:
            let_in(scope)
        await send({"type": "http.response.start", "status": 200, "headers": []})
        await send({"type": "http.response.body", "body": b"done"})


async def answers(reader: Any, count: int) -> None:
    for _ in range(count):
        await reader.readuntil(b"0\r\n\r\n")


@pytest.mark.parametrize("secure", [False, True])
@pytest.mark.parametrize("asked", [GET, BODY, BODY[:-4]], ids=["get", "post", "late body"])
def test_a_stranger_who_asks_again_and_again_is_not_read_at_once(
    asked: bytes, secure: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All at once, one after the other, or with a body that comes after the refusal."""
    monkeypatch.setattr(connection, "STRANGERS", 1 / PATIENCE_S)
    app = Counting()

    async def said(reader: Any, writer: Any) -> bytes:
        writer.write(asked)
        await answers(reader, 1)
        writer.write(BODY[len(asked) :] * (asked == BODY[:-4]) + GET * 100)
        return await rest(reader)

    assert talk(app, said, secure=secure, limits=replace(LIMITS, first_s=0.5)) == b""
    assert app.asked == 1


def test_a_stranger_is_read_again_after_a_while_and_who_is_known_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    app = Counting(3)

    async def said(reader: Any, writer: Any) -> None:
        writer.write(GET * 3)
        await answers(reader, 3)
        monkeypatch.setattr(connection, "STRANGERS", 1 / PATIENCE_S)
        writer.write(GET * 20)
        await answers(reader, 20)

    talk(app, said, secure=False)
    assert app.asked == 23


def test_a_stranger_who_goes_before_he_is_read_again_leaves_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Who comes, asks once and goes, as often as he can, must not fill the memory."""
    monkeypatch.setattr(connection, "STRANGERS", 1 / PATIENCE_S)
    made: list[Any] = []

    async def run() -> None:
        limits = replace(LIMITS, first_s=0.1)
        async with (
            asyncio.timeout(PATIENCE_S),
            opened(Counting(), secure=False, limits=limits, made=made) as (reader, writer),
        ):
            writer.write(GET)
            await rest(reader)
            for _ in range(10):
                await asyncio.sleep(0)
            gc.collect()
            assert [protocol() for protocol in made] == [None]

    asyncio.run(run())


def test_a_handshake_that_does_not_end_is_let_go() -> None:
    guest = HttpConnection(AdmissionControl(8), replace(LIMITS, first_s=0.1))

    async def run() -> bytes:
        context = read_context(*server_certificate(), client_certificates=False)
        loop = asyncio.get_running_loop()
        server = await loop.create_server(
            lambda: Secured(context, guest, asyncio.Protocol), "127.0.0.1", 0
        )
        async with server, asyncio.timeout(60):
            reader, writer = await asyncio.open_connection(*server.sockets[0].getsockname()[:2])
            found = await rest(reader)
            writer.close()
            return found

    assert asyncio.run(run()) == b""
