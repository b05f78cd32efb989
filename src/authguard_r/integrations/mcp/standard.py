# SPDX-License-Identifier: Apache-2.0
"""Standard input and output as the protocol's stream, without a thread between.

The protocol's own library reads and writes files by worker threads, which takes three switches a
call; pipes and sockets need none. While the stream is held, other code of this process that reads
or prints finds no input and goes to standard error. Spec page: docs/spec/mcp.md#front
"""

from __future__ import annotations

import asyncio
import os
import stat
from asyncio.streams import FlowControlMixin
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress
from typing import Any, Protocol

import anyio
from mcp.server.stdio import stdio_server

from authguard_r.integrations.mcp.unreadable import error_of, marked

#: Longest message of a client, in bytes; the rest of a longer one is not kept.
MAX_MESSAGE = 4 << 20


class _Answers(Protocol):
    """Where lines for the client go."""

    async def write(self, text: str, /) -> object:
        """Send it."""
        ...

    async def flush(self) -> None:
        """Wait while the client does not read."""
        ...


class _Printed:
    """The output to a client (`anyio.AsyncFile`, as far as it is written)."""

    def __init__(self, writer: asyncio.StreamWriter) -> None:
        self._writer = writer

    async def write(self, text: str) -> None:
        """Send it, when the client has read enough of what came before."""
        self._writer.write(text.encode())

    async def flush(self) -> None:
        """Wait while the client does not read; one that is gone will say no more either."""
        with suppress(OSError):
            await self._writer.drain()


class _Lines:
    """What a client says, message by message (`anyio.AsyncFile`, as far as it is read).

    What is no message is answered here.

    Args:
        reader: brings lines.
        printed: where the client is answered.
    """

    def __init__(
        self, reader: asyncio.StreamReader | anyio.AsyncFile[bytes], printed: _Answers
    ) -> None:
        self._reader = reader
        self._printed = printed

    def __aiter__(self) -> _Lines:
        return self

    async def __anext__(self) -> str:
        while line := await self._line():
            text = marked(line.decode(errors="replace"))
            if text.isspace():
                continue
            error = error_of(text)
            if error is None:
                return text
            await self._printed.write(error.decode() + "\n")
            await self._printed.flush()
        raise StopAsyncIteration

    async def _line(self) -> bytes:
        """Return the next line, and of one that is too long its end, which is no message."""
        if not isinstance(self._reader, asyncio.StreamReader):
            return await self._reader.readline()
        is_cut = False
        while True:
            try:
                line = await self._reader.readuntil(b"\n")
            except asyncio.IncompleteReadError as error:
                line = error.partial
            except asyncio.LimitOverrunError as error:
                await self._reader.readexactly(error.consumed)
                is_cut = True
                continue
            return b"too long\n" if is_cut else line


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
        printed = _Printed(asyncio.StreamWriter(outgoing, mixin, None, loop))
        yield _Lines(reader, printed), printed
    finally:
        incoming.close()
        outgoing.close()


@asynccontextmanager
async def _opened(source: int, sink: int) -> AsyncIterator[tuple[Any, Any]]:
    """Yield both ends of files and terminals, which are read and written by worker threads."""
    with os.fdopen(os.dup(source), "rb") as incoming, os.fdopen(os.dup(sink), "w") as outgoing:
        printed = anyio.wrap_file(outgoing)
        yield _Lines(anyio.wrap_file(incoming), printed), printed
