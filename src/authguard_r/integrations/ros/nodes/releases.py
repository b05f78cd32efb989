# SPDX-License-Identifier: Apache-2.0
"""A released action on its way to the robot, as both ends of the node see it.

The two ends meet by the ticket that the gate sent each of them. Spec page: docs/spec/ros.md#ends
"""

from __future__ import annotations

import asyncio
import json
from collections import OrderedDict
from collections.abc import Callable
from typing import Any

from authguard_r.client.controller import ExecutionNews
from authguard_r.core.identifiers import Digest
from authguard_r.core.standing import Outcome
from authguard_r.integrations.ros.nodes.values import texts_of
from authguard_r.integrations.tools.body import ToolGoal
from authguard_r.integrations.tools.server import WITHHELD, fits
from authguard_r.site.model import ActionModel

#: Feedback that waits until the planner hears that its goal was accepted.
MAX_FEEDBACK = 256
_MOST_KEPT = 64


class Release:
    """One of them; the robot's own server is asked for it once.

    Args:
        kind: the action's type.
        key: which mediated thing carries it out, by its name in the map.
        name: the type's name.
    """

    def __init__(self, kind: ActionModel, key: str, name: str = "") -> None:
        self.key, self.name = key, name
        self.handle = ToolGoal(kind)
        #: whether the robot's own server took it
        self.taken: asyncio.Future[bool] = asyncio.get_running_loop().create_future()
        self.feedback: asyncio.Queue[Any] = asyncio.Queue(MAX_FEEDBACK)
        #: the robot's own report of how it ended, and its answer; None: it said nothing
        self.status: int | None = None
        self.answer: Any = None
        self.over = asyncio.Event()
        #: calls it off at the robot's server
        self.cancel: Callable[[], None] = lambda: None

    @property
    def runs(self) -> bool:
        """True until it has ended."""
        return self.handle.outcome() is None

    def take(self) -> None:
        """Note that the robot's server took it."""
        self._took(is_taken=True)

    def fed(self, feedback: Any) -> None:
        """Keep a feedback for the planner; what it does not take is dropped, the oldest first."""
        if self.feedback.full():
            self.feedback.get_nowait()
            self.feedback.task_done()  # else the rest would not be watched to its end
        self.feedback.put_nowait(feedback)

    def answered(self, message: Any, *, status: int | None = None) -> ExecutionNews:
        """Keep the robot's answer; return what of it goes through the gate: its words."""
        told = told_of(message)
        self.status = status
        self.answer = None if told.texts == (WITHHELD,) else message
        return told

    def end(self, outcome: Outcome, told: ExecutionNews | None = None) -> None:
        """Note how it ended; the first word counts."""
        self._took(is_taken=False)
        self.handle.end(outcome, told)
        self.over.set()

    def _took(self, *, is_taken: bool) -> None:
        if not self.taken.done():
            self.taken.set_result(is_taken)


class Releases:
    """The last of them, by ticket."""

    def __init__(self) -> None:
        self._known: OrderedDict[str, Release] = OrderedDict()
        self._waiting: dict[str, Callable[[Release], None]] = {}

    def began(self, ticket: Digest, release: Release) -> None:
        """Take in what the controller's end begins."""
        self._known[ticket] = release
        while len(self._known) > _MOST_KEPT:
            self._known.popitem(last=False)
        waiting = self._waiting.pop(ticket, None)
        if waiting is not None:
            waiting(release)

    def when(self, ticket: str, call: Callable[[Release], None]) -> None:
        """Call once with the release of a ticket that the planner's end received."""
        known = self._known.get(ticket)
        if known is not None:
            call(known)
        else:
            self._waiting[ticket] = call

    def forget(self, ticket: str) -> None:
        """End the calls for this ticket."""
        self._waiting.pop(ticket, None)


def told_of(message: Any) -> ExecutionNews:
    """Return what of an answer goes through the gate; the message itself stays in the process."""
    texts = texts_of(message)
    told = ExecutionNews(json.dumps({"texts": texts}).encode(), texts)
    return (
        told
        if fits(told)
        else ExecutionNews(json.dumps({"texts": [WITHHELD]}).encode(), (WITHHELD,))
    )
