# SPDX-License-Identifier: Apache-2.0
"""What is no message of the protocol has the protocol's error, and what is one has none.

Source: docs/spec/mcp.md#unreadable
"""

from __future__ import annotations

import asyncio
import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from authguard_r.integrations.http_listener.admission import AdmissionLimits
from authguard_r.integrations.mcp.unreadable import error_of, held_to_json, marked

PARSE, INVALID = -32_700, -32_600
DEEP = "[" * 300 + "]" * 300


def ping(number: str) -> str:
    return f'{{"jsonrpc": "2.0", "id": {number}, "method": "ping"}}'


@pytest.mark.parametrize(
    ("text", "code", "number"),
    [
        ("nothing of the kind", PARSE, None),
        ("[" * 100_000, PARSE, None),
        ("[]", INVALID, None),
        (f"[{ping('1')}, {ping('2')}]", INVALID, None),
        ("1", INVALID, None),
        (ping("null"), INVALID, None),
        (ping("1.5"), INVALID, None),
        (ping("true"), INVALID, None),
        (ping("1e400"), INVALID, None),
        (ping("[]"), INVALID, None),
        (f'{{"jsonrpc": "2.0", "id": 7, "method": "ping", "params": {DEEP}}}', INVALID, 7),
        ('{"jsonrpc": "2.0", "id": "a", "method": "\\ud800"}', INVALID, "a"),
        ('{"jsonrpc": "2.0", "id": "\\ud800", "method": "ping"}', INVALID, "\ud800"),
        ('{"jsonrpc": "1.0", "id": 3, "method": "ping"}', INVALID, 3),
        ('{"jsonrpc": "2.0", "id": 3}', INVALID, 3),
        ('{"jsonrpc": "2.0", "id": 3, "method": 4}', INVALID, 3),
    ],
)
def test_what_is_no_message_has_the_protocols_error(text: str, code: int, number: Any) -> None:
    error = error_of(text)
    assert error is not None
    said = json.loads(error)
    assert (said["error"]["code"], said["id"], said["jsonrpc"]) == (code, number, "2.0")


@pytest.mark.parametrize(
    "text",
    [
        ping("1"),
        ping('"a"'),
        ping("12345678901234567890123"),
        '{"jsonrpc": "2.0", "method": "notifications/initialized"}',
        '{"jsonrpc": "2.0", "id": 1, "result": {}}',
        '{"jsonrpc": "2.0", "id": null, "error": {"code": 1, "message": "x"}}',
    ],
)
def test_a_message_of_the_protocol_has_none(text: str) -> None:
    assert error_of(text) is None


@given(st.text() | st.binary().map(lambda data: data.decode(errors="replace")))
def test_no_text_breaks_the_reader(text: str) -> None:
    error_of(marked(text))


def answered(body: list[bytes], body_s: float = 10.0) -> tuple[list[Any], list[bytes]]:
    """Return what is sent for a body that comes in parts, and what the application was given."""
    sent: list[Any] = []
    given: list[bytes] = []

    async def app(scope: Any, receive: Any, send: Any) -> None:
        given.append((await receive())["body"])

    async def receive() -> Any:
        if not body:
            await asyncio.sleep(3_600)
        part = body.pop(0)
        return {"type": "http.request", "body": part, "more_body": part != b""}

    async def send(message: Any) -> None:
        sent.append(message)

    limits = AdmissionLimits(connections=1, body=1 << 16, body_s=body_s)
    asyncio.run(held_to_json(app, limits)({"type": "http", "method": "POST"}, receive, send))
    return sent, given


def test_over_http_it_is_told_with_400() -> None:
    start, body = answered([b"[", b"]", b""])[0]
    assert start["status"] == 400
    assert json.loads(body["body"])["error"]["code"] == INVALID
    assert answered([ping("1").encode(), b""]) == ([], [ping("1").encode()])


def test_a_body_that_broke_off_is_no_request() -> None:
    given: list[str] = []

    async def app(scope: Any, receive: Any, send: Any) -> None:
        given.append("asked")

    parts = [
        {"type": "http.request", "body": ping("1").encode(), "more_body": True},
        {"type": "http.disconnect"},
    ]

    async def receive() -> Any:
        return parts.pop(0)

    limits = AdmissionLimits(connections=1, body=1 << 16)
    asyncio.run(held_to_json(app, limits)({"type": "http", "method": "POST"}, receive, receive))
    assert given == []


def test_a_body_that_does_not_end_is_told_with_408() -> None:
    (start, _), given = answered([b"{"], body_s=0.05)
    assert (start["status"], given) == (408, [])
    assert (b"connection", b"close") in start["headers"]
