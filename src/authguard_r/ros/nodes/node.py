# SPDX-License-Identifier: Apache-2.0
"""The node that stands between planners and a robot: what the map mediates, and nothing else.

It holds both ends of the gate, as every adapter does. No parameter, argument or remapping changes
what it serves; what runs when it starts is canceled before anything is served.
Spec page: docs/spec/ros.md
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import signal
import sys
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import rclpy
from msgspec import Struct
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.context import Context
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from authguard_r.client.driver import Driver
from authguard_r.client.greeting import GateVerifier
from authguard_r.client.keeping import GatePlace
from authguard_r.client.link import Log, require_folder
from authguard_r.core.errors import AuthGuardError, EnvironmentFault, MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.keys.trust import read_trust
from authguard_r.normalize import Binder
from authguard_r.normalize.binding import Binding
from authguard_r.normalize.rebuild import Rebuilder
from authguard_r.ros.calls import bound
from authguard_r.ros.map import Kind, Mediated, RosMap, read_map
from authguard_r.ros.names import Part
from authguard_r.ros.nodes.actions import ActionInlet, Public
from authguard_r.ros.nodes.body import Means, RosBody
from authguard_r.ros.nodes.goals import ActionOutlet
from authguard_r.ros.nodes.heartbeat import gate_heartbeat
from authguard_r.ros.nodes.loop import Spinner
from authguard_r.ros.nodes.outlets import MessageOutlet, Outlet, Robot, ServiceOutlet
from authguard_r.ros.nodes.process import DEMO
from authguard_r.ros.nodes.proposals import Proposals
from authguard_r.ros.nodes.releases import Releases
from authguard_r.ros.nodes.services import MessageInlet, ServiceInlet
from authguard_r.ros.nodes.streams import StreamInlet
from authguard_r.ros.nodes.values import load_type
from authguard_r.ros.nodes.velocity import StreamOutlet, braking_ms
from authguard_r.ros.security import require_security
from authguard_r.site.model import Site
from authguard_r.tools.ends import first_of
from authguard_r.tools.given import given_binding, trusted_site

#: A gate that is there is connected, and a robot that runs stands, within this, in seconds.
START_S = 30.0
#: What of the robot has not come by then, in seconds, is not waited for.
ROBOT_S = 10.0
_LOOK_S = 0.02
NAME, NAMESPACE = "gate", "/authguard"
_PARTS = {
    Kind.ACTION: Part.ACTION,
    Kind.SERVICE: Part.SERVICE,
    Kind.MESSAGE: Part.MESSAGE,
    Kind.STREAM: Part.MESSAGE,
}


class Place(Struct, frozen=True, kw_only=True):
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
    """The node with both of its ends; `mediating` makes and ends one.

    Args:
        place: where.
        spinner: the node, and its thread.
        types: the class of each mediated thing.
        log: says what happens.
    """

    def __init__(self, place: Place, spinner: Spinner, types: dict[str, Any], log: Log) -> None:
        self._place, self._spinner, self._types, self._log = place, spinner, types, log
        self._group = ReentrantCallbackGroup()
        robot, ros, site = place.ros.robot, place.ros, place.site
        if robot not in site.robots:
            raise MalformedError("expected a robot of the site", where="map.robot")
        spoken = bound(place.binding, ros, site)
        releases = Releases()
        self._binder = Binder(site, spoken)
        means = Means(
            site=site,
            ros=ros,
            binder=self._binder,
            rebuilder=Rebuilder(site, spoken),
            releases=releases,
        )
        self.body = RosBody(robot, means, self._look, log)
        gate = GatePlace(robot=robot, run=place.run, trust=place.trust, client=place.client)
        self.proposals = Proposals(gate, releases)
        self.proven = asyncio.Event()
        self.driver = Driver(
            self.body, place.run, trust=place.trust, log=log, ready=self.proven.set
        )

    def reach(self) -> None:
        """Make the clients and publishers that reach the robot; on the thread of ROS."""
        robot = Robot(
            spinner=self._spinner,
            group=self._group,
            changed=self._look,
            astray=self.body.astray,
            is_alive=self.body.is_alive,
        )
        for key, item in self._place.ros.mediated.items():
            self.body.outlets[key] = self._outlet(robot, key, item)
        gate_heartbeat(
            self._spinner.node,
            self._place.ros.heartbeat,
            still_alive=self.body.is_alive,
            lapsed=lambda: self._spinner.soon(self.body.brake),
            group=self._group,
        )

    def serve(self) -> None:
        """Make what planners see; on the thread of ROS."""
        public = Public(
            spinner=self._spinner, group=self._group, proposals=self.proposals, log=self._log
        )
        for key, item in self._place.ros.mediated.items():
            kind = self._types[key]
            if item.kind is Kind.ACTION:
                ActionInlet(public, key, item, kind)
            elif item.kind is Kind.SERVICE:
                ServiceInlet(public, key, item, kind)
            elif item.kind is Kind.MESSAGE:
                MessageInlet(public, key, item, kind)
            else:
                StreamInlet(public, key, item, kind, self._binder)

    def _outlet(self, robot: Robot, key: str, item: Mediated) -> Outlet:
        kind = self._types[key]
        if item.kind is Kind.ACTION:
            return ActionOutlet(robot, kind, item.private)
        if item.kind is Kind.SERVICE:
            return ServiceOutlet(robot, kind, item.private)
        if item.kind is Kind.MESSAGE:
            return MessageOutlet(robot, kind, item.private)
        profile = self._place.site.robots[self._place.ros.robot].profile
        braking_ms(profile, 1)  # a robot that nobody knows to stand is not steered
        return StreamOutlet(robot, kind, item.private, profile)

    def _look(self) -> None:
        self.driver.look()


@asynccontextmanager
async def mediating(place: Place, log: Log) -> AsyncIterator[Mediator]:
    """Stand between planners and a robot; what is inside runs once everything is served.

    Raises:
        MalformedError: map, site and binding do not fit each other.
        EnvironmentFault: the gate did not come, a type is not installed, or the robot does not
            stand.
    """
    require_folder(place.run)
    types = {
        key: load_type(item.type, _PARTS[item.kind]) for key, item in place.ros.mediated.items()
    }
    context = Context()
    rclpy.init(
        args=["--ros-args", "--enclave", place.ros.enclaves.gate],
        context=context,
        domain_id=place.ros.domain,
        signal_handler_options=SignalHandlerOptions.NO,
    )
    try:
        node = Node(
            NAME,
            namespace=NAMESPACE,
            context=context,
            use_global_arguments=False,
            start_parameter_services=False,
            enable_rosout=False,
        )
        try:
            async with _spun(place, node, types, log) as mediator:
                yield mediator
        finally:
            node.destroy_node()
    finally:
        context.try_shutdown()


@asynccontextmanager
async def _spun(
    place: Place, node: Node, types: dict[str, Any], log: Log
) -> AsyncIterator[Mediator]:
    """Spin the node and drive the robot, until what is inside ends or one of them fails."""
    failed: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    def fail(why: BaseException) -> None:
        if not failed.done():
            failed.set_exception(
                EnvironmentFault(
                    f"the node does not spin any more: {type(why).__name__}: {why}",
                    reason=Reason.CONTROLLER_FAILED,
                )
            )

    spinner = Spinner(node, fail)
    mediator = Mediator(place, spinner, types, log)
    spinner.start()
    try:
        async with asyncio.TaskGroup() as group:
            tasks = [group.create_task(_raised(failed)), group.create_task(mediator.driver.stay())]
            await spinner.do(mediator.reach)
            await _ready(mediator)
            await spinner.do(mediator.serve)
            try:
                yield mediator
            finally:
                await mediator.body.let_go()
                await mediator.proposals.close()
            for task in tasks:
                task.cancel()
    finally:
        failed.cancel()
        await spinner.close()


async def _raised(failed: asyncio.Future[None]) -> None:
    await failed


async def _ready(mediator: Mediator) -> None:
    """Wait for the gate and a while for the robot, and stop whatever runs.

    Raises:
        EnvironmentFault: the gate did not come, or nobody says that the robot stands.
    """
    try:
        async with asyncio.timeout(START_S):
            await mediator.proven.wait()
            await mediator.proposals.ready()
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
            "nobody says that the robot stands", reason=Reason.CONTROLLER_FAILED, where="robot"
        )


def main() -> None:
    """Serve until SIGTERM or SIGINT; a line of JSON says so, and what of the robot is missing."""
    asks = argparse.ArgumentParser(prog="python -m authguard_r.ros.nodes.node")
    for name in ("map", "run", "site", "trust"):
        asks.add_argument(f"--{name}", type=Path, required=True)
    asks.add_argument("--binding", required=True)
    asks.add_argument(DEMO, action="store_true", help="a bench: no DDS security is needed")
    given = asks.parse_args()
    try:
        asyncio.run(_serve(given))
    except AuthGuardError as error:
        sys.exit(str(error))
    except BaseExceptionGroup as group:
        sys.exit(str(first_of(group)))


async def _serve(given: argparse.Namespace) -> None:
    ros = read_map(given.map)
    if not given.demo:
        require_security(ros, ros.enclaves.gate, os.environ)
    trust = read_trust(given.trust)
    site = trusted_site(given.site, trust)
    place = Place(
        ros=ros,
        run=given.run,
        site=site,
        binding=given_binding(given.binding, site),
        trust=lambda: read_trust(given.trust),
    )
    over = asyncio.Event()
    loop = asyncio.get_running_loop()
    for sign in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(sign, over.set)
    async with mediating(place, Log()) as mediator:
        told = {"ready": True, "missing": list(mediator.body.missing)}
        sys.stdout.write(json.dumps(told) + "\n")
        with suppress(OSError):
            sys.stdout.flush()
        await over.wait()


if __name__ == "__main__":
    main()
