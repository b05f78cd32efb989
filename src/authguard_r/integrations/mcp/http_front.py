# SPDX-License-Identifier: Apache-2.0
"""The front over streamable HTTP, on loopback, for clients that know the token.

Spec page: docs/spec/mcp.md#http
"""

from __future__ import annotations

import socket
from collections.abc import MutableMapping, Sequence
from typing import Any

from authguard_r.integrations.http_listener.access import App, Receive, Scope, Send, shows
from authguard_r.integrations.http_listener.admission import AdmissionLimits
from authguard_r.integrations.http_listener.connection import let_in
from authguard_r.integrations.http_listener.server import serve_until_signal
from authguard_r.integrations.mcp.front import Front
from authguard_r.integrations.mcp.sessions import IDLE_S, SESSIONS, Sessions
from authguard_r.integrations.mcp.unreadable import held_to_json
from authguard_r.wire.json_log import Lines

#: Where clients go.
PATH = "/mcp"
#: Of `authguard mcp --listen`.
LIMITS = AdmissionLimits(connections=256, body=1 << 20)


def guarded(app: App, token: bytes, lines: Lines) -> App:
    """Return the application for clients that show the token; every other client gets 401.

    Args:
        app: answers them.
        token: what they show.
        lines: the log: who was refused, and a fault of ours.
    """

    async def serve(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await app(scope, receive, send)
        elif scope["type"] == "http" and shows(scope["headers"], token):
            let_in(scope)
            await _answered(app, scope, receive, send, lines)
        else:
            lines.write({"event": "refused", "status": 401}, kind="refused")
            await _answer(send, 401, [(b"www-authenticate", b"Bearer")])

    return serve


async def _answered(app: App, scope: Scope, receive: Receive, send: Send, lines: Lines) -> None:
    has_begun = False

    async def noted(message: MutableMapping[str, Any]) -> None:
        nonlocal has_begun
        has_begun = True
        await send(message)

    try:
        await app(scope, receive, noted)
    except Exception as error:
        lines.write({"event": "fault", "what": type(error).__name__})
        if has_begun:
            raise  # the connection ends
        await _answer(send, 500)


async def _answer(send: Send, status: int, more: Sequence[tuple[bytes, bytes]] = ()) -> None:
    headers = [*more, (b"content-length", b"0")]
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": b""})


async def serve_http(front: Front, made: socket.socket, token: bytes) -> None:
    """Serve until SIGTERM or SIGINT.

    Raises:
        EnvironmentFault: the process may not open files enough.
    """
    lines = Lines(most=LIMITS.lines)
    app = front.server.streamable_http_app(
        streamable_http_path=PATH,
        max_request_body_size=LIMITS.body,
        session_idle_timeout=IDLE_S,
        max_sessions=2 * SESSIONS,
    )
    judged = held_to_json(Sessions(app), LIMITS)
    await serve_until_signal(guarded(judged, token, lines), made, LIMITS, lines, has_lifespan=True)
