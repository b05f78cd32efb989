# SPDX-License-Identifier: Apache-2.0
"""The gateway's process: a front for the planner's client, a driver for the tools' server.

The two ends meet in the gate alone: nothing that a client says reaches the server but as an action
that the gate has released. Spec page: docs/spec/mcp.md
"""

from __future__ import annotations

import logging
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any

from mcp_types import CallToolResult, Tool
from msgspec import field

from authguard_r.client.link import ProcessLog
from authguard_r.core.errors import AuthGuardError
from authguard_r.integrations.mcp.front import Front, beside_tools, refused, shown, tools_of
from authguard_r.integrations.mcp.pins import Pins
from authguard_r.integrations.mcp.standard import standard_streams
from authguard_r.integrations.mcp.upstream import Upstream
from authguard_r.integrations.tools.body import LONGEST_S
from authguard_r.integrations.tools.endpoints import Ends, GateTarget, first_of
from authguard_r.integrations.tools.server import CallError


class GatewaySetup(GateTarget, frozen=True, kw_only=True):
    """The options of a gateway.

    Args:
        server: the tools' server: a command with arguments, or a URL.
        environment: variables for that command.
        pins: what its tools have to be; None: what it says at first.
    """

    server: tuple[str, ...]
    environment: dict[str, str] = field(default_factory=dict)
    pins: Pins | None = None
    client: str = "mcp"


class Gateway:
    """Both ends of one gateway.

    Args:
        setup: its options.
    """

    def __init__(self, setup: GatewaySetup) -> None:
        self._setup = setup
        log = ProcessLog()
        self.upstream = Upstream(
            setup.server,
            pins=setup.pins,
            environment=setup.environment,
            log=log,
            changed=self._look,
        )
        self._ends = Ends(setup, self.upstream, log)
        self.front = Front(
            self._ends.planner,
            (self._ends.aside, beside_tools(setup.binding, setup.site)),
            self._tools,
            self._ends.call_of,
            self._unguarded if setup.shadow else None,
        )

    @asynccontextmanager
    async def running(self) -> AsyncIterator[Front]:
        """Drive the tools' server; the front is served inside.

        Raises:
            EnvironmentFault: gate or server did not come.
        """
        where = " ".join(self._setup.server)
        async with self._ends.running(self.upstream.stay(), where=where):
            yield self.front

    async def _unguarded(self, tool: str, arguments: dict[str, Any]) -> CallToolResult:
        try:
            return await self.upstream.ask(tool, arguments, LONGEST_S)
        except CallError as error:
            return refused({"outcome": "accept", "execution": "unknown"}, error.message)

    def _tools(self) -> list[Tool]:
        pins = self.upstream.pins
        if pins is None or self._setup.shadow:
            return [] if pins is None else tools_of(pins)
        return shown(pins, self._setup.binding, self._setup.site)

    def _look(self) -> None:
        self._ends.look()


async def serve(setup: GatewaySetup, front_of: Callable[[Front], Awaitable[None]]) -> None:
    """Run a gateway while its front is served.

    Args:
        setup: its options.
        front_of: serves the front until it is over.

    Raises:
        EnvironmentFault: gate or server did not come.
    """
    # the protocol's library writes a line for each thing that it does not like in a server's answer
    logging.getLogger("mcp").setLevel(logging.CRITICAL)
    try:
        async with Gateway(setup).running() as front:
            await front_of(front)
    except BaseExceptionGroup as group:
        first = first_of(group)
        if isinstance(first, AuthGuardError):
            raise first from None
        raise


async def over_stdio(front: Front) -> None:
    """Serve one client over standard input and output until it goes."""
    async with standard_streams() as (read, write):
        await front.server.run(read, write, front.server.create_initialization_options())
