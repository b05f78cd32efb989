# SPDX-License-Identifier: Apache-2.0
"""What a client sends that is no message of the protocol, or a call that is no strict JSON.

The protocol's library would take the last of two equal keys, and leaves some requests without an
answer. The text of a call that is no strict JSON is kept, so that the gate refuses it and logs it,
as from any other front. Spec page: docs/spec/mcp.md#unreadable
"""

from __future__ import annotations

import asyncio
import json
from typing import Any

import mcp_types as types

from authguard_r.core.errors import MalformedError
from authguard_r.integrations.http_listener.access import App, Receive, Scope, Send
from authguard_r.integrations.http_listener.admission import AdmissionLimits
from authguard_r.normalize.parse import read_json

#: The one argument of a call that could not be read: its text. Who sends it is refused.
UNREADABLE = "authguard-r/unreadable"
#: Characters of it that are kept.
_MOST = 4_096


def marked(text: str) -> str:
    """Return a message as it came; a call that is no strict JSON with its text as its argument."""
    try:
        read_json(text, where="message")
    except MalformedError as error:
        return _marked(text, str(error))
    return text


def _marked(text: str, why: str) -> str:
    try:
        message: Any = json.loads(text)
    except (ValueError, RecursionError):
        return text  # the library refuses it
    called = message.get("params") if isinstance(message, dict) else None
    if not isinstance(called, dict) or message.get("method") != "tools/call":
        return text  # it asks for nothing that has an effect
    kept = f"{why}: {text}"[:_MOST]
    called = {"name": called.get("name"), "arguments": {UNREADABLE: kept}}
    return json.dumps({**message, "params": called}, allow_nan=True) + "\n"


def error_of(text: str) -> bytes | None:
    """Return the protocol's error for a text that is no message of it; None: it is one."""
    try:
        message: Any = json.loads(text)
    except (ValueError, RecursionError):
        return _error(None, types.PARSE_ERROR, "expected JSON")
    if not isinstance(message, dict):
        return _error(None, types.INVALID_REQUEST, "expected one message")
    number = message.get("id")
    if isinstance(number, bool) or not isinstance(number, str | int):
        if "id" in message and "method" in message:  # it would be taken for a notification
            text = "expected text or a whole number as `id`"
            return _error(None, types.INVALID_REQUEST, text)
        number = None
    try:
        types.jsonrpc_message_adapter.validate_json(text, by_name=False)
    except ValueError:
        return _error(number, types.INVALID_REQUEST, "expected a message of the protocol")
    return None


def _error(number: str | int | None, code: int, why: str) -> bytes:
    said = {"jsonrpc": "2.0", "id": number, "error": {"code": code, "message": why}}
    return json.dumps(said).encode()


def held_to_json(app: App, limits: AdmissionLimits) -> App:
    """Return the application with each request's body held to strict JSON.

    Args:
        app: the protocol's; it refuses what is longer than it may be.
        limits: how long a body may be, and how long it may take.
    """

    async def serve(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or scope["method"] != "POST":
            await app(scope, receive, send)
            return
        body, more = b"", True
        try:
            async with asyncio.timeout(limits.body_s):
                while more and len(body) <= limits.body:
                    event = await receive()
                    if event["type"] == "http.disconnect":
                        return  # what has come is not what was meant
                    more = event.get("more_body", False)
                    body += event.get("body", b"")
        except TimeoutError:
            await _answer(send, 408, _error(None, types.INVALID_REQUEST, "expected a whole body"))
            return
        if not more:
            text = marked(body.decode(errors="replace"))
            error = error_of(text)
            if error is not None:
                await _answer(send, 400, error)
                return
            body = text.encode()
        first = [{"type": "http.request", "body": body, "more_body": more}]

        async def once() -> Any:
            return first.pop() if first else await receive()

        await app(scope, once, send)

    return serve


async def _answer(send: Send, status: int, body: bytes) -> None:
    headers = [(b"content-type", b"application/json"), (b"content-length", b"%d" % len(body))]
    if status == 408:
        headers.append((b"connection", b"close"))
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": body})
