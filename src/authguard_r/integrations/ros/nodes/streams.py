# SPDX-License-Identifier: Apache-2.0
"""The planners' side of a stream: the first velocity asks for a lease, each further one samples it.

What cannot be read is a zero. Silence ends the lease, and a refusal is not asked again at once: a
planner that repeats itself fifty times a second is one proposal.
Spec page: docs/spec/ros.md#streams
"""

from __future__ import annotations

import asyncio
import json
from contextlib import suppress
from typing import Any

from authguard_r.client import AsyncGateClient
from authguard_r.client.stream_handle import StreamHandle
from authguard_r.core.action import Action
from authguard_r.core.errors import AuthGuardError, MalformedError
from authguard_r.core.identifiers import Digest
from authguard_r.integrations.ros.calls import DURATION, FORMS, call_of
from authguard_r.integrations.ros.map import Mediated
from authguard_r.integrations.ros.nodes.actions import Public
from authguard_r.integrations.ros.nodes.inbox import ThreadInbox
from authguard_r.integrations.ros.nodes.loop import kept
from authguard_r.integrations.ros.nodes.proposals import code_of
from authguard_r.integrations.ros.nodes.values import plain_of
from authguard_r.integrations.tools.planner import LostError
from authguard_r.normalize import Binder
from authguard_r.normalize.dialects import Call, Dialect, read_reply

#: A planner that says nothing for so long has ended its stream, in seconds.
SILENT_S = 0.5
#: After a refusal nothing is proposed for so long, in seconds.
PAUSE_S = 1.0
#: Between two samples; the gate drops what comes sooner than 10 ms after the last, in seconds.
GAP_S = 0.011
_DEPTH = 10
#: Samples that wait for the gate; of more the oldest are dropped.
MOST_WAITING = 5


class StreamServer:
    """Hears one topic of velocities.

    Args:
        public: the node.
        key: its name in the map.
        item: what the map says of it.
        kind: the message's class.
        binder: what velocities mean; it decides nothing.
    """

    def __init__(self, public: Public, key: str, item: Mediated, kind: Any, binder: Binder) -> None:
        self._public, self._key, self._item, self._binder = public, key, item, binder
        self._loop = public.spinner.loop
        #: of more than wait for the gate, the oldest are dropped
        self._came: ThreadInbox[tuple[Any, bytes]] = ThreadInbox(
            public.spinner, MOST_WAITING, is_newest=True
        )
        self._sender: bytes | None = None  # whose stream is open; None when none is
        self._heard_s = self._paused_s = self._told_s = self._loop.time() - PAUSE_S
        public.spinner.node.create_subscription(
            kind, item.public, self._take, _DEPTH, callback_group=public.group
        )
        public.spinner.soon(lambda: public.spinner.begin(kept(self.stay, public.log)))

    def _take(self, message: Any, info: Any) -> None:
        """Take a message on the thread of ROS; one planner steers at a time."""
        sender, steers = _sender_of(info), self._sender
        if steers is None or sender == steers:
            self._heard_s = self._loop.time()
            self._came.put((message, sender))

    async def stay(self) -> None:
        """Ask for a lease while a planner steers, and sample it, until this is cancelled."""
        self._came.clear()
        while True:
            message, sender = await self._came.take()
            call, sample = self._read(message)
            is_paused = self._loop.time() - self._paused_s < PAUSE_S
            if call is not None and sample is not None and any(sample.values()) and not is_paused:
                self._sender = sender
                try:
                    await self._ask(call, sample)
                finally:
                    self._sender = None
                    self._came.clear()  # an old velocity is worth nothing
            # no planner keeps the loop that holds the robot, however many velocities it sends
            await asyncio.sleep(GAP_S)

    def _read(self, message: Any) -> tuple[Call | None, dict[str, int] | None]:
        """Return the call that a message is, and its velocities; None: it is not, or has none."""
        call = None
        try:
            call = call_of(self._item, plain_of(message, where="msg", is_asked=True))
            return call, _sample(self._binder.bind(_exact(call)))
        except MalformedError as error:
            self._refused(error)
            return call, None

    def _refused(self, error: MalformedError) -> None:
        """Have what is no velocity logged, once in a while."""
        now = self._loop.time()
        if now - self._told_s >= PAUSE_S:
            self._told_s = now
            tool = FORMS[self._item.kind].tool
            self._public.spinner.begin(self._public.proposals.unreadable(tool, error))

    async def _ask(self, call: Call, first: dict[str, int]) -> None:
        """Ask for a lease, and sample it until it is over."""
        steering: list[asyncio.Task[None]] = []

        def through(gate: AsyncGateClient, ticket: str) -> None:
            stream = StreamHandle(gate, Digest(ticket))
            steering.append(self._public.spinner.begin(self._steer(stream, first)))

        code = ""
        try:
            asked = await self._public.proposals.ask(call, began=lambda _: None, through=through)
            code = code_of(asked)
        except LostError as error:
            code = str(error.error.reason)
        except AuthGuardError as error:
            code = str(error.reason)
        finally:
            for task in steering:
                task.cancel()
        if code:
            self._paused_s = self._loop.time()
            self._public.log.say("refused", self._key, reason=code)

    async def _steer(self, stream: StreamHandle, first: dict[str, int]) -> None:
        """Send on what comes, as long as something comes; then end the stream."""
        try:
            await stream.sample(first)  # so that its silence counts, too
            await asyncio.sleep(GAP_S)
            while (message := await self._next()) is not None:
                _, sample = self._read(message)
                await stream.sample(sample or dict.fromkeys(first, 0))
                await asyncio.sleep(GAP_S)
            await stream.close()
        except AuthGuardError:  # it is over, or the gate is: the proposal's answer says which
            return

    async def _next(self) -> Any:
        """Return the next message of the steering planner; None after `SILENT_S` of silence."""
        while (left_s := self._heard_s + SILENT_S - self._loop.time()) > 0:
            with suppress(TimeoutError):
                async with asyncio.timeout(left_s):
                    message, sender = await self._came.take()
                if sender == self._sender:  # an older message may be another planner's
                    return message
        return None


def _exact(call: Call) -> Call:
    """Return a call as the gate reads it: numbers as exact decimals."""
    plan = {"plan": [{"tool": call.tool, "arguments": call.arguments}]}
    (read,) = read_reply(json.dumps(plan), Dialect.JSON).calls
    return read


def _sample(action: Action) -> dict[str, int]:
    return {str(name): value for name, value in action.params.items() if name != DURATION}


def _sender_of(info: Any) -> bytes:
    """Return which publisher a message is of; empty where ROS does not say."""
    gid = info.get("publisher_gid") if isinstance(info, dict) else None
    return repr(gid).encode() if gid else b""
