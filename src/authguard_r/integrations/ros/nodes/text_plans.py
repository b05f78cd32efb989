# SPDX-License-Identifier: Apache-2.0
"""Plans as text: what a planner publishes goes to the gate as it is, and the result is published.

Nothing is parsed here, translated or judged. The outcome of each plan that was heard is published.
Spec page: docs/spec/ros.md#plans-as-text
"""

from __future__ import annotations

import asyncio
import base64
import hashlib
import json
import struct
from functools import partial
from typing import Any

from msgspec import Struct
from rclpy.qos import QoSProfile
from std_msgs.msg import String

from authguard_r.core.errors import AuthGuardError, MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.integrations.ros.map import TextTopics as Topics
from authguard_r.integrations.ros.nodes.actions import Public
from authguard_r.integrations.ros.nodes.inbox import ThreadInbox
from authguard_r.integrations.ros.nodes.proxies import fields_of
from authguard_r.integrations.ros.nodes.releases import Release
from authguard_r.integrations.ros.steps import decided, ended_by
from authguard_r.integrations.tools.planner import LostError
from authguard_r.normalize.parse import MAX_TEXT

#: Plans that wait to be looked at; more are dropped, and their number is published.
MOST_WAITING = 16
#: Between two plans, in seconds: a flood of the topic does not keep others waiting.
GAP_S = 0.01
#: Messages that a planner may leave unread.
_DEPTH = 100
#: In front of the characters: how it is written, and how long it is.
_HEAD = 8
#: How numbers are written, by what DDS says in front of a message.
_ORDERS = {b"\0\0": ">", b"\0\1": "<", b"\0\6": ">", b"\0\7": "<"}
_TOOL = "a plan as text"


class ReceivedText(Struct, frozen=True):
    """A `String` as DDS brought it, untrusted, or the beginning of one that is too long."""

    data: bytes
    is_whole: bool


class TextPlanServer:
    """Hears plans, and publishes the result of each.

    Args:
        public: the node.
        topics: where.
    """

    def __init__(self, public: Public, topics: Topics) -> None:
        self.public = public
        self._heard: ThreadInbox[ReceivedText] = ThreadInbox(
            public.spinner, MOST_WAITING, is_newest=False
        )
        self._number = 0
        node = public.spinner.node
        self._told = node.create_publisher(
            String, topics.told, QoSProfile(depth=_DEPTH), callback_group=public.group
        )
        # raw: `rclpy` would cut a text at its first zero, and repair what is not UTF-8
        node.create_subscription(
            String,
            topics.ask,
            self._came,
            QoSProfile(depth=_DEPTH),
            raw=True,
            callback_group=public.group,
        )

    async def stay(self) -> None:
        """Take one plan after the other until this is canceled."""
        while True:
            heard = await self._heard.take()
            self._number += 1
            going = _OpenPlan(self, {"plan": id_of(heard), "number": self._number})
            self.public.spinner.begin(going.run(heard))
            shed = self._heard.shed()
            if shed:
                self.tell({"news": "refused", "reasons": [Reason.BUSY], "shed": shed})
            await asyncio.sleep(GAP_S)

    def tell(self, news: dict[str, Any]) -> None:
        """Publish something; in the event loop."""
        self._told.publish(String(data=json.dumps(news)))

    def _came(self, data: bytes) -> None:
        """Take a message on the thread of ROS; of one that is too long the beginning."""
        most = _HEAD + MAX_TEXT + 4  # a zero, and what fills up four bytes
        self._heard.put(ReceivedText(data[:most], len(data) <= most))


