# SPDX-License-Identifier: Apache-2.0
"""Standard input and output as the protocol's stream, without a thread between.

The protocol's own library reads and writes files by worker threads, which takes three switches a
call; pipes and sockets need none. While the stream is held, whatever else reads or prints in this
process finds no input and goes to standard error. Spec page: docs/spec/mcp.md#front
"""

from __future__ import annotations

import asyncio
import os
import stat
import sys
from asyncio.streams import FlowControlMixin
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress
from typing import Any

import anyio
from mcp.server.stdio import stdio_server

from authguard_r.mcp.unreadable import marked

#: Longest message of a client, in bytes; it is let go after a longer one.
MAX_MESSAGE = 4 << 20


class _Lines:
    """What a client says, line by line (`anyio.AsyncFile`, as far as it is read)."""

    def __init__(self, reader: asyncio.StreamReader | anyio.AsyncFile[bytes]) -> None:
        self._reader = reader

    def __aiter__(self) -> _Lines:
        return self

    async def __anext__(self) -> str:
        try:
            line = await self._reader.readline()
        except ValueError:  # longer than may be
            sys.stderr.write(f"a message of more than {MAX_MESSAGE} bytes came: it ends here\n")
            raise StopAsyncIteration from None
        if not line:
            raise StopAsyncIteration
        return marked(line.decode(errors="replace"))


class _Printed:
    """What a client is told (`anyio.AsyncFile`, as far as it is written)."""

    def __init__(self, writer: asyncio.StreamWriter) -> None:
        self._writer = writer

    async def write(self, text: str) -> None:
        """Send it, when the client has read enough of what came before."""
        self._writer.write(text.encode())

    async def flush(self) -> None:
        """Wait while the client does not read; one that is gone will say no more either."""
        with suppress(OSError):
            await self._writer.drain()


@asynccontextmanager
async def standard_streams() -> AsyncIterator[tuple[Any, Any]]:
    """Yield the two streams of messages of this process's one client."""
    flows = _flows(0) and _flows(1)
    with _held() as (source, sink):
        connected = _connected(source, sink) if flows else _opened(source, sink)
        async with connected as ends, stdio_server(*ends) as streams:
            yield streams


def _flows(number: int) -> bool:
    mode = os.fstat(number).st_mode
    return stat.S_ISFIFO(mode) or stat.S_ISSOCK(mode)


@contextmanager
def _held() -> Iterator[tuple[int, int]]:
    """Yield standard input and output under other numbers; theirs lead elsewhere meanwhile."""
    kept = os.dup(0), os.dup(1)
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.dup2(2, 1)
    os.close(nothing)
    try:
        yield kept
    finally:
        for number, own in enumerate(kept):
            os.set_blocking(own, True)
            os.dup2(own, number)
            os.close(own)


@asynccontextmanager
async def _connected(source: int, sink: int) -> AsyncIterator[tuple[Any, Any]]:
    """Yield both ends."""
    loop = asyncio.get_running_loop()
    reader = asyncio.StreamReader(limit=MAX_MESSAGE)
    protocol = asyncio.StreamReaderProtocol(reader)
    incoming, _ = await loop.connect_read_pipe(lambda: protocol, os.fdopen(os.dup(source), "rb"))
    outgoing, mixin = await loop.connect_write_pipe(FlowControlMixin, os.fdopen(os.dup(sink), "wb"))
    try:
        yield _Lines(reader), _Printed(asyncio.StreamWriter(outgoing, mixin, None, loop))
    finally:
        incoming.close()
        outgoing.close()


@asynccontextmanager
async def _opened(source: int, sink: int) -> AsyncIterator[tuple[Any, Any]]:
    """Yield both ends of files and terminals, which are read and written by worker threads."""
    with os.fdopen(os.dup(source), "rb") as incoming, os.fdopen(os.dup(sink), "w") as outgoing:
        yield _Lines(anyio.wrap_file(incoming)), anyio.wrap_file(outgoing)
