# SPDX-License-Identifier: Apache-2.0
"""A process with both ends of a gate: one proposes calls, the other makes the released ones.

The two meet in the gate alone: nothing that is asked for is called but as an action that the gate
has released. Spec page: docs/spec/adapters.md#ends
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager
from pathlib import Path

from msgspec import Struct

from authguard_r.client.driver import Driver
from authguard_r.client.handshake import GateVerifier
from authguard_r.client.link import ProcessLog, require_folder
from authguard_r.client.reconnecting import GatePlace
from authguard_r.core.errors import EnvironmentFault
from authguard_r.core.identifiers import RobotId
from authguard_r.core.reasons import Reason
from authguard_r.integrations.tools.body import Rebuilds, ToolBody, ToolDrivers
from authguard_r.integrations.tools.files import words_of
from authguard_r.integrations.tools.planner import ToolPlanner
from authguard_r.integrations.tools.server import ToolServer
from authguard_r.normalize import Binder
from authguard_r.normalize.binding import Binding
from authguard_r.normalize.dialects import Call
from authguard_r.normalize.rebuild import Rebuilder
from authguard_r.site.model import Site
from authguard_r.wire.messages import Mode

#: A gate and a server that are there are connected within this, in seconds.
START_S = 30.0


class GateTarget(Struct, frozen=True, kw_only=True):
    """Which robot and which gate, and how it is driven.

    Args:
        robot: whose tools they are.
        run: the gate's run folder.
        site: the site.
        binding: sound for it; the gate's own.
        trust: reads the trust root.
        stops: calls that stop the robot.
        client: the planner's name in the log.
        shadow: the gate is in shadow mode: it says what it would do, and the calls go past it.
        within_s: gate and server have come by then, at the start.
    """

    robot: RobotId
    run: Path
    site: Site
    binding: Binding
    trust: Callable[[], GateVerifier]
    stops: tuple[Call, ...] = ()
    client: str
    shadow: bool = False
    within_s: float = START_S


class Ends:
    """Both ends.

    Args:
        place: where.
        server: makes the calls.
        log: says what happens.
        rebuilder: what actions are called; the binding's first when absent.

    Raises:
        EnvironmentFault: there is no such run folder.
    """

    def __init__(
        self,
        place: GateTarget,
        server: ToolServer,
        log: ProcessLog,
        rebuilder: Rebuilds | None = None,
    ) -> None:
        require_folder(place.run)
        self._place = place
        self._server = server
        speaks = words_of(place.site, place.binding)
        gate = GatePlace(
            robot=place.robot,
            run=place.run,
            trust=place.trust,
            client=place.client,
            mode=Mode.SHADOW if place.shadow else Mode.ENFORCE,
            speaks=speaks,
        )
        self.planner = ToolPlanner(gate)
        #: the same planner to the gate, on a connection of its own, for what runs beside
        self.aside = ToolPlanner(gate)
        means = ToolDrivers(
            site=place.site,
            binder=Binder(place.site, place.binding),
            rebuilder=rebuilder or Rebuilder(place.site, place.binding),
            stops=place.stops,
        )
        body = self._body = ToolBody(place.robot, server, means, self.look, log)
        self._proven = asyncio.Event()
        self._driver = Driver(
            body,
            place.run,
            trust=place.trust,
            log=log,
            ready=self._proven.set,
            speaks=speaks,
        )

    def call_of(self, ticket: str | None) -> Call | None:
        """Return the call that was made for a release, while it is the last one; else None."""
        return self._body.call_of(ticket)

    def look(self) -> None:
        """Look at the server now: something of it has come, gone or ended."""
        self._driver.look()

    @asynccontextmanager
    async def running(
        self, *work: Coroutine[object, object, None], where: str
    ) -> AsyncIterator[None]:
        """Drive the server; what is inside runs once gate and server have come.

        Args:
            work: what else goes on meanwhile: the server's connection.
            where: the server's place, for messages.

        Raises:
            EnvironmentFault: gate or server did not come.
        """
        async with asyncio.TaskGroup() as group:
            tasks = [group.create_task(item) for item in work]
            if not self._place.shadow:
                tasks.append(group.create_task(self._driver.stay()))
            try:
                await self._started(where)
                yield
            finally:
                await self._body.let_go()  # while its server is still there
                await self.planner.close()
                await self.aside.close()
            # after an error the group cancels them; twice would cut a clean end short
            for task in tasks:
                task.cancel()

    async def _started(self, where: str) -> None:
        try:
            async with asyncio.timeout(self._place.within_s):
                if self._place.shadow:
                    await self.planner.connected()
                    self._proven.set()
                await self._proven.wait()
                while not self._server.ready:
                    await asyncio.sleep(0.02)
        except TimeoutError as error:
            missing = "the tools' server" if self._proven.is_set() else "the gate"
            raise EnvironmentFault(
                f"{missing} did not come in time; standard error says why",
                reason=Reason.CONTROLLER_FAILED,
                where=(where if self._proven.is_set() else str(self._place.run))[:200],
            ) from error


def first_of(group: BaseException) -> BaseException:
    """Return the first error that is no group."""
    while isinstance(group, BaseExceptionGroup):
        group = group.exceptions[0]
    return group
