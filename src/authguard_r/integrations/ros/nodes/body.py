# SPDX-License-Identifier: Apache-2.0
"""What moves behind a ROS graph, as a controller's body (`client.controller.Body`).

A released action is rebuilt into the one goal, call, message or velocity that it is, and that is
sent once. A stop cancels every goal of every mediated action and sends zero on every stream, for
all planners. Spec page: docs/spec/ros.md#driving
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Mapping
from contextlib import suppress

from msgspec import Struct
from msgspec.structs import replace

from authguard_r.client.link import ProcessLog, mono_ms
from authguard_r.core.action import Action
from authguard_r.core.errors import ControllerError, MalformedError
from authguard_r.core.identifiers import Digest, ParameterId, RobotId
from authguard_r.core.ports import GoalHandle
from authguard_r.core.standing import Outcome
from authguard_r.integrations.ros.calls import DURATION, body_of, item_of, velocities
from authguard_r.integrations.ros.map import RosMap
from authguard_r.integrations.ros.nodes.proxies import STOP_S, ClientProxy, DispatchOrder
from authguard_r.integrations.ros.nodes.releases import Release, Releases
from authguard_r.integrations.ros.nodes.values import message_of
from authguard_r.integrations.ros.nodes.velocity import StreamClientProxy
from authguard_r.normalize import Binder
from authguard_r.normalize.dialects import Call
from authguard_r.normalize.rebuild import Rebuilder, call_bytes
from authguard_r.site.model import Site

#: Between two tries to stop the robot, in seconds.
AGAIN_S = 0.5
#: Actions that run at once, at most.
MOST = 4
#: The ends look at their body every 10 ms; without a look for so long they are not alive.
ALIVE_MS = 80


class RosDrivers(Struct, frozen=True, kw_only=True):
    """What a body drives with.

    Args:
        site: its words.
        ros: what is mediated.
        binder: what calls mean.
        rebuilder: what actions are called, among what is mediated.
        releases: where the planners' end finds what begins.
    """

    site: Site
    ros: RosMap
    binder: Binder
    rebuilder: Rebuilder
    releases: Releases


class _Doing(Struct, frozen=True, kw_only=True):
    """A released action that was begun.

    Args:
        action: it.
        release: it, on its way.
        beside: it may run beside another.
        stream: publishes its velocities; None of what is no stream.
    """

    action: Action
    release: Release
    beside: bool
    stream: StreamClientProxy | None


class RosBody:
    """A robot behind its ROS graph.

    Args:
        rid: which.
        means: what it is driven with.
        changed: called when something ended.
        log: says what happens.
    """

    obeys = True
    late_ms = 0

    def __init__(
        self, rid: RobotId, means: RosDrivers, changed: Callable[[], None], log: ProcessLog
    ) -> None:
        self.rid = rid
        self.proxies: dict[str, ClientProxy] = {}
        vocabulary = means.site.vocabulary.values()
        self.sampled = frozenset(name for kind in vocabulary for name in velocities(kind))
        self._means = means
        self._changed = changed
        self._log = log
        self._doing: dict[Digest, _Doing] = {}  # and what ended since the last look
        self._stopping: asyncio.Task[None] | None = None
        self._seen_ms = mono_ms()
        #: False while planners are not served: then nothing begins
        self.is_served = False

    @property
    def missing(self) -> tuple[str, ...]:
        """What of the robot is not there, by its name in the map."""
        return tuple(key for key, outlet in self.proxies.items() if not outlet.is_there)

    @property
    def stands(self) -> bool:
        """True while nothing is being stopped: what was stopped said that it stands."""
        return self._stopping is None

    def has_room(self, action: Action) -> bool:
        """Return True while there is room, and all but one may run `beside`, as the site says."""
        runs = self._running()
        alone = [one for one in runs if not one.beside]
        return len(runs) < MOST and (self._may_join(action) or not alone)

    @property
    def running(self) -> str:
        """What runs, by its names in the map; empty: nothing."""
        return ", ".join(sorted(one.release.key for one in self._running()))

    def begin(self, action: Action, ticket: Digest) -> GoalHandle:
        """Send it.

        Raises:
            ControllerError: nothing that is mediated carries the action, the robot's part of it is
                not there, or the robot is still being stopped.
        """
        try:
            return self._begun(action, ticket)
        except ControllerError as error:
            self._log.say("not begun", str(action.type), message=error.message)
            raise

    def _begun(self, action: Action, ticket: Digest) -> GoalHandle:
        if not self.is_served:
            raise ControllerError("planners are not served")
        if not self.stands:
            raise ControllerError("the robot is being stopped, and its standstill is not confirmed")
        try:
            key, call = self._rebuilt(action)
            outlet = self.proxies[key]
            message = self._message(key, call)
            wanted = self._means.binder.expected(call)
        except MalformedError as error:
            raise ControllerError(f"{error.message} at `{error.where}`") from error
        if not outlet.is_there:
            raise ControllerError(f"the robot's part of `{key}` is not there")
        kind = self._means.site.vocabulary[action.type]
        release = Release(kind, key, str(action.type))
        outlet.begin(
            DispatchOrder(
                release=release,
                message=message,
                moves=kind.moves,
                wanted=wanted,
                duration_ms=action.params.get(ParameterId(DURATION), 0),
            )
        )
        stream = outlet if isinstance(outlet, StreamClientProxy) else None
        self._doing = {one: doing for one, doing in self._doing.items() if doing.release.runs}
        self._doing[ticket] = _Doing(
            action=action, release=release, beside=self._may_join(action), stream=stream
        )
        if stream is not None:
            stream.steer(message, _speed(action))
        self._means.releases.began(ticket, release)
        return release.handle

    def streams(self, action: Action) -> bool:
        """Return True for velocities that run, and are published as they come."""
        return any(one.stream is not None and one.action == action for one in self._running())

    def steer(self, ticket: Digest, params: Mapping[str, int]) -> None:
        """Publish these velocities at once; what they do not name is zero."""
        doing = self._doing.get(ticket)
        if doing is None or doing.stream is None or not doing.release.runs or not self.stands:
            return
        doing.stream.sampled()
        action = doing.action
        given = {name: params.get(name, 0) for name in action.params if name != DURATION}
        sample = replace(action, params={**action.params, **given})
        try:
            _, call = self._rebuilt(sample)
            doing.stream.steer(self._message(doing.release.key, call), _speed(sample))
        except MalformedError:
            doing.stream.rest()

    def close(self, ticket: Digest) -> None:
        """Say zero; the stream has succeeded once the robot stands."""
        doing = self._doing.get(ticket)
        if doing is not None and doing.stream is not None:
            doing.stream.close()

    def brake(self) -> None:
        """Stop everything that runs, of all planners; a second time changes nothing."""
        if self._stopping is None:
            for outlet in self.proxies.values():
                if isinstance(outlet, StreamClientProxy):
                    outlet.rest()
            self._stopping = asyncio.ensure_future(self._stop())

    def pass_time(self, ms: int) -> None:  # noqa: ARG002 - the clock says it
        """Look at the clock."""
        self._seen_ms = mono_ms()
        for outlet in self.proxies.values():
            outlet.pass_time()

    def is_alive(self) -> bool:
        """Return True while the ends look after their body; any thread may ask."""
        return mono_ms() - self._seen_ms < ALIVE_MS

    def astray(self) -> None:
        """Stop a robot whose motion is unknown."""
        self.brake()
        self._changed()

    def strange(self, name: str, goals: int) -> None:
        """Stop a robot that moves without a release: a command bypassed the gate."""
        self._log.say("strange", name, goals=str(goals))
        self.astray()

    async def at_rest(self, within_s: float) -> bool:
        """Stop everything that runs; True once it stands."""
        self.brake()
        with suppress(TimeoutError):
            async with asyncio.timeout(within_s):
                await asyncio.shield(self._stopping or asyncio.sleep(0))
        return self.stands

    async def let_go(self) -> None:
        """Stop what runs before the node goes; not longer than a stop is waited for."""
        await self.at_rest(STOP_S)
        if self._stopping is not None:
            self._stopping.cancel()

    async def _stop(self) -> None:
        """Stop every outlet, until each says that nothing runs."""
        while not all(await asyncio.gather(*map(self._stopped, tuple(self.proxies)))):
            self._ended(Outcome.UNKNOWN)
            await asyncio.sleep(AGAIN_S)
        self._stopping = None
        self._ended(Outcome.ABORTED)

    async def _stopped(self, key: str) -> bool:
        """Stop one outlet; one that fails is not stopped, and does not prevent the others."""
        try:
            is_over, message = await self.proxies[key].stop(), "its end is not confirmed"
        except Exception as error:  # noqa: BLE001 - whatever it is, it is tried again
            is_over, message = False, f"{type(error).__name__}: {error}"
        if not is_over:
            self._log.say("not stopped", key, message=message)
        return is_over

    def _ended(self, outcome: Outcome) -> None:
        for doing in self._running():
            doing.release.end(outcome)
        self._changed()

    def _running(self) -> tuple[_Doing, ...]:
        return tuple(one for one in self._doing.values() if one.release.runs)

    def _may_join(self, action: Action) -> bool:
        """Return True of what the site lets run beside another; velocities have their one topic."""
        kind = self._means.site.vocabulary[action.type]
        return kind.beside and not velocities(kind)

    def _rebuilt(self, action: Action) -> tuple[str, Call]:
        """Return what carries an action, by its name in the map, and the call that it is."""
        call = self._means.rebuilder.rebuild(action)
        return item_of(call, self._means.ros), call

    def _message(self, key: str, call: Call) -> object:
        """Return the message that a rebuilt call is."""
        item = self._means.ros.mediated[key]
        plain = json.loads(call_bytes(call))["arguments"]
        return message_of(self.proxies[key].kind, body_of(item, plain), where=key)


def _speed(action: Action) -> int:
    """Return the length of a velocity at most, in mm/s; 0 only of one that is zero."""
    given = {name: abs(value) for name, value in action.params.items() if name != DURATION}
    along = sum(value for name, value in given.items() if name.endswith("_mm_s"))
    return max(along, 1) if any(given.values()) else 0
