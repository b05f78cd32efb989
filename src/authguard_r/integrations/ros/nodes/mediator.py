# SPDX-License-Identifier: Apache-2.0
"""What stands between planners and a robot: both ends of the gate, and what the map mediates.

The robot's side and the planners' side are a node and a thread each: what planners send keeps
nothing waiting that stops the robot. What runs when the robot is reached is canceled before
anything is served. Spec page: docs/spec/ros.md
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from pathlib import Path
from typing import Any

from msgspec import Struct
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.context import Context

from authguard_r.client.driver import Driver
from authguard_r.client.handshake import GateVerifier
from authguard_r.client.link import ProcessLog, require_folder
from authguard_r.client.reconnecting import GatePlace, ReconnectingClient
from authguard_r.core.errors import EnvironmentFault, StoreError
from authguard_r.core.reasons import Reason
from authguard_r.integrations.ros.calls import fitted, spelled
from authguard_r.integrations.ros.map import PARTS, Mediated, MediationKind, RosMap
from authguard_r.integrations.ros.nodes.actions import ActionProxyServer, Public
from authguard_r.integrations.ros.nodes.body import RosBody, RosDrivers
from authguard_r.integrations.ros.nodes.goals import ActionClientProxy
from authguard_r.integrations.ros.nodes.heartbeat import gate_heartbeat
from authguard_r.integrations.ros.nodes.loop import Spinner, raised, spun
from authguard_r.integrations.ros.nodes.process import plain_node, ros_context
from authguard_r.integrations.ros.nodes.proposals import PlannerProposals
from authguard_r.integrations.ros.nodes.proxies import (
    ClientProxy,
    MessageClientProxy,
    RobotProxy,
    ServiceClientProxy,
)
from authguard_r.integrations.ros.nodes.releases import Releases
from authguard_r.integrations.ros.nodes.services import MessageProxyServer, ServiceProxyServer
from authguard_r.integrations.ros.nodes.status_publishers import StatusPublishers
from authguard_r.integrations.ros.nodes.streams import StreamServer
from authguard_r.integrations.ros.nodes.values import (
    asked_of,
    has_path,
    load_type,
    require_narrow,
)
from authguard_r.integrations.ros.nodes.velocity import StreamClientProxy
from authguard_r.integrations.ros.rights import GATE_NODE
from authguard_r.integrations.tools.files import words_of
from authguard_r.normalize import Binder
from authguard_r.normalize.binding import Binding
from authguard_r.normalize.rebuild import Rebuilder
from authguard_r.site.model import Site
from authguard_r.wire.messages import ClientRole

#: A gate that is there is connected, and a robot that runs stands, within this, in seconds.
START_S = 30.0
#: What of the robot has not come by then, in seconds, is not waited for.
ROBOT_S = 10.0
#: After a stop, how long planners may wait for the end of their goals, in seconds.
SETTLE_S = 2.0
#: A gate that is away is asked again after so long, in seconds.
AGAIN_S = 0.1
_LOOK_S = 0.02
NAMESPACE = GATE_NODE.rpartition("/")[0]


class MediatorTarget(Struct, frozen=True, kw_only=True):
    """Which robot and which gate.

    Args:
        ros: what is mediated.
        run: the gate's run folder.
        site: the site.
        binding: sound for it; the gate's own.
        trust: reads the trust root.
        client: the planners' name in the log.
    """

    ros: RosMap
    run: Path
    site: Site
    binding: Binding
    trust: Callable[[], GateVerifier]
    client: str = "ros"


class Mediator:
    """Both sides of the node, between both ends of the gate; `configured` makes and ends one.

    Args:
        place: where.
        spinner: the robot's side, and its thread.
        types: the class of each mediated thing.
        log: says what happens.
    """

    def __init__(
        self, place: MediatorTarget, spinner: Spinner, types: dict[str, Any], log: ProcessLog
    ) -> None:
        self._place, self._spinner, self._types, self._log = place, spinner, types, log
        self._group = ReentrantCallbackGroup()
        self._servers: tuple[ActionProxyServer, ...] = ()
        #: the process's
        self.enclave = place.ros.enclaves.gate
        robot, ros, site = place.ros.robot, place.ros, place.site
        self._telling = StatusPublishers(ros, site)
        asked = {key: asked_of(types[key], PARTS[item.kind]) for key, item in ros.mediated.items()}
        fit = fitted(place.binding, ros, site)
        spoken = spelled(fit, ros, lambda key, path: has_path(asked[key], path))
        releases = Releases()
        self._binder = Binder(site, spoken)
        means = RosDrivers(
            site=site,
            ros=ros,
            binder=self._binder,
            rebuilder=Rebuilder(site, spoken),
            releases=releases,
        )
        self.body = RosBody(robot, means, self._look, log)
        speaks = words_of(site, place.binding)
        self.gate = GatePlace(
            robot=robot, run=place.run, trust=place.trust, client=place.client, speaks=speaks
        )
        self.proposals = PlannerProposals(self.gate, releases)
        self.proven = asyncio.Event()
        self.driver = Driver(
            self.body,
            place.run,
            trust=place.trust,
            log=log,
            ready=self.proven.set,
            speaks=speaks,
        )

    def reach(self) -> None:
        """Make the clients and publishers that reach the robot; on the thread of ROS."""
        robot = RobotProxy(
            spinner=self._spinner,
            group=self._group,
            changed=self._look,
            astray=self.body.astray,
            strange=self.body.strange,
            is_alive=self.body.is_alive,
        )
        for key, item in self._place.ros.mediated.items():
            self.body.proxies[key] = self._proxy(robot, key, item)
        gate_heartbeat(
            self._spinner.node,
            self._place.ros.heartbeat,
            still_alive=self.body.is_alive,
            lapsed=lambda: self._spinner.soon(self._lapsed),
            group=self._group,
        )

    def serve(self, spinner: Spinner) -> None:
        """Make what planners see, on a thread of their own, which this is called on."""
        public = Public(
            spinner=spinner,
            group=ReentrantCallbackGroup(),
            proposals=self.proposals,
            log=self._log,
        )
        actions: list[ActionProxyServer] = []
        for key, item in self._place.ros.mediated.items():
            kind = self._types[key]
            if item.kind is MediationKind.ACTION:
                actions.append(ActionProxyServer(public, key, item, kind))
            elif item.kind is MediationKind.SERVICE:
                ServiceProxyServer(public, key, item, kind)
            elif item.kind is MediationKind.MESSAGE:
                MessageProxyServer(public, key, item, kind)
            else:
                StreamServer(public, key, item, kind, self._binder)
        self._servers = tuple(actions)
        self._telling.serve(public, self.gate, body=self.body, session=self.driver.session)

    async def settled(self, within_s: float) -> None:
        """Return once planners heard how each of their goals ended, or time is over."""
        with suppress(TimeoutError):
            async with asyncio.timeout(within_s):
                while not all(server.is_idle for server in self._servers):
                    await asyncio.sleep(_LOOK_S)

    def _proxy(self, robot: RobotProxy, key: str, item: Mediated) -> ClientProxy:
        kind = self._types[key]
        if item.kind is MediationKind.ACTION:
            return ActionClientProxy(robot, kind, item.private)
        if item.kind is MediationKind.SERVICE:
            return ServiceClientProxy(robot, kind, item.private)
        if item.kind is MediationKind.MESSAGE:
            return MessageClientProxy(robot, kind, item.private)
        profile = self._place.site.robots[self._place.ros.robot].profile
        return StreamClientProxy(robot, kind, item.private, profile)

    def _lapsed(self) -> None:
        """Stop a robot whose watches took this for dead."""
        self._log.say("lapsed", self._place.ros.heartbeat)
        self.body.brake()

    def _look(self) -> None:
        self.driver.look()


@asynccontextmanager
async def configured(
    place: MediatorTarget, context: Context, log: ProcessLog
) -> AsyncIterator[Mediator]:
    """Reach the robot for the gate and stop everything that runs; planners are not served yet.

    Raises:
        MalformedError: map, site and binding do not fit each other.
        EnvironmentFault: the gate did not come, a type is not installed, or the robot does not
            stand.
        StoreError: the gate's store was put back.
    """
    require_folder(place.run)
    types = {
        key: load_type(item.type, PARTS[item.kind]) for key, item in place.ros.mediated.items()
    }
    for key, item in place.ros.mediated.items():
        require_narrow(types[key], PARTS[item.kind], where=f"mediated.{key}.type")
    node = plain_node("gate_robot", context, place.ros.enclaves.gate, namespace=NAMESPACE)
    async with spun(node) as (spinner, failed):
        mediator = Mediator(place, spinner, types, log)
        async with asyncio.TaskGroup() as group:
            tasks = [group.create_task(raised(failed)), group.create_task(mediator.driver.stay())]
            await spinner.do(mediator.reach)
            async with AsyncExitStack() as at_end:  # what is pushed last ends first
                at_end.push_async_callback(mediator.proposals.close)
                await _ready(mediator)
                at_end.push_async_callback(mediator.body.let_go)
                yield mediator
            for task in tasks:
                task.cancel()


@asynccontextmanager
async def serving(mediator: Mediator, context: Context) -> AsyncIterator[None]:
    """Serve planners; in the end the robot is stopped first, and they hear how that ended."""
    node = plain_node("gate_planners", context, mediator.enclave, namespace=NAMESPACE)
    async with spun(node) as (spinner, failed), asyncio.TaskGroup() as group:
        watching = group.create_task(raised(failed))
        mediator.body.is_served = True
        await spinner.do(mediator.serve, spinner)
        try:
            yield
        finally:
            mediator.body.is_served = False  # before the stop: nothing begins behind it
            await mediator.body.at_rest(START_S)
            await mediator.settled(SETTLE_S)
        watching.cancel()


@asynccontextmanager
async def mediating(place: MediatorTarget, log: ProcessLog) -> AsyncIterator[Mediator]:
    """Stand between planners and a robot; what is inside runs once everything is served.

    Raises:
        AuthGuardError: as `configured`.
    """
    with ros_context(place.ros, place.ros.enclaves.gate) as context:
        async with configured(place, context, log) as mediator, serving(mediator, context):
            yield mediator


async def _ready(mediator: Mediator) -> None:
    """Wait for the gate and a while for the robot, and stop everything that runs.

    Raises:
        EnvironmentFault: the gate did not come, or the robot is not known to stand.
        StoreError: the gate's store was put back.
    """
    try:
        async with asyncio.timeout(START_S):
            await _come(mediator.proposals)
            await _require_store(mediator.gate)
            await mediator.proven.wait()
    except TimeoutError as error:
        raise EnvironmentFault(
            "the gate did not come in time", reason=Reason.CONTROLLER_FAILED, where="run"
        ) from error
    with suppress(TimeoutError):
        async with asyncio.timeout(ROBOT_S):
            while mediator.body.missing:
                await asyncio.sleep(_LOOK_S)
    if not await mediator.body.at_rest(START_S):
        raise EnvironmentFault(
            "no controller confirmed that the robot stands",
            reason=Reason.CONTROLLER_FAILED,
            where="robot",
        )


async def _come(proposals: PlannerProposals) -> None:
    """Return once the gate is there.

    Raises:
        AuthGuardError: it is there, and not the one that it has to be.
    """
    while True:
        try:
            return await proposals.ready()
        except EnvironmentFault:  # it may come yet
            await asyncio.sleep(AGAIN_S)


async def _require_store(place: GatePlace) -> None:
    """Require a gate whose store is no copy of before: its standing would be, too.

    Raises:
        StoreError: it was put back (`ROLLED_BACK`); an operator has to sign a `resume`.
        AuthGuardError: it does not say, to a client of this user.
    """
    kept = ReconnectingClient(place, ClientRole.AUDITOR)
    try:
        gate = await kept.connected()
        anchor = (await gate.status())["anchor"]
    finally:
        await kept.close()
    if anchor["state"] == "put_back":
        raise StoreError(
            f"the gate's store was rolled back: {anchor['message']}",
            reason=Reason.ROLLED_BACK,
            where="gate.store",
        )
