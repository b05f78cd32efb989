# SPDX-License-Identifier: Apache-2.0
"""What carries out calls: another process, or functions of this one.

What it says of its own answer decides nothing; every word of it is for the ledger of what the
planner has seen. Spec page: docs/spec/adapters.md#driving
"""

from __future__ import annotations

from typing import Any, Protocol

import msgspec
from msgspec import Struct

from authguard_r.client.controller import ExecutionNews
from authguard_r.core.identifiers import Digest
from authguard_r.normalize.expected import TEXT, AnswerMatch, Constant, Expected, matches, same
from authguard_r.wire.messages import BOUND, Kind, Result

#: Longest answer that passes, in bytes; base64 makes a frame of it that the gate reads.
MAX_ANSWER = 700_000
#: Most words of an answer that are looked through for the ledger, in characters.
MAX_TEXT = 120_000
#: As long as any ticket.
_TICKET = Digest("t" * 43)
WITHHELD = "the answer was too long and was withheld"


class CallError(Exception):
    """A call without an answer: its outcome is unknown, or it was never sent.

    Args:
        message: what happened.
        sent: the call may have been carried out.
    """

    def __init__(self, message: str, *, sent: bool) -> None:
        super().__init__(message)
        self.message = message
        self.sent = sent


class ToolAnswer(Struct, frozen=True, kw_only=True):
    """What came of a call.

    Args:
        is_error: it says of itself that it has failed.
        structured: its fields, by name; None when it has none.
        text: its words, one item after the other.
        told: what the planner sees of it.
    """

    is_error: bool
    structured: Any = None
    text: str = ""
    told: ExecutionNews | None = None

    def is_done(self, expected: Expected) -> bool:
        """True when it says that the tool has done its work, and nowhere that it has not."""
        if self.is_error or any(self._holds(*item) for item in expected.fails.items()):
            return False
        return all(self._holds(*item) for item in expected.succeeds.items())

    def _holds(self, path: str, wanted: Constant | AnswerMatch) -> bool:
        value = self._at(path)
        return matches(value, wanted) if isinstance(wanted, AnswerMatch) else same(value, wanted)

    def _at(self, path: str) -> Any:
        if path == TEXT:
            return self.text
        value = self.structured
        for name in path.split("."):
            if not isinstance(value, dict) or name not in value:
                return None
            value = value[name]
        return value


class ToolServer(Protocol):
    """Carries out calls, one at a time but for those that stop the robot."""

    @property
    def ready(self) -> bool:
        """True while a call could be carried out."""
        ...

    async def call(
        self,
        tool: str,
        arguments: dict[str, Any],
        within_s: float,
        *,
        ticket: Digest | None = None,
    ) -> ToolAnswer:
        """Carry out a call; canceled, it is called off as far as that can be done.

        Args:
            tool: its name in the binding.
            arguments: rebuilt from what was authorized.
            within_s: longest time to wait.
            ticket: of the release that it is made for; None: it stops the robot.

        Raises:
            CallError: no answer came.
        """
        ...


def fits(told: ExecutionNews) -> bool:
    """True of an answer that passes through the gate."""
    if len(told.content) > MAX_ANSWER or sum(map(len, told.texts)) > MAX_TEXT:
        return False
    result = Result(ticket=_TICKET, content=told.content, texts=told.texts)
    return len(msgspec.json.encode(result)) <= BOUND[Kind.RESULT]
