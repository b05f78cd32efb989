# SPDX-License-Identifier: Apache-2.0
"""The tools' server: one connection, made again when it is lost, held to what was pinned.

It is asked for tools and for nothing else. Its resources, prompts, completions, log lines and
notifications are dropped, and what it asks of a client (a model, a person, its files) is declined.
Spec page: docs/spec/mcp.md#upstream
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Coroutine
from contextlib import AbstractAsyncContextManager, suppress
from typing import Any, TypeVar

import anyio
import mcp_types as types
from mcp import Client, ClientSession, MCPError

from authguard_r.client.link import FIRST_PAUSE_S, LONGEST_PAUSE_S, ProcessLog
from authguard_r.core.errors import EnvironmentFault
from authguard_r.core.identifiers import Digest
from authguard_r.core.reasons import Reason
from authguard_r.integrations.mcp.answers import answer_from
from authguard_r.integrations.mcp.child import child
from authguard_r.integrations.mcp.pins import MAX_PINS, Pins, pins_of
from authguard_r.integrations.mcp.remote import remote
from authguard_r.integrations.tools.server import CallError, ToolAnswer

T = TypeVar("T")

#: A server that does not answer a ping within this is let go, in seconds.
PING_S = 5.0
#: How often it is asked whether it is there, in seconds.
LOOK_S = 2.0
#: A server has said who it is and what it has within this, in seconds.
OPEN_S = 20.0
_MOST_PAGES = 100


class Upstream:
    """The connection to the tools' server.

    Args:
        server: its command with arguments, or its URL.
        pins: what its tools have to be; None takes what it says at the first connection.
        environment: variables that it gets beside the usual ones.
        log: says once what happened.
        changed: called when it came or went.
    """

    def __init__(
        self,
        server: tuple[str, ...],
        *,
        pins: Pins | None,
        environment: dict[str, str],
        log: ProcessLog,
        changed: Callable[[], None],
    ) -> None:
        self.pins = pins
        self._server = server
        self._environment = environment
        self._log = log
        self._changed = changed
        self._client: Client | None = None
        self._calls = 0  # under way
        self._lost = asyncio.Event()

    @property
    def ready(self) -> bool:
        """True while it is connected and has the tools that were pinned."""
        return self._client is not None

    async def call(
        self,
        tool: str,
        arguments: dict[str, Any],
        within_s: float,
        *,
        ticket: Digest | None = None,
    ) -> ToolAnswer:
        """Return a tool's answer as a body reads it; arguments and errors as `ask`'s.

        A call that stops the robot has a session of its own, where the server is reached by a URL:
        a server may end the one in which a call runs, or is called off.
        """
        if ticket is None and _is_url(self._server):
            try:
                return answer_from(await self._apart(tool, arguments, within_s))
            except TimeoutError as error:
                raise CallError("no answer in time", sent=True) from error
            except (MCPError, OSError, ValueError, RuntimeError, ExceptionGroup) as error:
                self._log.say("no session of its own", "upstream", message=str(error)[:200])
        return answer_from(await self.ask(tool, arguments, within_s))

    async def _apart(
        self, tool: str, arguments: dict[str, Any], within_s: float
    ) -> types.CallToolResult:
        """Return a tool's answer in a session that is opened for this call.

        Raises:
            TimeoutError: no answer came.
        """
        answer = None
        try:
            with anyio.fail_after(within_s):
                async with Client(remote(self._server[0])) as client:
                    answer = await _called(client.session, tool, arguments)
        except (MCPError, OSError, ValueError, RuntimeError, ExceptionGroup):
            if answer is None:  # how the session ends is nothing to the stop
                raise
        if answer is None:  # pragma: no cover - the block above ends with one or raises
            raise TimeoutError
        return answer

    async def ask(
        self, tool: str, arguments: dict[str, Any], within_s: float
    ) -> types.CallToolResult:
        """Return a tool's answer as it came.

        Args:
            tool: its name, as the server spells it.
            arguments: rebuilt from what was authorized.
            within_s: longest time to wait.

        Raises:
            CallError: no answer came.
        """
        client = self._client
        if client is None:
            raise CallError("the tools' server is not there", sent=False)
        self._calls += 1
        try:
            return await _called(client.session, tool, arguments, within_s)
        except MCPError as error:
            if error.code in {types.REQUEST_TIMEOUT, types.CONNECTION_CLOSED}:
                self._lost.set()
                raise CallError(error.error.message, sent=True) from error
            if error.code == types.PARSE_ERROR:  # there was an answer, and it cannot be read
                raise CallError(error.error.message, sent=True) from error
            text = types.TextContent(type="text", text=f"{error.code}: {error.error.message}")
            return types.CallToolResult(content=[text], is_error=True)
        except (ValueError, OSError, RuntimeError) as error:
            raise CallError(type(error).__name__, sent=True) from error
        finally:
            self._calls -= 1

    async def stay(self) -> None:
        """Keep the connection until this is canceled; its server's process has ended then."""
        await ended_with_care(self._keep)

    async def _keep(self, starting: asyncio.Lock) -> None:
        pause = FIRST_PAUSE_S
        while True:
            try:
                was_open = await self._once(starting)
            except (MCPError, OSError, ValueError, RuntimeError, TimeoutError) as error:
                self._log.say("unreachable", "upstream", message=str(error) or type(error).__name__)
                was_open = False
            except ExceptionGroup as group:
                self._log.say("unreachable", "upstream", message=str(group.exceptions[0]))
                was_open = False
            finally:
                self._gone()
            pause = FIRST_PAUSE_S if was_open else min(pause * 2, LONGEST_PAUSE_S)
            await asyncio.sleep(pause)

    async def _once(self, starting: asyncio.Lock) -> bool:
        """Connect and stay while it lasts; return whether its tools were what was pinned."""
        self._lost.clear()
        with anyio.fail_after(OPEN_S) as opening:
            async with Client(self._transport(starting)) as client:
                found = pins_of(await _tools(client))
                opening.deadline = math.inf
                if self.pins is None:
                    self._log.say("unpinned", "pins", message="taken as it is: give --pins")
                    self.pins = found
                differing = self.pins.differ(found)
                if differing:
                    self._log.say("changed", "upstream", tools=", ".join(differing)[:200])
                    await asyncio.sleep(LONGEST_PAUSE_S)
                    return False
                self._client = client
                self._log.say("connected", "upstream")
                self._changed()
                await self._watch(client)
                return True

    async def _watch(self, client: Client) -> None:
        """Return when the server is gone, or does not say that it is there."""
        while not self._lost.is_set() and await self._is_there(client):
            with anyio.move_on_after(LOOK_S):
                await self._lost.wait()

    async def _is_there(self, client: Client) -> bool:
        """Ask a server that is idle; one that does a call may hear nothing until it is done.

        How long a call may take, its lease says; a connection that breaks ends it at once.
        """
        if self._calls:
            return True
        try:
            with anyio.fail_after(PING_S):
                await client.session.send_ping()
        except TimeoutError:
            return self._calls > 0  # one began meanwhile
        except (MCPError, OSError, RuntimeError, ValueError) as error:
            # else it is there, and has no ping
            return isinstance(error, MCPError) and error.code == types.METHOD_NOT_FOUND
        return True

    def _transport(self, starting: asyncio.Lock) -> AbstractAsyncContextManager[Any]:
        return _transport(self._server, self._environment, self._log, starting)

    def _gone(self) -> None:
        if self._client is not None:
            self._client = None
            self._log.say("disconnected", "upstream")
            self._changed()


