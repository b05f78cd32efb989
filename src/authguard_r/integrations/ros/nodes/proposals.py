# SPDX-License-Identifier: Apache-2.0
"""The planners' end: a bounded number of proposals at once, each on a connection of its own.

A gate takes one proposal of a connection at a time. To the gate all of them are one planner: what
one was shown, all of them have seen. Spec page: docs/spec/ros.md#ends
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Iterable
from contextlib import asynccontextmanager, suppress
from functools import partial
from typing import Any

from authguard_r.client import AsyncGateClient
from authguard_r.client.reconnecting import GatePlace
from authguard_r.core.errors import AuthGuardError, EnvironmentFault
from authguard_r.core.reasons import Reason
from authguard_r.integrations.ros.nodes.releases import Release, Releases
from authguard_r.integrations.tools.planner import CallOutcome, ToolPlanner
from authguard_r.normalize.bind import UNTOLD
from authguard_r.normalize.dialects import Call

#: Proposals under way at once; an action that runs is one.
MOST = 6
#: What cannot be read and waits to be handed in; more is refused all the same, and not logged.
_MOST_UNREADABLE = 16


class PlannerProposals:
    """Asks the gate for planners.

    Args:
        place: which gate.
        releases: what the controller's end begins.
    """

    def __init__(self, place: GatePlace, releases: Releases) -> None:
        self._planners = tuple(ToolPlanner(place) for _ in range(MOST))
        self._notes = ToolPlanner(place)
        self._releases = releases
        self._unreadable = 0

    async def ready(self) -> None:
        """Return once the gate is there.

        Raises:
            AuthGuardError: it is not, or not the one that it has to be.
        """
        await self._notes.connected()

    async def ask(
        self,
        call: Call,
        *,
        began: Callable[[Release], None],
        through: Callable[[AsyncGateClient, str], None] | None = None,
    ) -> CallOutcome:
        """Propose a call; return its report once that is known.

        Args:
            call: untrusted.
            began: called once, when what was released for it begins.
            through: called with the connection and the ticket of what was released: samples of a
                stream go the same way.

        Raises:
            EnvironmentFault: as many proposals as there may be are under way (`BUSY`).
            AuthGuardError: nothing was decided.
            LostError: the gate went while it was asked.
        """
        async with self._turn() as (planner, tickets):
            gate = await planner.connected()

            def told(step: dict[str, Any]) -> None:
                ticket = step.get("ticket")
                if ticket is not None and ticket not in tickets:
                    tickets.append(ticket)
                    self._releases.when(ticket, began)
                    if through is not None:
                        through(gate, ticket)

            return await planner.propose(call.tool, call.arguments, told=told)

    async def plan(
        self,
        data: bytes,
        *,
        told: Callable[[dict[str, Any]], None],
        began: Callable[[int, Release], None],
    ) -> dict[str, Any]:
        """Propose a plan as it was written; return the gate's answer once it has ended.

        Args:
            data: untrusted.
            told: called with each event of the gate before the answer.
            began: called with a step and what was released for it, when that begins.

        Raises:
            EnvironmentFault: as many proposals as there may be are under way (`BUSY`).
            AuthGuardError: nothing was decided.
            LostError: the gate went while it was asked.
        """
        async with self._turn() as (planner, tickets):

            def hear(item: dict[str, Any]) -> None:
                told(item)
                ticket = item["ticket"]
                if ticket not in tickets:
                    tickets.append(ticket)
                    self._releases.when(ticket, partial(began, item["step"]))

            return await planner.plan(data, told=hear)

    @asynccontextmanager
    async def _turn(self) -> AsyncIterator[tuple[ToolPlanner, list[str]]]:
        """Yield a connection that is free, and a list for the tickets that it receives.

        Raises:
            EnvironmentFault: none is (`BUSY`).
        """
        planner = next((one for one in self._planners if not one.turn.locked()), None)
        if planner is None:
            raise EnvironmentFault(
                "too many proposals are under way", reason=Reason.BUSY, where="proposal"
            )
        tickets: list[str] = []
        async with planner.turn:
            try:
                yield planner, tickets
            finally:
                for ticket in tickets:
                    self._releases.forget(ticket)

    async def note(self, texts: Iterable[str], channel: str = UNTOLD) -> None:
        """Tell the gate what planners are about to see; without a channel, as the least trusted.

        Raises:
            AuthGuardError: it did not take note.
        """
        await self._notes.note(texts, channel)

    async def unreadable(self, tool: str, error: AuthGuardError) -> None:
        """Hand in that a message was none that can be read: the gate refuses it, and logs that.

        It never succeeds, also when the gate is away.
        """
        if self._unreadable >= _MOST_UNREADABLE:
            return
        self._unreadable += 1
        try:
            with suppress(AuthGuardError):
                await self._notes.unreadable(tool, str(error))
        finally:
            self._unreadable -= 1

    async def close(self) -> None:
        """Let go of the gate for good."""
        for planner in (*self._planners, self._notes):
            await planner.close()


def code_of(asked: CallOutcome) -> str:
    """Return the deciding code of what did not succeed; empty of what did."""
    execution = asked.step["execution"]
    codes = asked.step["reasons"] if asked.execution is None else execution["reasons"]
    return str(codes[0]) if codes else ""
