# SPDX-License-Identifier: Apache-2.0
"""The way to the gate: connected when somebody asks, and anew when the connection was lost.

Spec page: docs/spec/http.md#the-gate
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import TypeVar

from msgspec import Struct

from authguard_r.client import AsyncGateClient
from authguard_r.client.greeting import GateVerifier
from authguard_r.client.link import Log
from authguard_r.core.errors import AuthGuardError, EnvironmentFault, RefusedError
from authguard_r.core.identifiers import Identifier, RobotId
from authguard_r.core.reasons import Reason
from authguard_r.wire.messages import ClientRole, Mode

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


class Where(Struct, frozen=True, kw_only=True):
    """Which gate.

    Args:
        robot: whose gate it has to be.
        run: its run folder.
        trust: reads the trust root, for each connection anew.
        client: the server's name in the gate's log.
        mode: a gate in another mode is not taken.
    """

    robot: RobotId
    run: Path
    trust: Callable[[], GateVerifier]
    client: Identifier
    mode: Mode = Mode.ENFORCE


class GateLink:
    """One client of the gate, in one role.

    Args:
        where: which gate.
        role: what it is there.
        log: says once what happened.
    """

    def __init__(self, where: Where, role: ClientRole, log: Log) -> None:
        self._where, self._role, self._log = where, role, log
        self._gate: AsyncGateClient | None = None
        self._connecting = asyncio.Lock()
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
            await asyncio.wait_for(self._turns.acquire(), WAIT_S)
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
        async with self._connecting:
            if self._gate is not None and not self._gate.is_open:
                await self._gate.close()
                self._gate = None
                self._log.say("disconnected", self._role)
            if self._gate is None:
                try:
                    self._gate = await self._connect()
                except AuthGuardError as error:
                    self._log.fault(self._role, error)
                    raise AwayError(error) from error
                self._log.say("connected", self._role)
            return self._gate

    async def close(self) -> None:
        """Let go of the connection."""
        if self._gate is not None:
            await self._gate.close()

    async def _connect(self) -> AsyncGateClient:
        where = self._where
        gate = await AsyncGateClient.connect(
            where.run / "gate.sock",
            role=self._role,
            client=where.client,
            verifier=where.trust(),
            robot=where.robot,
            allow_shadow=True,  # which mode it has to be in is looked at here
            timeout_ms=ANSWER_MS,
        )
        if gate.welcome.mode is not where.mode:
            await gate.close()
            raise RefusedError(
                f"expected a gate that is to `{where.mode}`, got one in mode `{gate.welcome.mode}`",
                reason=Reason.TRANSITION_REFUSED,
                where="welcome.mode",
            )
        return gate


def busy(message: str) -> EnvironmentFault:
    """Return the fault of having too much to do."""
    return EnvironmentFault(message, reason=Reason.BUSY, where="server")
