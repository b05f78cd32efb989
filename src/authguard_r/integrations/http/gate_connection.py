# SPDX-License-Identifier: Apache-2.0
"""The connection to the gate: made at the first request, and anew when it was lost.

Spec page: docs/spec/http.md#the-gate
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import TypeVar

from authguard_r.client import AsyncGateClient
from authguard_r.client.link import ProcessLog
from authguard_r.client.reconnecting import GatePlace, ReconnectingClient
from authguard_r.core.errors import AuthGuardError, EnvironmentFault
from authguard_r.core.reasons import Reason
from authguard_r.wire.messages import ClientRole

T = TypeVar("T")

#: Requests that are before the gate at a time; it reads no more of one client anyway.
AT_ONCE = 8
#: Longest wait for one's turn and for a connection, in seconds.
WAIT_S = 10.0
#: Longest wait for a quick answer of the gate, in milliseconds.
ANSWER_MS = 5_000


class AwayError(Exception):
    """The gate did not answer, or could not: away, busy or in trouble. It is never a permit.

    Args:
        fault: why.
    """

    def __init__(self, fault: AuthGuardError) -> None:
        super().__init__(str(fault))
        self.fault = fault


class GateLink:
    """One client of the gate, in one role.

    Args:
        place: which gate.
        role: what it is there.
        log: says once what happened.
    """

    def __init__(self, place: GatePlace, role: ClientRole, log: ProcessLog) -> None:
        self._kept = ReconnectingClient(place, role, timeout_ms=ANSWER_MS)
        self._role, self._log = role, log
        self._seen: AsyncGateClient | None = None
        self._turns = asyncio.Semaphore(AT_ONCE)

    async def ask(
        self,
        question: Callable[[AsyncGateClient], Awaitable[T]],
        *,
        refusal: type[AuthGuardError] | None = None,
    ) -> T:
        """Return what the gate answers.

        Args:
            question: asks it.
            refusal: errors of this kind are an answer too, unless the gate's world is at fault.

        Raises:
            AwayError: it did not answer, or was in trouble.
            AuthGuardError: a refusal of that kind.
        """
        try:
            async with asyncio.timeout(WAIT_S):  # `wait_for` may lose a cancellation
                await self._turns.acquire()
        except TimeoutError:
            raise AwayError(busy("too many wait for the gate")) from None
        try:
            gate = await self.connected()
            try:
                return await question(gate)
            except AuthGuardError as error:
                is_answer = refusal is not None and isinstance(error, refusal)
                if is_answer and gate.is_open and not isinstance(error, EnvironmentFault):
                    raise
                raise AwayError(error) from error
        finally:
            self._turns.release()

    async def connected(self) -> AsyncGateClient:
        """Return the gate, connected anew where it was lost.

        Raises:
            AwayError: it cannot be reached, is not the one that was meant, or in another mode.
        """
        try:
            gate = await self._kept.connected()
        except AuthGuardError as error:
            self._log.fault(self._role, error)
            raise AwayError(error) from error
        if gate is not self._seen:
            if self._seen is not None:
                self._log.say("disconnected", self._role)
            self._log.say("connected", self._role)
            self._seen = gate
        return gate

    async def close(self) -> None:
        """Let go of the connection."""
        await self._kept.close()


def busy(message: str) -> EnvironmentFault:
    """Return the fault of having too much to do."""
    return EnvironmentFault(message, reason=Reason.BUSY, where="server")
