# SPDX-License-Identifier: Apache-2.0
"""The planners' side of services and of single messages, under their public names.

A service that can say that it failed says so of a refusal, with the code. One that cannot is not
answered: the waiting caller learns nothing, which is better than an answer that the robot never
gave. Spec page: docs/spec/ros.md#services
"""

from __future__ import annotations

import time
from contextlib import suppress
from functools import partial
from typing import Any

from authguard_r.core.errors import AuthGuardError, MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Outcome
from authguard_r.integrations.ros.calls import FORMS
from authguard_r.integrations.ros.map import Mediated
from authguard_r.integrations.ros.nodes.actions import Public, read_call
from authguard_r.integrations.ros.nodes.process import RCLError
from authguard_r.integrations.ros.nodes.proposals import code_of
from authguard_r.integrations.ros.nodes.releases import Release
from authguard_r.integrations.tools.planner import CallOutcome, LostError
from authguard_r.normalize.dialects import Call

#: To send an answer takes so long where DDS waits for a client that does not take it, in seconds.
DEAF_S = 0.05
_DEPTH = 10
#: In the place of an answer.
_SILENCE = object()


class ServiceProxyServer:
    """Serves one service to planners.

    Args:
        public: the node.
        key: its name in the map.
        item: what the map says of it.
        kind: the service's class.
    """

    def __init__(self, public: Public, key: str, item: Mediated, kind: Any) -> None:
        self._public, self._key, self._item, self._kind = public, key, item, kind
        service = public.spinner.node.create_service(
            kind, item.public, lambda asked, _: read_call(item, asked), callback_group=public.group
        )
        self._is_deaf = False  # a planner of it did not take an answer
        self._send = service.send_response
        service.send_response = self._read  # what `rclpy` calls with what `read_call` returned

    def _read(self, read: Call | MalformedError, header: Any) -> None:
        """Have it decided, on the thread of ROS; the answer is sent when there is one."""
        self._public.spinner.later(
            partial(self._answered, read),
            partial(self._answer, header),
            otherwise=_SILENCE,
            busy=partial(self._refusal, Reason.BUSY),
        )

    def _answer(self, header: Any, response: Any) -> None:
        if response is _SILENCE:
            return
        if self._is_deaf:  # each answer to such a planner delays its sender
            self._public.spinner.run(self._told, header, response)
        else:
            self._told(header, response)

    def _told(self, header: Any, response: Any) -> None:
        begun = time.monotonic()
        with suppress(RCLError):  # a newer `rclpy` only warns
            self._send(response, header)
        if time.monotonic() - begun >= DEAF_S:
            self._is_deaf = True
            self._public.log.say("unheard", self._key)

    async def _answered(self, read: Call | MalformedError) -> Any:
        found: list[Release] = []
        code, asked = await propose(self._public, self._item, read, found)
        if asked is None or not asked.results or not found:
            return self._refusal(code)
        answer = found[0].answer
        if isinstance(answer, self._kind.Response):
            return answer
        # it is too long to be sent, or another type's: a way of the binding that comes first did it
        why = code or (Reason.INPUT_TOO_LARGE if answer is None else "")
        return self._said(why, is_done=asked.execution == Outcome.SUCCEEDED)

    def _refusal(self, code: str) -> Any:
        """Return an answer that says no, and why."""
        self._public.log.say("refused", self._key, reason=str(code))
        return self._said(code, is_done=False)

    def _said(self, code: str, *, is_done: bool) -> Any:
        """Return an answer of the gate's own; silence where the type has no word for it."""
        fields = self._kind.Response.get_fields_and_field_types()
        if fields.get("success") != "boolean" or fields.get("message") != "string":
            return _SILENCE
        response = self._kind.Response()
        response.success, response.message = is_done, str(code)
        return response


class MessageProxyServer:
    """Hears one topic of planners', each message of which is a proposal.

    Args:
        public: the node.
        key: its name in the map.
        item: what the map says of it.
        kind: the message's class.
    """

    def __init__(self, public: Public, key: str, item: Mediated, kind: Any) -> None:
        self._public, self._key, self._item = public, key, item
        public.spinner.node.create_subscription(
            kind, item.public, self._came, _DEPTH, callback_group=public.group
        )

    def _came(self, message: Any) -> None:
        """Take a message on the thread of ROS; no caller waits for an answer."""
        propose = partial(self._propose, read_call(self._item, message))
        self._public.spinner.later(propose, lambda _: None, otherwise=None, busy=self._busy)

    def _busy(self) -> None:
        self._public.log.say("refused", self._key, reason=str(Reason.BUSY))

    async def _propose(self, read: Call | MalformedError) -> None:
        code, asked = await propose(self._public, self._item, read, [])
        if asked is None or asked.execution != "succeeded":
            self._public.log.say("refused", self._key, reason=str(code))


async def propose(
    public: Public, item: Mediated, read: Call | MalformedError, found: list[Release]
) -> tuple[str, CallOutcome | None]:
    """Propose what a planner's message is; return why it did not succeed, and its report.

    Args:
        public: the node.
        item: what the map says of it.
        read: the call that it is, untrusted, or why it is not a call.
        found: takes what was released for it.
    """
    if isinstance(read, MalformedError):
        public.spinner.begin(public.proposals.unreadable(FORMS[item.kind].tool, read))
        return str(read.reason), None
    try:
        asked = await public.proposals.ask(read, began=found.append)
    except LostError as error:
        return str(error.error.reason), None
    except AuthGuardError as error:
        return str(error.reason), None
    return code_of(asked), asked
