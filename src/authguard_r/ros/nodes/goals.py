# SPDX-License-Identifier: Apache-2.0
"""The robot's side of an action: sends a released goal, and cancels whatever runs.

It stands when its server says so: a canceled goal runs until its result has come.
Spec page: docs/spec/ros.md#goals
"""

from __future__ import annotations

import asyncio
from functools import partial
from typing import Any

from action_msgs.msg import GoalStatus, GoalStatusArray
from action_msgs.srv import CancelGoal
from rclpy.action import ActionClient
from rclpy.qos import qos_profile_action_status_default

from authguard_r.core.standing import Outcome
from authguard_r.ros.nodes.outlets import STOP_S, Order, Robot, fields_of
from authguard_r.ros.nodes.releases import Release
from authguard_r.tools.server import Answer

#: A server that lives says within this whether it takes a goal, in seconds.
TAKE_S = 2.0
#: A goal that nobody answered for so long, of a server that answers, never arrived, in seconds.
_LOST_S = 5.0
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


class ActionOutlet:
    """Sends goals of one action.

    Args:
        robot: the node.
        kind: the action's class.
        name: the action that does it.
    """

    def __init__(self, robot: Robot, kind: Any, name: str) -> None:
        self.kind = kind.Goal
        self._robot = robot
        node, group = robot.spinner.node, robot.group
        self._client = ActionClient(node, kind, name, callback_group=group)
        self._canceler = node.create_client(
            CancelGoal, f"{name}/_action/cancel_goal", callback_group=group
        )
        self._results = node.create_client(
            kind.Impl.GetResultService, f"{name}/_action/get_result", callback_group=group
        )
        self._ask_result = kind.Impl.GetResultService.Request
        node.create_subscription(
            GoalStatusArray,
            f"{name}/_action/status",
            partial(robot.spinner.soon, self._heard),
            qos_profile_action_status_default,
            callback_group=group,
        )
        self._active: dict[bytes, Any] = {}  # the ids of goals that run, as their server says
        self._news = asyncio.Event()
        self._order: Order | None = None  # until it is over
        self._goal: Any = None
        self._asked_s = 0.0

    @property
    def is_there(self) -> bool:
        """True while somebody serves it."""
        return bool(self._client.server_is_ready())

    def begin(self, order: Order) -> None:
        """Send the goal."""
        self._order, self._goal = order, None
        self._asked_s = asyncio.get_running_loop().time()
        self._robot.spinner.begin(self._attend(order))

    def pass_time(self) -> None:
        """Do nothing: it takes its time."""

    async def stop(self) -> bool:
        """Cancel every goal, and wait until the server has said of each that it is over."""
        if not self._canceler.service_is_ready():
            return self._order is None
        try:
            async with asyncio.timeout(STOP_S):
                call = partial(self._canceler.call_async, CancelGoal.Request())
                said = await self._robot.spinner.ask(call)
                going = dict(self._active)
                going |= {bytes(one.goal_id.uuid): one.goal_id for one in said.goals_canceling}
                if self._goal is not None:
                    going[bytes(self._goal.goal_id.uuid)] = self._goal.goal_id
                await asyncio.gather(*map(self._ended, going.values()))
                while self._order is not None and not self._is_lost():
                    self._news.clear()
                    await self._news.wait()
        except TimeoutError:
            return False
        self._order = self._goal = None
        return True

    async def _ended(self, goal_id: Any) -> None:
        """Return once the server says that a goal is over, or that it knows of none such."""
        request = self._ask_result(goal_id=goal_id)
        said = await self._robot.spinner.ask(partial(self._results.call_async, request))
        self._active.pop(bytes(goal_id.uuid), None)
        if self._goal is not None and goal_id == self._goal.goal_id:
            self._answered(self._goal, said)

    async def _attend(self, order: Order) -> None:
        """Carry it out; what goes wrong here leaves nobody who knows what the robot does."""
        try:
            await self._carry(order)
        except Exception:  # noqa: BLE001 - whatever it is
            order.release.end(Outcome.UNKNOWN)
            self._robot.astray()

    async def _carry(self, order: Order) -> None:
        """Send the goal, and take note of what the server says of it."""
        release, spinner = order.release, self._robot.spinner
        fed = partial(_fed, spinner.soon, release)
        send = partial(self._client.send_goal_async, order.message, feedback_callback=fed)
        asked = spinner.begin(spinner.ask(send))
        done, _ = await asyncio.wait({asked}, timeout=TAKE_S)
        if not done:
            release.end(Outcome.UNKNOWN)
            self._robot.astray()
        goal = await asked
        if not goal.accepted:
            self._over(order, Outcome.NOT_STARTED)
            return
        if not release.runs:  # nobody waits for it any more
            await spinner.ask(goal.cancel_goal_async)
        self._goal = goal
        release.cancel = partial(self._cancel, goal)
        release.take()
        self._answered(goal, await spinner.ask(goal.get_result_async))

    def _answered(self, goal: Any, said: Any) -> None:
        """Take in how a goal ended; the first answer counts."""
        order = self._order
        if order is None or goal is not self._goal:
            return
        outcome = _OUTCOMES.get(said.status, Outcome.UNKNOWN)
        told = order.release.answered(said.result, status=said.status)
        answer = Answer(is_error=False, structured=fields_of(said.result))
        if outcome is Outcome.SUCCEEDED and not answer.is_done(order.wanted):
            outcome = Outcome.FAILED
        order.release.end(outcome, told)
        self._over(order, outcome)

    def _over(self, order: Order, outcome: Outcome) -> None:
        order.release.end(outcome)
        if self._order is order:
            self._order = self._goal = None
        self._news.set()
        self._robot.changed()

    def _cancel(self, goal: Any) -> None:
        self._robot.spinner.begin(self._robot.spinner.ask(goal.cancel_goal_async))

    def _heard(self, message: Any) -> None:
        """Take in what the server says of its goals."""
        self._active = {
            bytes(one.goal_info.goal_id.uuid): one.goal_info.goal_id
            for one in message.status_list
            if one.status in _ACTIVE
        }

    def _is_lost(self) -> bool:
        """True of a goal that a server which answers has never answered."""
        waited_s = asyncio.get_running_loop().time() - self._asked_s
        return self._goal is None and waited_s > _LOST_S


def _fed(soon: Any, release: Release, message: Any) -> None:
    soon(release.fed, message.feedback)
