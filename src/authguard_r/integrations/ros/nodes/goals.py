# SPDX-License-Identifier: Apache-2.0
"""The robot's side of an action: sends a released goal, and cancels every running one.

An action is three services and two topics, and is used as such here: `rclpy.action.ActionClient`
loses an answer that comes while another thread still sends the question. It stands when its server
says so: a canceled goal runs until its result has come.
Spec page: docs/spec/ros.md#goals
"""

from __future__ import annotations

import asyncio
from collections import deque
from functools import partial
from typing import Any
from uuid import uuid4

from action_msgs.msg import GoalStatus, GoalStatusArray
from action_msgs.srv import CancelGoal
from rclpy.qos import QoSProfile, qos_profile_action_status_default
from unique_identifier_msgs.msg import UUID

from authguard_r.core.standing import Outcome
from authguard_r.integrations.ros.nodes.proxies import STOP_S, DispatchOrder, RobotProxy, fields_of
from authguard_r.integrations.tools.server import ToolAnswer

#: A server that lives says within this whether it takes a goal, in seconds.
TAKE_S = 2.0
#: A server that the graph does not know of, and that is there, answers within this, in seconds.
UNSEEN_S = 0.3
#: A goal without an answer for this long, of a server that answers, never arrived, in seconds.
_LOST_S = 5.0
#: Between two looks whether the server is there, in seconds.
_LOOK_S = 0.1
#: Goals that were ours, whose server may say a while longer that they run.
_MOST_OWN = 256
_ACTIVE = {
    GoalStatus.STATUS_ACCEPTED,
    GoalStatus.STATUS_EXECUTING,
    GoalStatus.STATUS_CANCELING,
}
_OUTCOMES = {
    GoalStatus.STATUS_SUCCEEDED: Outcome.SUCCEEDED,
    GoalStatus.STATUS_CANCELED: Outcome.ABORTED,
    GoalStatus.STATUS_ABORTED: Outcome.FAILED,
}


class _Goal:
    """A goal of ours, until it is over."""

    def __init__(self, order: DispatchOrder) -> None:
        self.order = order
        self.id = UUID(uuid=list(uuid4().bytes))
        self.asked_s = asyncio.get_running_loop().time()
        self.is_taken = False

    @property
    def is_lost(self) -> bool:
        """True of one that a server which answers has never answered."""
        waited_s = asyncio.get_running_loop().time() - self.asked_s
        return not self.is_taken and waited_s > _LOST_S


