# SPDX-License-Identifier: Apache-2.0
"""What the robot publishes and a planner may read: shown once the gate has noted its words.

The newest counts: what comes while one is being noted takes the place of what waits. What was not
noted is not shown. Spec page: docs/spec/ros.md#shown-topics
"""

from __future__ import annotations

import asyncio
from typing import Any

from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message

from authguard_r.core.errors import AuthGuardError, MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.integrations.ros.map import ShownTopic
from authguard_r.integrations.ros.nodes.actions import Public
from authguard_r.integrations.ros.nodes.inbox import ThreadInbox
from authguard_r.integrations.ros.nodes.values import texts_of
from authguard_r.integrations.tools.server import MAX_TEXT
from authguard_r.normalize.bind import UNTOLD

#: Longest message that is shown, in bytes as DDS has it.
MAX_BYTES = 1 << 20
#: Most texts of one message.
MAX_TEXTS = 1_000
#: Between two messages of a topic, in seconds.
GAP_S = 0.02
#: Between two lines of the log about what was not shown, in seconds.
_LINE_S = 1.0


class Relay:
    """Shows one topic.

    Args:
        public: the node.
        key: its name in the map.
        item: what the map says of it.
        kind: the message's class.
    """

    def __init__(self, public: Public, key: str, item: ShownTopic, kind: Any) -> None:
        self._public, self._key, self._kind = public, key, kind
        self._channel = item.channel or UNTOLD
        self._newest: ThreadInbox[bytes] = ThreadInbox(public.spinner, 1, is_newest=True)
        self._hidden = 0  # never shown
        self._told_s = public.spinner.loop.time() - _LINE_S
        node = public.spinner.node
        self._publisher = node.create_publisher(
            kind, item.public, QoSProfile(depth=1), callback_group=public.group
        )
        node.create_subscription(
            kind,
            item.private,
            self._newest.put,
            # hears every publisher, reliable or not
            QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT),
            raw=True,
            callback_group=public.group,
        )

    async def stay(self) -> None:
        """Show one message after the other until this is canceled."""
        while True:
            data = await self._newest.take()
            try:
                # a thread of its own: neither the gate's ends nor the robot's wait for it
                message, texts = await asyncio.to_thread(read, data, self._kind, self._key)
                await self._public.proposals.note(texts, self._channel)
            except AuthGuardError as error:  # it was not noted: it is not shown
                self._hide(error)
            else:
                self._publisher.publish(message)
            await asyncio.sleep(GAP_S)

    def _hide(self, error: AuthGuardError) -> None:
        """Count messages that are not shown; now and then the log says how many and why."""
        self._hidden += 1
        now_s = self._public.spinner.loop.time()
        if now_s - self._told_s >= _LINE_S:
            self._told_s = now_s
            why = {"reason": str(error.reason), "messages": str(self._hidden)}
            self._public.log.say("not shown", self._key, **why)


def read(data: bytes, kind: Any, where: str) -> tuple[Any, tuple[str, ...]]:
    """Return a message and what of it is noted: each of its words, and that it was there.

    What is shown is made anew from what was read: bytes that were not checked are not shown.

    Args:
        data: as DDS has it; as trusted as the robot's own process.
        kind: the message's class.
        where: its place.

    Raises:
        MalformedError: none of its kind, or too much of everything.
    """
    if len(data) > MAX_BYTES:
        raise _too_large(where, f"expected at most {MAX_BYTES} bytes")
    try:
        message = deserialize_message(data, kind)
    except Exception as error:  # any fault that `rclpy` finds with it
        raise MalformedError("expected a message of its type", where=where) from error
    texts = texts_of(message)
    if len(texts) > MAX_TEXTS or sum(map(len, texts)) > MAX_TEXT:
        raise _too_large(where, f"expected at most {MAX_TEXT} characters in {MAX_TEXTS} texts")
    return message, texts or ("",)


def _too_large(where: str, message: str) -> MalformedError:
    return MalformedError(message, where=where, reason=Reason.INPUT_TOO_LARGE)
