# SPDX-License-Identifier: Apache-2.0
"""The node as ROS manages one: unconfigured, inactive, active; planners see it while it is active.

Its states live on a node and a thread of their own, so that a transition can wait for the robot
while the others turn. Each transition is carried out in the event loop, one at a time. Only a
process that the map names has the right to ask for one; no parameter changes what the node serves.
Spec page: docs/spec/ros.md#lifecycle
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from enum import StrEnum
from typing import NamedTuple

from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.context import Context
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter

from authguard_r.client.link import ProcessLog
from authguard_r.core.errors import AuthGuardError
from authguard_r.integrations.ros.nodes.mediator import (
    NAMESPACE,
    Mediator,
    MediatorTarget,
    configured,
    serving,
)
from authguard_r.integrations.ros.rights import GATE_NODE
from authguard_r.integrations.tools.endpoints import first_of

NAME = GATE_NODE.rpartition("/")[2]


class LifecycleStep(StrEnum):
    """A transition."""

    CONFIGURE = "configure"
    ACTIVATE = "activate"
    DEACTIVATE = "deactivate"
    CLEANUP = "cleanup"
    SHUTDOWN = "shutdown"


class Managed(LifecycleNode):  # type: ignore[misc]
    """The node that a manager sees.

    Args:
        context: the process's.
        facts: parameters that say what runs here; they are read-only.
        carry: carries out a transition, and says whether it was; called on the node's thread.
    """

    def __init__(
        self, context: Context, facts: Mapping[str, str], carry: Callable[[LifecycleStep], bool]
    ) -> None:
        super().__init__(
            NAME,
            namespace=NAMESPACE,
            context=context,
            use_global_arguments=False,
            enable_rosout=False,
        )
        self._carry = carry
        for name, value in facts.items():
            self.declare_parameter(name, value, ParameterDescriptor(read_only=True))
        self.add_on_set_parameters_callback(_locked)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:  # noqa: ARG002
        """Check everything, reach the robot, and stop what runs there."""
        return self._said(LifecycleStep.CONFIGURE)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Serve planners."""
        super().on_activate(state)
        return self._said(LifecycleStep.ACTIVATE)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop the robot, tell planners how that ended, and serve them no more."""
        super().on_deactivate(state)
        return self._said(LifecycleStep.DEACTIVATE)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:  # noqa: ARG002
        """Let go of the robot and of the gate."""
        return self._said(LifecycleStep.CLEANUP)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:  # noqa: ARG002
        """Stop the robot, and end."""
        return self._said(LifecycleStep.SHUTDOWN)

    def _said(self, step: LifecycleStep) -> TransitionCallbackReturn:
        done = self._carry(step)
        return TransitionCallbackReturn.SUCCESS if done else TransitionCallbackReturn.FAILURE


class _AwaitedTransition(NamedTuple):
    """A transition with a waiting caller."""

    step: LifecycleStep
    done: asyncio.Future[bool]

    def answer(self, *, done: bool) -> None:
        if not self.done.done():
            self.done.set_result(done)


class States:
    """Carries out transitions, in one task of the event loop; ROS says which may come.

    Args:
        place: reads where and what, anew each time that it is configured; it checks everything
            that can be checked without ROS.
        context: the process's.
        log: says what happens.
    """

    def __init__(
        self, place: Callable[[], MediatorTarget], context: Context, log: ProcessLog
    ) -> None:
        self._place, self._context, self._log = place, context, log
        self._loop = asyncio.get_running_loop()
        self._asked: asyncio.Queue[_AwaitedTransition] = asyncio.Queue()
        self._waiting: set[_AwaitedTransition] = set()
        self._is_over = False
        #: why it is not configured, if that was tried
        self.fault: AuthGuardError | None = None
        #: what of the robot was not there when it was configured
        self.missing: tuple[str, ...] = ()

    def carry(self, step: LifecycleStep) -> bool:
        """Return whether a transition was carried out; from another thread than the loop's."""
        return asyncio.run_coroutine_threadsafe(self._carried(step), self._loop).result()

    async def _carried(self, step: LifecycleStep) -> bool:
        asked = _AwaitedTransition(step, self._loop.create_future())
        if self._is_over:
            return False
        self._waiting.add(asked)
        self._asked.put_nowait(asked)
        try:
            return await asked.done
        finally:
            self._waiting.discard(asked)

    async def live(self) -> None:
        """Carry out transitions until it is shut down.

        Raises:
            AuthGuardError: it was configured, and cannot go on.
        """
        try:
            while True:
                asked = await self._asked.get()
                ended = (
                    asked if asked.step is LifecycleStep.SHUTDOWN else await self._configure(asked)
                )
                if ended is not None:
                    ended.answer(done=True)
                    if ended.step is LifecycleStep.SHUTDOWN:
                        return
        finally:
            self._is_over = True
            for asked in self._waiting:  # the thread that asked waits, and no other answers
                asked.answer(done=False)

    async def _configure(self, asked: _AwaitedTransition) -> _AwaitedTransition | None:
        """Live configured; return what ended that, None when it was not configured."""
        try:
            async with configured(self._place(), self._context, self._log) as mediator:
                self.fault, self.missing = None, mediator.body.missing
                asked.answer(done=True)
                return await self._inactive(mediator)
        except (AuthGuardError, BaseExceptionGroup) as error:
            fault = error if isinstance(error, AuthGuardError) else first_of(error)
            if asked.done.done() or not isinstance(fault, AuthGuardError):
                raise
            self.fault = fault
            self._log.fault("not configured", fault)
            asked.answer(done=False)
            return None

    async def _inactive(self, mediator: Mediator) -> _AwaitedTransition:
        """Live configured and not served; return what ended that: a cleanup or a shutdown."""
        while True:
            asked = await self._asked.get()
            if asked.step is not LifecycleStep.ACTIVATE:
                return asked
            async with serving(mediator, self._context):
                asked.answer(done=True)
                ended = await self._asked.get()
            if ended.step is LifecycleStep.SHUTDOWN:
                return ended
            ended.answer(done=True)


def _locked(parameters: list[Parameter]) -> SetParametersResult:
    """Refuse every change: what the node serves is signed, or in its map."""
    names = ", ".join(f"`{one.name}`" for one in parameters)
    return SetParametersResult(successful=False, reason=f"{names}: nothing can be set here")
