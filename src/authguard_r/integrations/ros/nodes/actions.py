# SPDX-License-Identifier: Apache-2.0
"""The planners' side of an action: its server under the public name.

A goal is a proposal. What the gate releases is sent to the robot's own server, whose yes or no is
the planner's answer; its feedback, its result and its status are the robot's too.
Spec page: docs/spec/ros.md#goals
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any

from action_msgs.msg import GoalStatus
from msgspec import Struct
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup

from authguard_r.client.link import ProcessLog
from authguard_r.core.errors import AuthGuardError, MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.integrations.ros.calls import FORMS, call_of
from authguard_r.integrations.ros.map import Mediated
from authguard_r.integrations.ros.nodes.loop import Spinner
from authguard_r.integrations.ros.nodes.process import RCLError
from authguard_r.integrations.ros.nodes.proposals import PlannerProposals, code_of
from authguard_r.integrations.ros.nodes.releases import Release
from authguard_r.integrations.ros.nodes.values import plain_of, texts_of
from authguard_r.integrations.tools.planner import CallOutcome, LostError
from authguard_r.normalize.dialects import Call

#: A result is kept for its planner for so long, in seconds.
RESULT_S = 2
#: A planner that is there takes note of its accepted goal within this, in seconds.
BIND_S = 2.0
#: How long an accepted goal is kept after the last client that could ask for its result has gone,
#: in seconds.
GONE_S = 2.0
#: Who asks for a goal's result before it is there is kept until then, up to so many: of answers
#: that leave together DDS keeps ten.
MOST_ASKERS = 8
#: Between two looks whether a client is there, in seconds.
_LOOK_S = 0.25
#: An action whose gate is lost is stopped by its controller; its end is waited for so long.
_LOST_S = 10.0
#: Texts of one goal's feedback that are not noted again.
_MOST_NOTED = 1_000


class Public(Struct, frozen=True, kw_only=True):
    """What every server of the planners' has.

    Args:
        spinner: the node, and its thread.
        group: every callback of the node's.
        proposals: asks the gate.
        log: says what happens.
    """

    spinner: Spinner
    group: ReentrantCallbackGroup
    proposals: PlannerProposals
    log: ProcessLog


def read_call(item: Mediated, message: Any) -> Call | MalformedError:
    """Return the call that a planner's message is, or why it is not a call.

    It is read on the thread of ROS: the event loop, which holds the robot, waits for no list.

    Args:
        item: what the map says of it.
        message: untrusted.
    """
    try:
        return call_of(item, plain_of(message, where=FORMS[item.kind].body, is_asked=True))
    except MalformedError as error:
        return error


class _GoalServer(ActionServer):  # type: ignore[misc]
    """An action server that executes nothing: a goal is over when `finish` says so."""

    def __init__(
        self,
        *args: Any,
        asked: Callable[[Any], None],
        bound: Callable[[Any], None],
        **more: Any,
    ) -> None:
        self._asked, self._bound = asked, bound
        self._answers: dict[int, GoalResponse] = {}  # by the goal's own id
        self._deciding: set[bytes] = set()  # ids of goals that are not answered yet
        self._askers: Counter[bytes] = Counter()  # who waits for the result of a goal
        super().__init__(
            *args,
            execute_callback=lambda _: None,
            goal_callback=lambda goal: self._answers.pop(id(goal)),
            **more,
        )

    async def _execute_goal_request(self, request_header_and_message: Any) -> None:
        """Have a goal decided; nothing waits on the thread for the answer.

        A goal with the id of another one is rejected before it is decided: else the robot would do
        what its planner takes for rejected.
        """
        taken, goal = request_header_and_message, request_header_and_message[1]
        key = bytes(goal.goal_id.uuid)
        if key in self._deciding or key in self._goal_handles:
            await self._answer(taken, GoalResponse.REJECT)
            return
        self._deciding.add(key)
        self._asked(taken)

    async def answer(self, taken: Any, response: GoalResponse) -> None:
        """Go on with a goal that was decided, as `rclpy` does with one whose answer is known."""
        await self._answer(taken, response)
        self._deciding.discard(bytes(taken[1].goal_id.uuid))

    async def _answer(self, taken: Any, response: GoalResponse) -> None:
        goal = taken[1].goal
        self._answers[id(goal)] = response
        await super()._execute_goal_request(taken)
        self._answers.pop(id(goal), None)  # a goal whose id was taken has no request

    async def _execute_get_result_request(self, request_header_and_message: Any) -> None:
        """Send a goal's result, now or later; of too many clients the first ones get it."""
        key = bytes(request_header_and_message[1].goal_id.uuid)
        if key in self._result_futures and not self._result_futures[key].done():
            if self._askers[key] >= MOST_ASKERS:
                return
            self._askers[key] += 1
        with suppress(RCLError):  # the client does not take the answer
            await super()._execute_get_result_request(request_header_and_message)

    async def _execute_expire_goals(self, expired_goals: Any) -> None:
        for goal in expired_goals:
            self._askers.pop(bytes(goal.goal_id.uuid), None)
        await super()._execute_expire_goals(expired_goals)

    def notify_execute(self, goal_handle: Any, execute_callback: Any) -> None:  # noqa: ARG002
        """Take a planner's handle of its goal; nothing waits on the thread for the end."""
        self._bound(goal_handle)

    def finish(self, handle: Any, end: Callable[[Any], Any]) -> None:
        """End a goal with the state and the result that a function gives it."""
        super().notify_execute(handle, end)


