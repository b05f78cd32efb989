# SPDX-License-Identifier: Apache-2.0
"""Publishes each decision of the gate, for every planner, to displays as it happens.

An auditor's connection of its own, which reads and changes nothing; one that is lost is made again.
A display that is slow, or a gate that decides faster than it can be published, keeps nothing
waiting: what is too much is dropped, and counted. Spec page: docs/spec/ros.md#decisions
"""

from __future__ import annotations

import asyncio
from collections import deque
from typing import Any

from msgspec.structs import replace
from rclpy.qos import DurabilityPolicy, QoSProfile

from authguard_r.client import AsyncGateClient
from authguard_r.client.reconnecting import GatePlace, ReconnectingClient
from authguard_r.core.errors import AuthGuardError, EnvironmentFault, MalformedError
from authguard_r.core.identifiers import Identifier
from authguard_r.integrations.ros.nodes.actions import Public
from authguard_r.integrations.ros.nodes.values import message_of
from authguard_r.integrations.ros.steps import KINDS, display_of, stopped_by
from authguard_r.wire.messages import ClientRole

#: Decisions that a display that comes late still has.
KEPT = 50
#: Decisions that wait to be published.
MOST_WAITING = 256
#: So many are published in a row, and then nothing for so long, in seconds.
_ROW, _GAP_S = 10, 0.01
#: A gate that is away is asked again after so long, one that refuses this client later.
AWAY_S, REFUSED_S = 0.5, 10.0
#: A gate that lives says its counts within this, in milliseconds.
ANSWER_MS = 900


class Decisions:
    """Hears the gate, and publishes what it decides.

    Args:
        public: the node.
        place: which gate.
        topic: where displays read.
        kind: `authguard_interfaces/msg/Decision`.
    """

    def __init__(self, public: Public, place: GatePlace, topic: str, kind: Any) -> None:
        self._public, self._kind, self._robot = public, kind, str(place.robot)
        mine = replace(place, client=Identifier(f"{place.client}-displays"[:64]))
        self._kept = ReconnectingClient(mine, ClientRole.AUDITOR, timeout_ms=ANSWER_MS)
        self._gate: AsyncGateClient | None = None  # while it is heard
        self._waiting: deque[dict[str, Any]] = deque()
        self._news = asyncio.Event()
        #: never published, since the node started
        self.missed = 0
        #: what stopped the robot last, as far as it was heard
        self.last_stop = ""
        #: the gate's own, as it said them last
        self.counts: dict[str, Any] = {}
        self._why = "not connected yet"
        qos = QoSProfile(depth=KEPT, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._publisher = public.spinner.node.create_publisher(
            kind, topic, qos, callback_group=public.group
        )

    async def stay(self) -> None:
        """Hear the gate until this is canceled."""
        try:
            while True:
                try:
                    await self._hear()
                except AuthGuardError as error:
                    self._gate, self._why = None, str(error.reason)
                    self._public.log.fault("decisions", error)
                    away = isinstance(error, EnvironmentFault)
                    await asyncio.sleep(AWAY_S if away else REFUSED_S)
        finally:
            await self._kept.close()

    async def publish(self) -> None:
        """Publish what was heard until this is canceled: some, and then the others' turn."""
        while True:
            await self._news.wait()
            self._news.clear()
            while self._waiting:
                for _ in range(min(_ROW, len(self._waiting))):
                    self._publish(self._waiting.popleft())
                await asyncio.sleep(_GAP_S)

    async def ask(self) -> str:
        """Ask the gate for its counts; return why it did not say them, empty when it did."""
        if self._gate is None:
            return self._why
        try:
            self.counts = await self._gate.metrics()
        except AuthGuardError as error:
            return str(error.reason)
        return ""

    def take(self, event: dict[str, Any]) -> None:
        """Take in an event of the gate's; of too many the oldest are dropped."""
        if event.get("event") not in KINDS:
            return
        self.last_stop = stopped_by(event) or self.last_stop
        if len(self._waiting) == MOST_WAITING:
            self._waiting.popleft()
            self.missed += 1
        self._waiting.append(event)
        self._news.set()

    async def _hear(self) -> None:
        """Hear one connection's events to its end.

        Raises:
            AuthGuardError: it cannot be heard any more.
        """
        gate = await self._kept.connected()
        events = await gate.watch()
        self._gate = gate
        self._public.log.say("connected", "decisions")
        async for event in events:
            self.take(event)
            await asyncio.sleep(0)  # however many came at once, the others have their turn

    def _publish(self, event: dict[str, Any]) -> None:
        try:
            plain = {**display_of(event, self._robot), "missed": self.missed}
            self._publisher.publish(message_of(self._kind, plain, where="decision"))
        except MalformedError as error:
            self.missed += 1
            self._public.log.fault("decisions", error)
