# SPDX-License-Identifier: Apache-2.0
"""An open stream, steered by the client that proposed it while `propose` waits for its end.

Spec page: docs/spec/gate-protocol.md#streams
"""

from __future__ import annotations

from authguard_r.client.asynchronous import AsyncGateClient
from authguard_r.core.identifiers import Digest
from authguard_r.wire.messages import Close, Kind, Sample


class StreamHandle:
    """One stream.

    Args:
        gate: the connection that proposed it.
        ticket: of its release, which `propose` reports while it waits.
    """

    def __init__(self, gate: AsyncGateClient, ticket: Digest) -> None:
        self._gate, self._ticket = gate, ticket

    async def sample(self, params: dict[str, int]) -> bool:
        """Change its velocities; False when zero was sent in their place.

        Args:
            params: every velocity of the action.

        Raises:
            AuthGuardError: it is over, or the gate is not there.
        """
        said = await self._gate.ask(Kind.SAMPLE, Sample(ticket=self._ticket, params=params))
        return said.get("forwarded") is True

    async def close(self) -> None:
        """End it; what `propose` returns then says how it ended.

        Raises:
            AuthGuardError: it is over already, or the gate is not there.
        """
        await self._gate.ask(Kind.CLOSE, Close(ticket=self._ticket))
