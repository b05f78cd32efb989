# SPDX-License-Identifier: Apache-2.0
"""One client of one gate, for as long as a process lives: connected anew where it was lost.

Nothing is tried in the background: the caller gets the reason why the gate cannot be reached. Spec
page: docs/spec/gate-protocol.md#connections
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

from msgspec import Struct

from authguard_r.client.asynchronous import AsyncGateClient
from authguard_r.client.handshake import GateVerifier, Speaks
from authguard_r.client.start import TIMEOUT_MS
from authguard_r.core.errors import RefusedError
from authguard_r.core.identifiers import Identifier, RobotId
from authguard_r.core.reasons import Reason
from authguard_r.wire.messages import ClientRole, Mode


class GatePlace(Struct, frozen=True, kw_only=True):
    """Which gate.

    Args:
        robot: whose gate it has to be.
        run: its run folder.
        trust: reads the trust root, for each connection anew, so that a revocation counts.
        client: the client's name in the gate's log.
        mode: a gate in another mode is not taken.
        speaks: nor one that speaks other words; None takes any.
    """

    robot: RobotId
    run: Path
    trust: Callable[[], GateVerifier]
    client: Identifier
    mode: Mode = Mode.ENFORCE
    speaks: Speaks | None = None


class ReconnectingClient:
    """A client of a gate, in one role.

    Args:
        place: which gate.
        role: what the client is there.
        timeout_ms: longest wait for a quick answer.
    """

    def __init__(self, place: GatePlace, role: ClientRole, *, timeout_ms: int = TIMEOUT_MS) -> None:
        self._place, self._role, self._timeout_ms = place, role, timeout_ms
        self._gate: AsyncGateClient | None = None
        self._connecting = asyncio.Lock()

    async def connected(self) -> AsyncGateClient:
        """Return the gate, connected anew where it was lost.

        Raises:
            AuthGuardError: it cannot be reached, is not the one that was meant, or in another mode.
        """
        async with self._connecting:
            if self._gate is not None and not self._gate.is_open:
                await self.close()
            if self._gate is None:
                self._gate = await self._connect()
            return self._gate

    async def close(self) -> None:
        """Let go of the connection, if there is one."""
        gate, self._gate = self._gate, None
        if gate is not None:
            await gate.close()

    async def _connect(self) -> AsyncGateClient:
        place = self._place
        gate = await AsyncGateClient.connect(
            place.run / "gate.sock",
            role=self._role,
            client=place.client,
            verifier=place.trust(),
            robot=place.robot,
            allow_shadow=True,  # which mode it has to be in is looked at here, for every role
            speaks=place.speaks,
            timeout_ms=self._timeout_ms,
        )
        if gate.welcome.mode is not place.mode:
            await gate.close()
            raise RefusedError(
                "the gate enforces: calls do not go past it"
                if place.mode is Mode.SHADOW
                else "the gate is in shadow mode: it releases nothing",
                reason=Reason.TRANSITION_REFUSED,
                where="welcome.mode",
            )
        return gate
