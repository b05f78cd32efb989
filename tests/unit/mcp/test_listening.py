# SPDX-License-Identifier: Apache-2.0
"""A port of this machine, for whoever knows the token, and for nobody else."""

from __future__ import annotations

import asyncio
from collections.abc import MutableMapping
from typing import Any

from authguard_r.integrations.mcp.http_front import guarded
from authguard_r.wire.json_log import Lines

TOKEN = b"a" * 40


def status(*shown: bytes, kind: str = "http") -> int | None:
    """Return the status of a request that shows these; None when the application was asked."""
    sent: list[MutableMapping[str, Any]] = []
    asked: list[str] = []

    async def app(scope: Any, receive: Any, send: Any) -> None:
        asked.append(scope["type"])

    async def send(message: MutableMapping[str, Any]) -> None:
        sent.append(message)

    async def receive() -> MutableMapping[str, Any]:
        return {}

    scope = {"type": kind, "headers": [(b"Authorization", value) for value in shown]}
    asyncio.run(guarded(app, TOKEN, Lines(2))(scope, receive, send))
    assert bool(asked) != bool(sent)
    return None if asked else int(sent[0]["status"])


def test_only_the_one_right_token_gets_through() -> None:
    right = b"Bearer " + TOKEN
    assert status(right) is None
    for wrong in ((), (TOKEN,), (b"bearer " + TOKEN,), (right[:-1],), (right, right), (b"",)):
        assert status(*wrong) == 401
    assert status(kind="lifespan") is None
    for kind in ("websocket", ""):
        assert status(right, kind=kind) == 401