async def ended_with_care(work: Callable[[asyncio.Lock], Coroutine[Any, Any, T]]) -> T:
    """Do what holds a server's process; when this is canceled, that process is gone first.

    The protocol's library ends a process that runs when a scope of anyio's is canceled, and may
    leave it behind when its task is; one that is half begun it leaves behind either way. So the
    task that is cancelled is not the one that holds it, and a start is waited for.

    Args:
        work: what to do; it holds the lock while it starts a process.
    """
    scope, starting = anyio.CancelScope(), asyncio.Lock()

    async def hold() -> T:
        with scope:
            return await work(starting)
        raise asyncio.CancelledError

    holding = asyncio.ensure_future(hold())
    try:
        return await asyncio.shield(holding)
    finally:
        while not holding.done():
            with suppress(asyncio.CancelledError):  # a second time would leave it behind too
                async with starting:
                    scope.cancel()
                await asyncio.wait((holding,))


async def listed(server: tuple[str, ...], environment: dict[str, str]) -> Pins:
    """Return what a server's tools are, asked once.

    Raises:
        EnvironmentFault: it does not answer, or not in the protocol.
    """

    async def ask(starting: asyncio.Lock) -> Pins:
        with anyio.fail_after(OPEN_S):
            async with Client(_transport(server, environment, ProcessLog(), starting)) as client:
                return pins_of(await _tools(client))

    try:
        return await ended_with_care(ask)
    except (MCPError, OSError, ValueError, RuntimeError, TimeoutError, ExceptionGroup) as error:
        raise EnvironmentFault(
            f"the tools' server does not answer: {error!s}"[:300],
            reason=Reason.CONTROLLER_FAILED,
            where=" ".join(server)[:200],
        ) from error


async def _tools(client: Client) -> list[types.Tool]:
    """Return every tool that the server lists.

    Raises:
        ValueError: its list does not end.
    """
    found: list[types.Tool] = []
    size = 0
    cursor: str | None = None
    for _ in range(_MOST_PAGES):
        page = await client.list_tools(cursor=cursor)
        found += page.tools
        size += sum(len(tool.model_dump_json()) for tool in page.tools)
        if size > MAX_PINS:
            raise ValueError("the list of tools is too long")
        cursor = page.next_cursor
        if cursor is None:
            return found
    raise ValueError("the list of tools does not end")


async def _called(
    session: ClientSession, tool: str, arguments: dict[str, Any], within_s: float | None = None
) -> types.CallToolResult:
    """Return a tool's answer as it came.

    Not by `call_tool`: it holds an answer to patterns that the server wrote, and one such pattern
    can take hours.
    """
    asked = types.CallToolRequestParams(name=tool, arguments=arguments)
    return await session.send_request(
        types.CallToolRequest(params=asked), types.CallToolResult, within_s
    )


def _transport(
    server: tuple[str, ...], environment: dict[str, str], log: ProcessLog, starting: asyncio.Lock
) -> AbstractAsyncContextManager[Any]:
    return remote(server[0]) if _is_url(server) else child(server, environment, log, starting)


def _is_url(server: tuple[str, ...]) -> bool:
    return len(server) == 1 and server[0].startswith(("http://", "https://"))
