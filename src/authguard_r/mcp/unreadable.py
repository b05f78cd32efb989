# SPDX-License-Identifier: Apache-2.0
"""Calls that are no strict JSON: the protocol's library would take the last of two equal keys.

The text of such a call is kept, so that the gate refuses it and logs it, as from any other front.
Spec page: docs/spec/mcp.md#unreadable
"""

from __future__ import annotations

import json
from typing import Any

from authguard_r.core.errors import MalformedError
from authguard_r.listening import App, Receive, Scope, Send
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


def held_to_json(app: App, most: int) -> App:
    """Return the application with each request's body held to strict JSON.

    Args:
        app: the protocol's; it refuses what is longer than it may be.
        most: longest body that is looked at, in bytes.
    """

    async def serve(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or scope["method"] != "POST":
            await app(scope, receive, send)
            return
        body, more = b"", True
        while more and len(body) <= most:
            event = await receive()
            more = event["type"] == "http.request" and event.get("more_body", False)
            body += event.get("body", b"")
        if not more:
            body = marked(body.decode(errors="replace")).encode()
        first = [{"type": "http.request", "body": body, "more_body": more}]

        async def once() -> Any:
            return first.pop() if first else await receive()

        await app(scope, once, send)

    return serve