class _OpenPlan:
    """One plan, until it is over.

    Args:
        inlet: where it came.
        names: of the plan, in each message.
    """

    def __init__(self, inlet: TextPlanServer, names: dict[str, Any]) -> None:
        self._inlet, self._names = inlet, names
        self._open: dict[int, str] = {}  # the tickets of steps whose end was not published
        self._decided: set[int] = set()
        self._released: dict[int, Release] = {}

    async def run(self, heard: ReceivedText) -> None:
        """Have it decided and carried out, and publish the result."""
        proposals = self._inlet.public.proposals
        try:
            data = text_of(heard)
        except MalformedError as error:
            self._tell_error("refused", error)
            await proposals.unreadable(_TOOL, error)
            return
        try:
            answer = await proposals.plan(data, told=self._heard, began=self._began)
        except LostError as lost:
            self._tell_error("lost", lost.error)
        except AuthGuardError as error:
            self._tell_error("refused", error)
        else:
            self._over(answer)

    def _heard(self, item: dict[str, Any]) -> None:
        """Tell what the gate says before its answer; what the robot said is noted by then."""
        step, ticket = item["step"], item["ticket"]
        if "result" in item:
            release = self._released.get(step)
            message = None if release is None else release.answer  # none: it was too long
            answer = None if message is None else fields_of(message)
            self._tell("brought", step=step, ticket=ticket, texts=_noted(item), answer=answer)
            return
        for before in tuple(self._open):  # a step that does not succeed would have ended the plan
            self._ended(before, "succeeded", [])
        self._open[step] = ticket
        self._decided.add(step)
        self._tell("decided", step=step, ticket=ticket, **decided(item))

    def _began(self, step: int, release: Release) -> None:
        self._released[step] = release
        release.taken.add_done_callback(partial(self._taken, step, release.name))

    def _taken(self, step: int, name: str, taken: asyncio.Future[bool]) -> None:
        """Tell that the robot's own part has taken it."""
        if not taken.cancelled() and taken.result() and step in self._open:
            self._tell("began", step=step, ticket=self._open[step], type=name)

    def _over(self, answer: dict[str, Any]) -> None:
        """Publish what the gate's answer says that was not published yet."""
        for step, report in enumerate(answer["steps"]):
            if step not in self._decided:
                self._tell("decided", step=step, ticket=None, **decided(report))
            execution = report["execution"]["outcome"]
            if execution is not None and (step in self._open or step not in self._decided):
                self._ended(step, execution, ended_by(report))
        self._tell("over", steps=len(answer["steps"]), planned=answer["planned"])

    def _ended(self, step: int, execution: str, reasons: list[str]) -> None:
        ticket = self._open.pop(step, None)
        self._tell("ended", step=step, ticket=ticket, execution=execution, reasons=reasons)

    def _tell_error(self, news: str, error: AuthGuardError) -> None:
        self._tell(news, reasons=[error.reason], place=error.where)
        self._inlet.public.log.say(news, "proposals", reason=str(error.reason), where=error.where)

    def _tell(self, news: str, **more: Any) -> None:
        self._inlet.tell({**self._names, "news": news, **more})


def id_of(heard: ReceivedText) -> str:
    """Return the SHA-256 of a text, as its planner can compute it; without its invalid characters.

    Of one that is too long the beginning counts.
    """
    try:
        text = text_of(heard)
    except MalformedError:
        text = heard.data[_HEAD : _HEAD + MAX_TEXT]
    return hashlib.sha256(text).hexdigest()


def text_of(heard: ReceivedText) -> bytes:
    """Return the bytes of a text as its planner wrote them.

    Raises:
        MalformedError: it is too long, or no `String`.
    """
    data = heard.data
    if not heard.is_whole:
        raise MalformedError(
            f"expected at most {MAX_TEXT} bytes", where="plan", reason=Reason.INPUT_TOO_LARGE
        )
    order = _ORDERS.get(data[:2])
    if order is None or len(data) < _HEAD:
        raise MalformedError("expected a text as DDS writes it", where="plan")
    (length,) = struct.unpack(f"{order}I", data[4:_HEAD])
    text = data[_HEAD : _HEAD + length]
    if len(text) != length or text[-1:] != b"\0":
        raise MalformedError("expected a text as DDS writes it", where="plan")
    return text[:-1]


def _noted(item: dict[str, Any]) -> list[str]:
    """Return the words of an answer that went through the gate."""
    texts: list[str] = json.loads(base64.b64decode(item["result"]))["texts"]
    return texts
