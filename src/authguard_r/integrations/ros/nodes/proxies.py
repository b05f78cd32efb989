# SPDX-License-Identifier: Apache-2.0
"""The robot's side: what a released action becomes, and how it is stopped.

Each of these is the one client, or the one publisher, of something that moves the robot.
Spec page: docs/spec/ros.md#driving
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any, Protocol

from msgspec import Struct
from rclpy.callback_groups import ReentrantCallbackGroup

from authguard_r.core.errors import MalformedError
from authguard_r.core.standing import Outcome
from authguard_r.integrations.ros.nodes.loop import Spinner
from authguard_r.integrations.ros.nodes.releases import Release
from authguard_r.integrations.ros.nodes.values import plain_of
from authguard_r.integrations.tools.server import ToolAnswer
from authguard_r.normalize.expected import Expected

#: What stops the robot is answered within this, in seconds, or asked again.
STOP_S = 1.5
#: Messages that wait for a reader.
_DEPTH = 10


class RobotProxy(Struct, frozen=True, kw_only=True):
    """What every outlet has.

    Args:
        spinner: the node, and its thread.
        group: every callback of the node's.
        changed: called when something ended.
        astray: called when the robot's motion is unknown: it has to be stopped.
        strange: called with an action's name, and how many goals of it run that were never ours.
        is_alive: says whether the gate's ends look after their body; from any thread.
    """

    spinner: Spinner
    group: ReentrantCallbackGroup
    changed: Callable[[], None]
    astray: Callable[[], None]
    strange: Callable[[str, int], None]
    is_alive: Callable[[], bool]


class DispatchOrder(Struct, frozen=True, kw_only=True):
    """What an outlet is to carry out.

    Args:
        release: where its end is noted.
        message: rebuilt from what was authorized.
        moves: it moves the robot.
        wanted: what stands in its answer once it has done its work.
        duration_ms: of a stream, how long it was released for.
    """

    release: Release
    message: Any
    moves: bool
    wanted: Expected
    duration_ms: int = 0


class ClientProxy(Protocol):
    """Carries out one kind of thing; what moves the robot one at a time."""

    @property
    def kind(self) -> Any:
        """The class of the message that it is given."""
        ...

    @property
    def is_there(self) -> bool:
        """True while the robot's own part of it is there."""
        ...

    def begin(self, order: DispatchOrder) -> None:
        """Begin to carry it out; its robot's part `is_there`.

        Raises:
            ControllerError: it cannot be, and nothing has moved.
        """
        ...

    async def stop(self) -> bool:
        """Stop everything that runs here, of all planners; True once nothing does."""
        ...

    def pass_time(self) -> None:
        """Look at the clock."""
        ...


class ServiceClientProxy:
    """Calls a service.

    Args:
        robot: the node.
        kind: the service's class.
        name: the service that does it.
    """

    def __init__(self, robot: RobotProxy, kind: Any, name: str) -> None:
        self.kind = kind.Request
        self._robot = robot
        self._client = robot.spinner.node.create_client(kind, name, callback_group=robot.group)
        self._orders: dict[Release, DispatchOrder] = {}  # until they are answered
        self._news = asyncio.Event()

    @property
    def is_there(self) -> bool:
        """True while a server serves it."""
        return bool(self._client.service_is_ready())

    def begin(self, order: DispatchOrder) -> None:
        """Call it."""
        self._orders[order.release] = order
        self._robot.spinner.begin(self._carry(order))

    async def _carry(self, order: DispatchOrder) -> None:
        release = order.release
        release.take()
        try:
            ask = self._robot.spinner.ask
            message = await ask(lambda: self._client.call_async(order.message))
        except Exception:  # noqa: BLE001 - whatever it is, nobody knows what became of it
            release.end(Outcome.UNKNOWN)
        else:
            answer = ToolAnswer(is_error=False, structured=fields_of(message))
            told = release.answered(message)
            done = answer.is_done(order.wanted)
            release.end(Outcome.SUCCEEDED if done else Outcome.FAILED, told)
        del self._orders[release]
        self._news.set()
        self._robot.changed()

    async def stop(self) -> bool:
        """Wait for what was called: a service cannot be called off."""
        try:
            async with asyncio.timeout(STOP_S):
                while self._orders:
                    self._news.clear()
                    await self._news.wait()
        except TimeoutError:
            for release in self._orders:
                release.end(Outcome.UNKNOWN)
        return not any(order.moves for order in self._orders.values())

    def pass_time(self) -> None:
        """Do nothing: it takes its time."""


class MessageClientProxy:
    """Publishes one message for each release.

    Args:
        robot: the node.
        kind: the message's class.
        name: the topic that the robot hears.
    """

    def __init__(self, robot: RobotProxy, kind: Any, name: str) -> None:
        self.kind = kind
        self._publisher = robot.spinner.node.create_publisher(
            kind, name, _DEPTH, callback_group=robot.group
        )

    @property
    def is_there(self) -> bool:
        """True while a subscriber hears it."""
        return bool(self._publisher.get_subscription_count() > 0)

    def begin(self, order: DispatchOrder) -> None:
        """Publish it."""
        order.release.take()
        self._publisher.publish(order.message)
        order.release.end(Outcome.SUCCEEDED)

    async def stop(self) -> bool:
        """Return True: what was published is over, and moves nothing."""
        return True

    def pass_time(self) -> None:
        """Do nothing: it takes no time."""


def fields_of(message: Any) -> Any:
    """Return an answer's fields; None when they cannot be read."""
    try:
        return plain_of(message)
    except MalformedError:
        return None
