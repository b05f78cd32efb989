# SPDX-License-Identifier: Apache-2.0
"""Sessions over HTTP: when one too many begins, the idlest ends.

The protocol's library refuses a new one for as long as the others last, which is half an hour.
Spec page: docs/spec/mcp.md#http
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import Any

from authguard_r.integrations.http_listener.access import App, Receive, Scope, Send

#: Sessions at a time, and how long one that says nothing is kept, in seconds.
SESSIONS, IDLE_S = 64, 1_800.0
_SESSION = b"mcp-session-id"
#: Headers of the body of the request that began a session.
_BODY = frozenset({b"content-type", b"content-length", b"transfer-encoding"})


class Sessions:
    """Stands before the protocol's application and ends sessions.

    Args:
        app: it says of each session in the answer that begins it what its name is.
        most: so many at a time.
    """

    def __init__(self, app: App, most: int = SESSIONS) -> None:
        self._app = app
        self._most = most
        self._known: dict[bytes, None] = {}  # who asked last comes last
        self._asking: Counter[bytes] = Counter()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, and note whose it is."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        name = _name_in(scope["headers"])
        # a stream that is listened to asks nothing
        asks = scope["method"] == "POST" and name in self._known

        async def noted(message: Any) -> None:
            if message["type"] == "http.response.start":
                await self._noted(scope, name, message)
            await send(message)

        self._asking[name] += asks
        self._touch(name)
        try:
            await self._app(scope, receive, noted)
        finally:
            self._asking[name] -= asks
            self._asking += Counter()  # without those who ask nothing
            self._touch(name)

    def _touch(self, name: bytes) -> None:
        if self._known.pop(name, self) is None:
            self._known[name] = None

    async def _noted(self, scope: Scope, name: bytes, message: Any) -> None:
        status, begun = message["status"], _name_in(message["headers"])
        if status == 404 or (scope["method"] == "DELETE" and status < 400):
            self._known.pop(name, None)
        elif not name and begun and status < 400:
            self._known[begun] = None
            while len(self._known) > self._most:
                idle = [one for one in self._known if not self._asking[one] and one != begun]
                if not idle:
                    return  # the library's own limit is twice as high
                del self._known[idle[0]]
                await self._end(scope, idle[0])

    async def _end(self, scope: Scope, name: bytes) -> None:
        """End a session as its client would."""
        headers = [item for item in scope["headers"] if item[0] not in _BODY]

        async def receive() -> Any:
            return {"type": "http.request", "body": b"", "more_body": False}

        async def ignore(message: Any) -> None:
            """Its client has left."""

        ending = {**scope, "method": "DELETE", "headers": [*headers, (_SESSION, name)]}
        await self._app(ending, receive, ignore)


def _name_in(headers: Iterable[tuple[bytes, bytes]]) -> bytes:
    return next((value for name, value in headers if name.lower() == _SESSION), b"")
