# SPDX-License-Identifier: Apache-2.0
"""When one session too many begins, the idlest ends, and nobody who waits for an answer.

Source: docs/spec/mcp.md#http
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

from authguard_r.integrations.mcp.sessions import Sessions

NAME = b"mcp-session-id"


class Library:
    """The protocol's application, as far as sessions go."""

    def __init__(self) -> None:
        self.ended: list[str] = []
        self.ended_with: dict[bytes, bytes] = {}
        self.goes_on = asyncio.Event()
        self._last = 0

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        headers = dict(scope["headers"])
        name = headers.get(NAME, b"").decode()
        if scope["method"] == "DELETE":
            self.ended_with = headers
            assert (await receive())["body"] == b""
            self.ended.append(name)
        if headers.get(b"slow"):
            await self.goes_on.wait()
        status = 404 if name in self.ended and scope["method"] != "DELETE" else 200
        begun = []
        if not name:
            self._last += 1
            begun = [(NAME, str(self._last).encode())]
        await send({"type": "http.response.start", "status": status, "headers": begun})
        await send({"type": "http.response.body", "body": b""})


def talk(said: Callable[[Library, Callable[..., Awaitable[int]]], Awaitable[None]]) -> None:
    async def run() -> None:
        library = Library()
        sessions = Sessions(library, 3)

        async def ask(name: str = "", method: str = "POST", *, slow: bool = False) -> int:
            found: list[int] = []

            async def send(message: Any) -> None:
                found.append(message.get("status", 0))

            async def receive() -> Any:
                return {"type": "http.request", "body": b"", "more_body": False}

            headers = [(b"content-length", b"2")]
            headers += [(NAME, name.encode())] if name else []
            headers += [(b"slow", b"1")] if slow else []
            await sessions({"type": "http", "method": method, "headers": headers}, receive, send)
            return found[0]

        async with asyncio.timeout(10):
            await said(library, ask)

    asyncio.run(run())


def test_the_idlest_session_ends_when_one_too_many_begins() -> None:
    async def said(library: Library, ask: Any) -> None:
        for _ in range(3):
            await ask()
        await ask("1")  # now the second is the idlest
        await ask()
        assert library.ended == ["2"]
        assert b"content-length" not in library.ended_with
        assert [await ask(name) for name in ("1", "2", "3", "4")] == [200, 404, 200, 200]

    talk(said)


def test_a_flood_of_sessions_ends_nobody_who_waits_for_an_answer() -> None:
    async def said(library: Library, ask: Any) -> None:
        await ask()
        waits = asyncio.ensure_future(ask("1", slow=True))
        listens = asyncio.ensure_future(ask("1", "GET", slow=True))
        await asyncio.sleep(0)
        for _ in range(20):
            await ask()
        assert "1" not in library.ended
        library.goes_on.set()
        assert await asyncio.gather(waits, listens) == [200, 200]
        for _ in range(3):
            await ask()
        assert "1" in library.ended

    talk(said)


def test_when_all_wait_for_answers_nobody_ends() -> None:
    async def said(library: Library, ask: Any) -> None:
        for _ in range(3):
            await ask()
        waits = [asyncio.ensure_future(ask(name, slow=True)) for name in ("1", "2", "3")]
        await asyncio.sleep(0)
        await ask()
        assert library.ended == []
        library.goes_on.set()
        await asyncio.gather(*waits)

    talk(said)


def test_a_session_that_its_client_ended_takes_no_place() -> None:
    async def said(library: Library, ask: Any) -> None:
        for _ in range(3):
            await ask()
        await ask("2", "DELETE")
        await ask()
        assert library.ended == ["2"]

    talk(said)