class _OpenGoal:
    """One goal of a planner's, until it is over."""

    def __init__(self, goal: Any, read: Call | MalformedError) -> None:
        loop = asyncio.get_running_loop()
        self.goal, self.read = goal, read
        self.taken: asyncio.Future[bool] = loop.create_future()
        self.handle: asyncio.Future[Any] = loop.create_future()
        self.release: Release | None = None

    def answer(self, *, is_taken: bool) -> None:
        """Answer the planner; the first answer counts."""
        if not self.taken.done():
            self.taken.set_result(is_taken)

    def began(self, release: Release) -> None:
        """Take what was released for it: the robot's server answers the planner."""
        self.release = release
        release.taken.add_done_callback(lambda taken: self.answer(is_taken=taken.result()))


class ActionProxyServer:
    """Serves one action to planners.

    Args:
        public: the node.
        key: its name in the map.
        item: what the map says of it.
        kind: the action's class.
    """

    def __init__(self, public: Public, key: str, item: Mediated, kind: Any) -> None:
        self._public, self._key, self._item, self._kind = public, key, item, kind
        self._spinner = public.spinner
        self._unbound: dict[int, _OpenGoal] = {}  # by the goal's own id: `rclpy` hands out the same
        self._running: dict[bytes, _OpenGoal] = {}
        self._attending: asyncio.Task[None] | None = None
        self._server = _GoalServer(
            public.spinner.node,
            kind,
            item.public,
            asked=self._asked,
            bound=partial(self._spinner.soon, self._bound),
            cancel_callback=self._canceled,
            callback_group=public.group,
            result_timeout=RESULT_S,
        )

    @property
    def is_idle(self) -> bool:
        """True while no goal that was accepted waits for its end."""
        return not self._running and not self._unbound

    # on the thread of ROS

    def _asked(self, taken: Any) -> None:
        goal = taken[1].goal
        self._spinner.later(
            partial(self._decided, goal, read_call(self._item, goal)),
            partial(self._spinner.run, self._server.answer, taken),
            otherwise=GoalResponse.REJECT,
            busy=self._busy,
        )

    def _busy(self) -> GoalResponse:
        self._public.log.say("refused", self._key, reason=str(Reason.BUSY))
        return GoalResponse.REJECT

    def _canceled(self, handle: Any) -> CancelResponse:
        """Forward it at once: to stop is never refused."""
        self._spinner.soon(self._cancel, bytes(handle.goal_id.uuid))
        return CancelResponse.ACCEPT

    # in the event loop

    async def _decided(self, goal: Any, read: Call | MalformedError) -> GoalResponse:
        going = _OpenGoal(goal, read)
        self._spinner.begin(self._run(going))
        if not await going.taken:
            return GoalResponse.REJECT
        self._unbound[id(goal)] = going
        asyncio.get_running_loop().call_later(BIND_S, self._left, going)
        return GoalResponse.ACCEPT

    def _bound(self, handle: Any) -> None:
        going = self._unbound.pop(id(handle.request), None)
        if going is None:  # it was called off before its planner got the yes
            self._server.finish(handle, partial(_ended, None, self._kind.Result()))
            return
        self._running[bytes(handle.goal_id.uuid)] = going
        going.handle.set_result(handle)
        if self._attending is None or self._attending.done():
            self._attending = self._spinner.begin(self._attend())

    async def _attend(self) -> None:
        """Call off every goal that runs once no planner of the action has been there for a while.

        The graph says who is there, and a writer of the graph can lie: it ends goals here, and
        never begins or prolongs one.
        """
        loop = asyncio.get_running_loop()
        seen_s = loop.time()
        while self._running:
            if self._spinner.node.count_clients(f"{self._item.public}/_action/get_result"):
                seen_s = loop.time()
            elif loop.time() - seen_s >= GONE_S:
                self._public.log.say("abandoned", self._key, goals=str(len(self._running)))
                for goal in tuple(self._running):
                    self._cancel(goal)
                seen_s = loop.time()
            await asyncio.sleep(_LOOK_S)

    def _left(self, going: _OpenGoal) -> None:
        """Call off a goal whose planner has gone before its answer."""
        self._unbound.pop(id(going.goal), None)
        if not going.handle.done():
            going.handle.cancel()
            if going.release is not None:
                going.release.cancel()

    def _cancel(self, goal: bytes) -> None:
        going = self._running.get(goal)
        if going is not None and going.release is not None:
            going.release.cancel()

    async def _run(self, going: _OpenGoal) -> None:
        """Propose a goal, and see it through to its end."""
        feeding = self._spinner.begin(self._feed(going))
        try:
            try:
                asked = await self._propose(going)
            finally:
                going.answer(is_taken=False)
            if going.taken.result():
                is_noted = asked is not None and bool(asked.results)
                await self._finish(going, feeding, is_noted=is_noted)
            elif asked is not None:
                self._public.log.say("refused", self._key, reason=code_of(asked))
        finally:
            feeding.cancel()

    async def _propose(self, going: _OpenGoal) -> CallOutcome | None:
        """Return the report of a proposal; None when it is unknown, or nothing was decided."""
        proposals, read = self._public.proposals, going.read
        if isinstance(read, MalformedError):
            going.answer(is_taken=False)
            self._say(read)
            await proposals.unreadable(FORMS[self._item.kind].tool, read)
            return None
        try:
            return await proposals.ask(read, began=going.began)
        except LostError as error:
            self._say(error.error)
        except AuthGuardError as error:
            self._say(error)
        return None

    async def _feed(self, going: _OpenGoal) -> None:
        """Hand on what the robot says on its way, once its words have been noted."""
        handle, noted = await asyncio.shield(going.handle), set[str]()
        release = going.release
        if release is None or release.key != self._key:  # rebuilt as another action's goal
            return
        while True:
            feedback = await release.feedback.get()
            try:
                if len(noted) > _MOST_NOTED:
                    noted.clear()
                # numbers say something too: without a word, that there was one is noted
                texts = [text for text in texts_of(feedback) or ("",) if text not in noted]
                await self._public.proposals.note(texts)
                noted.update(texts)
                handle.publish_feedback(feedback)
            except AuthGuardError as error:  # it was not noted: it is not shown
                self._say(error)
            finally:
                release.feedback.task_done()

    async def _finish(
        self, going: _OpenGoal, feeding: asyncio.Task[None], *, is_noted: bool
    ) -> None:
        """Tell the planner how its goal ended, as the robot says it."""
        release = going.release
        if release is None:  # pragma: no cover - taken is what was released
            return
        with suppress(TimeoutError):
            await asyncio.wait_for(release.over.wait(), _LOST_S)
        handle = await asyncio.shield(going.handle)
        if not feeding.done():
            await asyncio.wait({feeding, self._drained(release)}, return_when="FIRST_COMPLETED")
        is_mine = release.key == self._key
        answer = release.answer if is_noted and is_mine else None
        result = self._kind.Result() if answer is None else answer
        self._running.pop(bytes(handle.goal_id.uuid), None)
        self._server.finish(handle, partial(_ended, release.status, result))

    def _drained(self, release: Release) -> asyncio.Task[None]:
        return self._spinner.begin(release.feedback.join())

    def _say(self, error: AuthGuardError) -> None:
        self._public.log.say(
            "refused", self._key, reason=str(error.reason), message=error.message, where=error.where
        )


def _ended(status: int | None, result: Any, handle: Any) -> Any:
    """Give a goal the robot's own state; a cancellation that its planner did not ask is an abort.

    ROS actions have no status for a goal that another client cancelled.
    """
    if status == GoalStatus.STATUS_SUCCEEDED:
        handle.succeed()
    elif status == GoalStatus.STATUS_CANCELED and handle.is_cancel_requested:
        handle.canceled()
    else:
        handle.abort()
    return result
