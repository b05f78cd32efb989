# SPDX-License-Identifier: Apache-2.0
"""A tools' server behind a URL: no answer of it is longer than it may be.

Spec page: docs/spec/mcp.md#upstream
"""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import httpx2
from mcp.client.streamable_http import streamable_http_client

from authguard_r.integrations.mcp.child import MAX_MESSAGE

_EVENTS = "text/event-stream"
#: As the library's own: a server may hold a stream open for long.
_PATIENCE = httpx2.Timeout(30.0, read=300.0)


@asynccontextmanager
async def remote(url: str) -> AsyncIterator[Any]:
    """Yield the streams of a server's messages."""
    # unpacked, a short answer could be as long as it likes
    plain = {"accept-encoding": "identity"}
    async with httpx2.AsyncClient(headers=plain, timeout=_PATIENCE) as client:
        client.event_hooks = {"response": [_bound]}
        made = streamable_http_client(url, http_client=client, max_sse_event_size=MAX_MESSAGE)
        async with made as streams:
            yield streams


async def _bound(response: httpx2.Response) -> None:
    """Have a body fail as soon as it is too long; of a stream of events, the library bounds each.

    Raises:
        httpx2.ReadError: it is packed.
    """
    if response.headers.get("content-encoding", "identity") != "identity":
        raise httpx2.ReadError("the answer is packed", request=response.request)
    stream = response.stream
    is_endless = response.headers.get("content-type", "").startswith(_EVENTS)
    if not is_endless and isinstance(stream, httpx2.AsyncByteStream):
        response.stream = _Bounded(stream)


class _Bounded(httpx2.AsyncByteStream):
    """A body that fails beyond `MAX_MESSAGE` bytes.

    Args:
        stream: the body.
    """

    def __init__(self, stream: httpx2.AsyncByteStream) -> None:
        self._stream = stream

    async def __aiter__(self) -> AsyncIterator[bytes]:
        taken = 0
        async for part in self._stream:
            taken += len(part)
            if taken > MAX_MESSAGE:
                raise httpx2.ReadError(f"the answer has more than {MAX_MESSAGE} bytes")
            yield part

    async def aclose(self) -> None:
        """Let go of the connection."""
        await self._stream.aclose()
