# SPDX-License-Identifier: Apache-2.0
"""The front over streamable HTTP, on loopback, for whoever knows the token.

Spec page: docs/spec/mcp.md#http
"""

from __future__ import annotations

import socket

import uvicorn

from authguard_r.listening import (
    END_S,
    App,
    Receive,
    Scope,
    Send,
    listening,
    read_bearer,
    serve_until_told,
    shows,
)
from authguard_r.mcp.front import Front
from authguard_r.mcp.unreadable import held_to_json

__all__ = ["guarded", "listening", "read_bearer", "serve_http"]

#: Where clients go.
PATH = "/mcp"
#: Longest request, in bytes.
MAX_REQUEST = 1 << 20
#: Sessions at a time, and how long one that says nothing is kept, in seconds.
SESSIONS, IDLE_S = 64, 1_800.0


def guarded(app: App, token: bytes) -> App:
    """Return the application for those who show the token; anybody else has 401 and no more."""

    async def serve(scope: Scope, receive: Receive, send: Send) -> None:
        kind = scope["type"]
        if kind == "lifespan" or (kind == "http" and shows(scope["headers"], token)):
            await app(scope, receive, send)
            return
        headers = [(b"www-authenticate", b"Bearer"), (b"content-length", b"0")]
        await send({"type": "http.response.start", "status": 401, "headers": headers})
        await send({"type": "http.response.body", "body": b""})

    return serve


async def serve_http(front: Front, made: socket.socket, token: bytes) -> None:
    """Serve until SIGTERM or SIGINT."""
    app = front.server.streamable_http_app(
        streamable_http_path=PATH,
        max_request_body_size=MAX_REQUEST,
        session_idle_timeout=IDLE_S,
        max_sessions=SESSIONS,
    )
    config = uvicorn.Config(
        guarded(held_to_json(app, MAX_REQUEST), token),
        log_level="warning",
        lifespan="on",
        ws="none",
        timeout_graceful_shutdown=END_S,
    )
    await serve_until_told(config, made)
