# SPDX-License-Identifier: Apache-2.0
"""A tools' server that is a process of ours: its lines as messages, each no longer than it may be.

The protocol's own library keeps a line until it ends, however long it gets, and logs each one that
is no message. Spec page: docs/spec/mcp.md#upstream
"""

from __future__ import annotations

import asyncio
import json
import os
import signal
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from typing import Any

import anyio
import mcp_types as types
from mcp.client.stdio import get_default_environment
from mcp.shared.message import SessionMessage

from authguard_r.client.link import ProcessLog

#: Longest message of a tools' server, in bytes.
MAX_MESSAGE = 4 << 20
#: A server ends by itself within this once its input has ended, in seconds; then it gets a signal
#: to end, and after the same time it is killed.
END_S = 2.0
_LOOK_S = 0.01
#: How it shows that its input and output are closed.
_ENDS = (
    anyio.BrokenResourceError,
    anyio.ClosedResourceError,
    asyncio.IncompleteReadError,
    ConnectionError,
)


@asynccontextmanager
async def child(
    command: tuple[str, ...], environment: dict[str, str], log: ProcessLog, starting: asyncio.Lock
) -> AsyncIterator[Any]:
    """Start a server's process, yield the streams of its messages, and end it.

    Args:
        command: its command with arguments.
        environment: variables that it gets beside the usual ones.
        log: says that a line was cut.
        starting: held while the process starts.

    Raises:
        OSError: it does not start.
        ValueError: no process can have such a command.
    """
    async with starting:
        process = await asyncio.create_subprocess_exec(
            *command,
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            env=get_default_environment() | environment,
            start_new_session=True,
            limit=MAX_MESSAGE,
        )
    heard, hears = anyio.create_memory_object_stream[SessionMessage | Exception](0)
    says, said = anyio.create_memory_object_stream[SessionMessage](0)
    try:
        async with anyio.create_task_group() as group:
            group.start_soon(_hear, process, heard, log)
            group.start_soon(_say, process, said, heard)
            try:
                yield hears, says
            finally:
                with anyio.CancelScope(shield=True):
                    await _end(process)
                group.cancel_scope.cancel()
    finally:
        for stream in (heard, hears, says, said):
            stream.close()


async def _hear(process: asyncio.subprocess.Process, heard: Any, log: ProcessLog) -> None:
    """Hand on what it says until it ends, or says something too long."""
    source = process.stdout
    async with heard:
        with suppress(*_ENDS):
            while source is not None:
                try:
                    line = await source.readuntil(b"\n")
                except asyncio.LimitOverrunError:
                    log.say("cut", "upstream", message=f"a line of more than {MAX_MESSAGE} bytes")
                    return
                await heard.send(_message(line))


def _message(line: bytes) -> SessionMessage | Exception:
    try:
        return SessionMessage(types.jsonrpc_message_adapter.validate_json(line, by_name=False))
    except ValueError as error:
        number = _answered(line)
        if number is None:
            return error
        why = types.ErrorData(code=types.PARSE_ERROR, message="the answer is malformed")
        return SessionMessage(types.JSONRPCError(jsonrpc="2.0", id=number, error=why))


def _answered(line: bytes) -> str | int | None:
    """Return which request is answered by what is no message, for it will have no other answer."""
    try:
        said = json.loads(line)
    except (ValueError, RecursionError):
        return None
    number = said.get("id") if isinstance(said, dict) and "method" not in said else None
    return number if isinstance(number, str | int) and not isinstance(number, bool) else None


async def _say(process: asyncio.subprocess.Process, said: Any, heard: Any) -> None:
    """Send it a message; a server that does not read is gone."""
    sink = process.stdin
    async with said:
        try:
            async for item in said:
                text = item.message.model_dump_json(by_alias=True, exclude_unset=True)
                if sink is not None:
                    sink.write(text.encode() + b"\n")
                    await sink.drain()
        except OSError:
            heard.close()


async def _end(process: asyncio.subprocess.Process) -> None:
    """Close its input, wait, and end what is left of it: itself and what it started."""
    if process.stdin is not None:
        process.stdin.close()
    for number in (signal.SIGTERM, signal.SIGKILL):
        with anyio.move_on_after(END_S):
            while process.returncode is None:
                await asyncio.sleep(_LOOK_S)
        if process.returncode is None:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, number)
    with anyio.move_on_after(END_S):
        while process.returncode is None:
            await asyncio.sleep(_LOOK_S)
    # a process that it left behind may hold its output open: nothing public lets go of that
    process._transport.close()  # type: ignore[attr-defined]  # noqa: SLF001
