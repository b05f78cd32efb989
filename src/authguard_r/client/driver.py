# SPDX-License-Identifier: Apache-2.0
"""A controller between its two connections: gate and stop process on one side, a body on the other.

It calls both; nothing can call it. Spec page: docs/spec/gate-protocol.md#controllers
"""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Callable
from pathlib import Path

from authguard_r.client.controller import Body, ControllerSession, MessageSource, OutgoingMessage
from authguard_r.client.handshake import GateVerifier, Speaks
from authguard_r.client.link import PersistentConnection, ProcessLog, mono_ms
from authguard_r.client.proof import Proven
from authguard_r.core.identifiers import MAX_INTEGER, Identifier
from authguard_r.wire.frames import Frame, frame
from authguard_r.wire.messages import ClientRole, Kind

#: Time between two looks at the body, in seconds.
TICK_S = 0.01
SOCKETS = {MessageSource.GATE: "gate.sock", MessageSource.STOP: "stop.sock"}
#: Longest body of what a gate may send to a controller, in bytes.
BOUNDS = {
    Kind.DISPATCH: 1 << 16,
    Kind.RENEW: 1 << 12,
    Kind.HALT: 1 << 12,
    Kind.FORWARD: 1 << 12,
    Kind.CLOSE: 1 << 12,
    Kind.REPLY: 1 << 16,
    Kind.ERROR: 1 << 16,
    Kind.EVENT: 1 << 16,
}


class Driver:
    """One controller.

    Args:
        body: what moves; signs nothing.
        run: the folder with the sockets.
        trust: reads the trust root, for each connection anew.
        log: says what happens.
        ready: called once, when a gate has proved itself for the first time.
        speaks: the words in which the body reads what is released; None of one that reads the
            action itself.
    """

    def __init__(
        self,
        body: Body,
        run: Path,
        *,
        trust: Callable[[], GateVerifier],
        log: ProcessLog,
        ready: Callable[[], None],
        speaks: Speaks | None = None,
    ) -> None:
        # not a time: a clock that was set back must not make a number of before
        life = secrets.randbelow(MAX_INTEGER) + 1
        self.session = ControllerSession(body, life=life, now_ms=mono_ms())
        self._ready: Callable[[], None] | None = ready
        self._callers = {
            channel: PersistentConnection(
                run / name,
                role=ClientRole.CONTROLLER,
                client=Identifier(f"controller-{body.rid}"[:64]),
                robot=body.rid,
                trust=trust,
                bounds=BOUNDS,
                listener=_Ear(self, channel),
                log=log,
                allow_shadow=channel is MessageSource.STOP,  # a stop counts for every driver
                speaks=None
                if channel is MessageSource.STOP
                else speaks,  # the stop process has no words
            )
            for channel, name in SOCKETS.items()
        }

    async def stay(self) -> None:
        """Keep both connections, and look at the body, until this is canceled."""
        async with asyncio.TaskGroup() as group:
            for caller in self._callers.values():
                group.create_task(caller.stay())
            group.create_task(self._pass_time())

    def look(self) -> None:
        """Look at the body now: something of it has ended."""
        self.send(self.session.tick(mono_ms()))

    def send(self, messages: tuple[OutgoingMessage, ...]) -> None:
        """Send the frames that the controller's state machine wants to send."""
        for sent in messages:
            self._callers[sent.channel].send(frame(sent.kind, sent.id, sent.body))

    def is_ready(self) -> None:
        """Say once that a gate is there."""
        if self._ready is not None:
            self._ready()
            self._ready = None

    async def _pass_time(self) -> None:
        while True:
            self.look()
            await asyncio.sleep(TICK_S)


class _Ear:
    """Passes what one connection says to the controller's state machine."""

    def __init__(self, driver: Driver, channel: MessageSource) -> None:
        self._driver = driver
        self._channel = channel

    def opened(self, proven: Proven) -> None:
        driver = self._driver
        driver.send(driver.session.opened(self._channel, proven, mono_ms()))
        if self._channel is MessageSource.GATE:
            driver.is_ready()

    def heard(self, item: Frame) -> None:
        driver = self._driver
        driver.send(driver.session.handle(self._channel, item, mono_ms()))

    def closed(self) -> None:
        driver = self._driver
        driver.send(driver.session.closed(self._channel, mono_ms()))
