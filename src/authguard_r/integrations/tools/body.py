# SPDX-License-Identifier: Apache-2.0
"""What moves behind calls of tools, as a controller's body (`client.controller.Body`).

A released action is rebuilt into the one call that it is, and that call is made once. The binding
says how to read whether it did its work; a call without an answer ends `unknown`. Spec page:
docs/spec/adapters.md#driving
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Protocol

from msgspec import Struct

from authguard_r.client.controller import ExecutionNews
from authguard_r.client.link import ProcessLog, mono_ms
from authguard_r.core.action import Action
from authguard_r.core.errors import ControllerError, MalformedError
from authguard_r.core.identifiers import Digest, RobotId
from authguard_r.core.standing import Outcome, Spend
from authguard_r.integrations.tools.server import CallError, ToolAnswer, ToolServer
from authguard_r.normalize import Binder
from authguard_r.normalize.dialects import Call
from authguard_r.normalize.expected import Expected
from authguard_r.normalize.rebuild import call_bytes
from authguard_r.site.model import ActionModel, Site

#: Longest time that a call may take, in seconds; the lease ends it before.
LONGEST_S = 3_600.0
#: A call that stops the robot is answered within this, in seconds.
STOP_S = 1.5
#: Most calls that run beside another.
MOST_BESIDE = 4
#: Between two tries to stop it, and between two looks at one, in seconds.
AGAIN_S, _LOOK_S = 1.0, 0.01


class ToolGoal:
    """One call while it runs (`core.ports.Flight`)."""

    def __init__(self, kind: ActionModel) -> None:
        self._kind = kind
        self._begun_ms = mono_ms()
        self._ended_ms = self._begun_ms
        self._outcome: Outcome | None = None
        self._told: ExecutionNews | None = None

    @property
    def moves(self) -> bool:
        """It moves the robot: a stop needs a command."""
        return self._kind.moves

    def outcome(self) -> Outcome | None:
        """Return how it ended, or None while it runs."""
        return self._outcome

    def used(self) -> Spend:
        """Return what it has used: the whole time that the call took."""
        took = (mono_ms() if self._outcome is None else self._ended_ms) - self._begun_ms
        told = 0 if self._told is None else len(self._told.content)
        return Spend(
            motion_ms=took if self._kind.moves else 0,
            wait_ms=took if self._kind.waits else 0,
            recorded_bytes=told if self._kind.records else 0,
        )

    def told(self) -> ExecutionNews | None:
        """Return what it brought to light."""
        return self._told

    def end(self, outcome: Outcome, told: ExecutionNews | None = None) -> None:
        """Note how it ended; the first word counts."""
        if self._outcome is None:
            self._outcome, self._told, self._ended_ms = outcome, told, mono_ms()


class Rebuilds(Protocol):
    """Says what an action is called (`normalize.rebuild.Rebuilder`)."""

    def rebuild(self, action: Action) -> Call:
        """Return the exact call that carries it out.

        Raises:
            MalformedError: there is none of the name.
        """
        ...


class ToolDrivers(Struct, frozen=True, kw_only=True):
    """What a body drives with.

    Args:
        site: its words.
        binder: what calls mean.
        rebuilder: what actions are called.
        stops: calls that stop the robot, in order; empty: it is unknown whether it stands.
    """

    site: Site
    binder: Binder
    rebuilder: Rebuilds
    stops: tuple[Call, ...] = ()


class ToolBody:
    """A robot behind calls of tools.

    Args:
        rid: which.
        server: carries out the calls.
        means: what it is driven with.
        changed: called when something ended.
        log: says what failed.
    """

    sampled: frozenset[str] = frozenset()
    obeys = True
    late_ms = 0

    def __init__(
        self,
        rid: RobotId,
        server: ToolServer,
        means: ToolDrivers,
        changed: Callable[[], None],
        log: ProcessLog,
    ) -> None:
        self.rid = rid
        self._log = log
        self._server = server
        self._means = means
        self._changed = changed
        self._handle: ToolGoal | None = None
        self._is_told = False  # it had to move, and no answer says that it stands
        self._was_told = bool(means.stops)  # perhaps by an earlier process
        self._is_stopping = False
        self._is_over = False
        self._task: asyncio.Task[None] | None = None
        self._beside: dict[asyncio.Task[None], ToolGoal] = {}
        self._made_calls: dict[Digest, Call] = {}

    def call_of(self, ticket: str | None) -> Call | None:
        """Return the call that was made for a release, of the last few; else None."""
        return None if ticket is None else self._made_calls.get(Digest(ticket))

    @property
    def stands(self) -> bool:
        """True while it did not have to move, or an answer says that it stands."""
        return not (self._is_told or self._was_told)

    def has_room(self, action: Action) -> bool:
        """Return True while there is room: one call, and some `beside` it, as the site says."""
        if self._is_beside(action):
            return len(self._beside) < MOST_BESIDE
        return not self._runs()

    def _is_beside(self, action: Action) -> bool:
        kind = self._means.site.vocabulary[action.type]
        return kind.beside and not kind.moves

    def begin(self, action: Action, ticket: Digest) -> ToolGoal:
        """Make the call.

        Raises:
            ControllerError: no tool carries the action, the server is not there, or the robot is
                still being stopped.
        """
        if self._is_over or not self._server.ready:
            raise ControllerError("the tools' server is not there")
        if self._is_stopping:
            raise ControllerError("the robot is being stopped, and its standstill is not confirmed")
        try:
            call = self._means.rebuilder.rebuild(action)
        except MalformedError as error:
            raise ControllerError(error.message) from error
        handle = ToolGoal(self._means.site.vocabulary[action.type])
        before, self._is_told = self._is_told, self._is_told or handle.moves
        task = asyncio.ensure_future(self._carry(handle, call, ticket, before))
        if self._is_beside(action):
            self._beside[task] = handle
            task.add_done_callback(self._beside.pop)
        else:
            self._handle, self._task = handle, task
        return handle

    def streams(self, action: Action) -> bool:  # noqa: ARG002 - no tool is one
        """Return False: a tool is called once and not steered."""
        return False

    def steer(self, ticket: Digest, params: Mapping[str, int]) -> None:
        """Do nothing: nothing streams."""

    def close(self, ticket: Digest) -> None:
        """Do nothing: nothing streams."""

    def brake(self) -> None:
        """Call off what runs, and stop the robot where it may move; a second time changes nothing.

        What could not be stopped is tried again until it was.
        """
        self._end_beside(Outcome.ABORTED)
        if self._is_stopping or (self.stands and not self._runs()):
            return
        if self._task is not None:
            self._task.cancel()
        self._is_stopping = True
        self._task = asyncio.ensure_future(self._stop())

    def pass_time(self, ms: int) -> None:
        """Do nothing: time passes by itself."""

    async def let_go(self) -> None:
        """Stop what was started, and let another call end; not longer than `STOP_S`.

        Then the gate hears how it ended, while it is there. Nothing begins after.
        """
        self._is_over = True
        if self._is_told:
            self.brake()
        with suppress(TimeoutError):
            async with asyncio.timeout(STOP_S):
                while self._runs() or self._beside or (self._is_told and self._is_stopping):
                    await asyncio.sleep(_LOOK_S)
        self._end_beside(Outcome.UNKNOWN)
        if self._task is not None:
            self._task.cancel()
        if self._runs():
            self._ended(Outcome.UNKNOWN)

    def _end_beside(self, outcome: Outcome) -> None:
        """Call off every call that runs beside; no such call moves the robot."""
        for task, handle in self._beside.items():
            task.cancel()
            handle.end(outcome)
        if self._beside:
            self._changed()

    def _runs(self) -> bool:
        return self._handle is not None and self._handle.outcome() is None

    async def _carry(
        self,
        handle: ToolGoal,
        call: Call,
        ticket: Digest,
        before: bool,  # noqa: FBT001
    ) -> None:
        """Make the call, and see to it that a robot that did not arrive stands.

        Args:
            handle: it.
            call: what it is.
            ticket: of its release.
            before: the robot may have moved already.
        """
        told, outcome = None, Outcome.UNKNOWN
        try:
            wanted = self._means.binder.expected(call)
            made = Call(call.tool, json.loads(call_bytes(call))["arguments"], call.where)
            self._made_calls[ticket] = made
            if len(self._made_calls) > 2 * MOST_BESIDE:
                del self._made_calls[next(iter(self._made_calls))]
            answer, done = await self._made(made, wanted, LONGEST_S, ticket)
        except CallError as error:
            if not error.sent:
                outcome = Outcome.NOT_STARTED
                if handle.moves:
                    self._is_told = before
        except Exception as error:  # noqa: BLE001 - whatever it is, the call is over
            self._log.say("fault", "tools", tool=call.tool, message=type(error).__name__)
        else:
            told, outcome = answer.told, Outcome.SUCCEEDED if done else Outcome.FAILED
            if handle.moves and (done or await self._stopped()):
                self._is_told = self._was_told = False
            elif handle.moves and self._means.stops:
                outcome = Outcome.UNKNOWN  # it may move still, wherever to
        handle.end(outcome, told)
        self._changed()
        if handle.moves and self._is_told and self._means.stops:
            self._is_stopping = True  # it was not asked for: where it goes is unknown
            await self._stop()

    async def _stop(self) -> None:
        """Make the calls that stop the robot, until they are answered.

        Without such calls it is unknown whether it stands.
        """
        while not (stands := self.stands or await self._stopped()) and self._means.stops:
            self._ended(Outcome.UNKNOWN)
            await asyncio.sleep(AGAIN_S)
        if stands:
            self._is_told = self._was_told = False
        self._is_stopping = False
        self._ended(Outcome.ABORTED if stands else Outcome.UNKNOWN)

    def _ended(self, outcome: Outcome) -> None:
        if self._handle is not None:
            self._handle.end(outcome)
        self._changed()

    async def _stopped(self) -> bool:
        """Make the stop calls once; True when each said that it has done its work."""
        try:
            async with asyncio.timeout(STOP_S):
                for call in self._means.stops:
                    _, done = await self._made(call, self._wanted(call), STOP_S)
                    if not done:
                        return False
        except (CallError, TimeoutError):
            return False
        return bool(self._means.stops)

    async def _made(
        self, call: Call, wanted: Expected, within_s: float, ticket: Digest | None = None
    ) -> tuple[ToolAnswer, bool]:
        """Make a call; return its answer, and whether that says that it has done its work.

        Raises:
            CallError: no answer came, or none that can be carried: the outcome of the call is
                unknown.
        """
        try:
            answer = await self._server.call(call.tool, call.arguments, within_s, ticket=ticket)
            return answer, answer.is_done(wanted)
        except (CallError, TimeoutError):
            raise
        except Exception as error:
            self._log.say("fault", "tools", tool=call.tool, message=type(error).__name__)
            raise CallError("its answer could not be carried", sent=True) from error

    def _wanted(self, call: Call) -> Expected:
        """Return what a stop call's answer has to say, where the binding knows the call."""
        try:
            return self._means.binder.expected(call)
        except MalformedError:
            return Expected()