class ActionClientProxy:
    """Sends goals of one action.

    Args:
        robot: the node.
        kind: the action's class.
        name: the action that does it.
    """

    def __init__(self, robot: RobotProxy, kind: Any, name: str) -> None:
        self.kind = kind.Goal
        self._robot = robot
        self._impl, self._name = kind.Impl, name
        node, group, hidden = robot.spinner.node, robot.group, f"{name}/_action"
        self._sender, self._canceler, self._asker = (
            node.create_client(service, f"{hidden}/{what}", callback_group=group)
            for service, what in (
                (kind.Impl.SendGoalService, "send_goal"),
                (CancelGoal, "cancel_goal"),
                (kind.Impl.GetResultService, "get_result"),
            )
        )
        self._heard = [
            node.create_subscription(
                message,
                f"{hidden}/{what}",
                partial(robot.spinner.soon, heard),
                profile,
                callback_group=group,
            )
            for message, what, heard, profile in (
                (kind.Impl.FeedbackMessage, "feedback", self._fed, QoSProfile(depth=10)),
                (GoalStatusArray, "status", self._told, qos_profile_action_status_default),
            )
        ]
        self._active: dict[bytes, Any] = {}  # the ids of goals that run, as their server says
        self._news = asyncio.Event()
        self._goals: dict[bytes, _Goal] = {}
        self._own: deque[bytes] = deque(maxlen=_MOST_OWN)  # the last ids that were sent from here
        self._stopping = 0
        self._is_settled = True  # its maker stops it before anything begins
        self._settling: asyncio.Task[None] | None = None
        self._looked_s = 0.0

    @property
    def is_there(self) -> bool:
        """True while a server serves it completely, and runs no goal that is unknown here."""
        clients = (self._sender, self._canceler, self._asker)
        return (
            self._is_settled
            and all(client.service_is_ready() for client in clients)
            and all(topic.get_publisher_count() > 0 for topic in self._heard)
        )

    @property
    def _runs_unseen(self) -> bool:
        """True while a server there says that goals run, though the rest of it is not seen."""
        return bool(self._active) and self._heard[-1].get_publisher_count() > 0

    def begin(self, order: DispatchOrder) -> None:
        """Send the goal."""
        goal = _Goal(order)
        self._goals[bytes(goal.id.uuid)] = goal
        self._own.append(bytes(goal.id.uuid))
        self._robot.spinner.begin(self._drive(goal))

    def pass_time(self) -> None:
        """Look whether the server was away: what it ran before is unknown when it is back."""
        now_s = asyncio.get_running_loop().time()
        if now_s - self._looked_s < _LOOK_S:
            return
        self._looked_s = now_s
        if not self._canceler.service_is_ready():
            self._is_settled = False
        elif not self._is_settled and (self._settling is None or self._settling.done()):
            self._settling = self._robot.spinner.begin(self._settle())

    async def _settle(self) -> None:
        """Cancel what a server runs that has just come, or come back."""
        try:
            is_over = await self.stop()
        except Exception:  # noqa: BLE001 - whatever it is, nobody knows what the server does
            is_over = False
        if not is_over:
            self._robot.astray()

    async def stop(self) -> bool:
        """Cancel every goal, and wait until the server has said of each that it is over.

        It is asked whether or not the graph knows of it: a writer of the graph could hide it there.
        One that is not there has nothing to say, and of ours it runs nothing.
        """
        is_unseen = not self._canceler.service_is_ready()
        self._stopping += 1
        try:
            async with asyncio.timeout(UNSEEN_S if is_unseen else STOP_S) as patience:
                said = await self._ask(self._canceler, CancelGoal.Request())
                if is_unseen:
                    is_unseen = False
                    patience.reschedule(asyncio.get_running_loop().time() + STOP_S)
                going = dict(self._active)
                going |= {bytes(one.goal_id.uuid): one.goal_id for one in said.goals_canceling}
                going |= {key: goal.id for key, goal in self._goals.items() if goal.is_taken}
                await asyncio.gather(*map(self._ended, going.values()))
                while not all(goal.is_lost for goal in self._goals.values()):
                    self._news.clear()
                    await self._news.wait()
        except TimeoutError:
            return is_unseen and not self._goals and not self._runs_unseen
        finally:
            self._stopping -= 1
        self._goals.clear()
        self._is_settled = True
        return True

    async def _drive(self, goal: _Goal) -> None:
        """Carry it out; after a fault here the robot's motion is unknown."""
        try:
            await self._carry(goal)
        except Exception:  # noqa: BLE001 - whatever it is
            goal.order.release.end(Outcome.UNKNOWN)
            self._robot.astray()

    async def _carry(self, goal: _Goal) -> None:
        """Send the goal, and take note of what the server says of it."""
        release = goal.order.release
        request = self._impl.SendGoalService.Request(goal_id=goal.id, goal=goal.order.message)
        asked = self._robot.spinner.begin(self._ask(self._sender, request))
        done, _ = await asyncio.wait({asked}, timeout=TAKE_S)
        if not done:
            release.end(Outcome.UNKNOWN)
            self._robot.astray()
        if not (await asked).accepted:
            self._over(goal, Outcome.NOT_STARTED)
            return
        release.cancel = partial(self._cancel, goal.id)
        if self._stopping or not release.runs:  # it came too late to be canceled with the rest
            release.cancel()
        goal.is_taken = True
        release.take()
        await self._ended(goal.id)

    async def _ended(self, goal_id: Any) -> None:
        """Return once the server says that a goal is over, or that it knows of none such."""
        said = await self._ask(self._asker, self._impl.GetResultService.Request(goal_id=goal_id))
        key = bytes(goal_id.uuid)
        self._active.pop(key, None)
        goal = self._goals.get(key)
        if goal is None:  # the first answer counts
            return
        release = goal.order.release
        outcome = _OUTCOMES.get(said.status, Outcome.UNKNOWN)
        told = release.answered(said.result, status=said.status)
        answer = ToolAnswer(is_error=False, structured=fields_of(said.result))
        if outcome is Outcome.SUCCEEDED and not answer.is_done(goal.order.wanted):
            outcome = Outcome.FAILED
        release.end(outcome, told)
        self._over(goal, outcome)

    def _over(self, goal: _Goal, outcome: Outcome) -> None:
        goal.order.release.end(outcome)
        self._goals.pop(bytes(goal.id.uuid), None)
        self._news.set()
        self._robot.changed()

    def _cancel(self, goal: Any) -> None:
        request = CancelGoal.Request()
        request.goal_info.goal_id = goal
        self._robot.spinner.begin(self._ask(self._canceler, request))

    async def _ask(self, client: Any, request: Any) -> Any:
        asked = client.call_async(request)
        try:
            return await self._robot.spinner.ask(lambda: asked)
        finally:  # no caller waits for it any more
            client.remove_pending_request(asked)

    def _fed(self, message: Any) -> None:
        """Take in how a goal of ours goes; the first word may come before its acceptance."""
        goal = self._goals.get(bytes(message.goal_id.uuid))
        if goal is not None:
            goal.order.release.fed(message.feedback)

    def _told(self, message: Any) -> None:
        """Take in what the server says of its goals; a goal without a release is cancelled."""
        self._active = {
            bytes(one.goal_info.goal_id.uuid): one.goal_info.goal_id
            for one in message.status_list
            if one.status in _ACTIVE
        }
        strange = self._active.keys() - self._own
        if strange and self._is_settled and not self._stopping:
            self._robot.strange(self._name, len(strange))
