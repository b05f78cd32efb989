# SPDX-License-Identifier: Apache-2.0
"""The process of the node that stands between planners and a robot.

No parameter, argument or remapping of ROS changes what it serves: it takes no ROS arguments. Spec
page: docs/spec/ros.md
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import signal
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

from rclpy.lifecycle import TransitionCallbackReturn

from authguard_r.access.files import read_binding, trusted_site
from authguard_r.client.link import ProcessLog
from authguard_r.core.errors import AuthGuardError
from authguard_r.integrations.ros.map import RosMap, read_map
from authguard_r.integrations.ros.nodes.lifecycle import Managed, States
from authguard_r.integrations.ros.nodes.loop import Spinner, spun
from authguard_r.integrations.ros.nodes.mediator import MediatorTarget
from authguard_r.integrations.ros.nodes.process import DEMO, made_by_ros, require_bench, ros_context
from authguard_r.integrations.ros.security import require_security
from authguard_r.integrations.tools.endpoints import first_of
from authguard_r.keys.trust import read_trust


def main() -> None:
    """Serve until SIGTERM, SIGINT or a shutdown.

    A line of JSON says when it is ready, and what of the robot is missing.
    """
    asks = argparse.ArgumentParser(
        prog="python -m authguard_r.integrations.ros.nodes.node",
        description="Stand between planners and a robot on ROS 2.",
    )
    asks.add_argument("--map", type=Path, required=True, help="the robot's map")
    asks.add_argument(
        "--gate", "--run", dest="run", type=Path, required=True, help="the gate's run folder"
    )
    asks.add_argument("--site", type=Path, required=True, help="the site model, the gate's own")
    asks.add_argument("--trust", type=Path, required=True, help="the trust folder")
    asks.add_argument("--binding", required=True, help="the binding, the gate's own")
    asks.add_argument(
        "--managed", action="store_true", help="a manager configures and activates it"
    )
    asks.add_argument(DEMO, action="store_true", help="a bench: no DDS security is needed")
    given = asks.parse_args()
    try:
        asyncio.run(_serve(given))
    except AuthGuardError as error:
        sys.exit(str(error))
    except BaseExceptionGroup as group:
        sys.exit(str(first_of(group)))


async def _serve(given: argparse.Namespace) -> None:
    log = ProcessLog()
    ros = _own_map(given)
    over = asyncio.Event()
    loop = asyncio.get_running_loop()
    for sign in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(sign, over.set)
    with ros_context(ros, ros.enclaves.gate) as context:
        states = States(lambda: _place(given), context, log)
        facts = {"robot": ros.robot, "security": "none" if given.demo else "enforced"}
        with made_by_ros(ros.enclaves.gate):
            node = Managed(context, facts, states.carry)
        async with spun(node) as (spinner, failed):
            living = asyncio.ensure_future(states.live())
            begins = asyncio.ensure_future(_begin(node, spinner, states, is_managed=given.managed))
            ends = asyncio.ensure_future(over.wait())
            try:
                await _first(failed, living, begins, ends)
                if not living.done() and not ends.done():
                    _say({"ready": True, "missing": list(states.missing)})
                    await _first(failed, living, ends)
                if begins.done():  # else it goes as it came: what was reached is let go
                    if not living.done():
                        await spinner.do(node.trigger_shutdown)
                    await living
            finally:
                tasks = (living, begins, ends)
                for task in tasks:
                    task.cancel()
                await asyncio.gather(*tasks, return_exceptions=True)


async def _first(*tasks: asyncio.Future[Any]) -> None:
    """Wait for one of several; raise what ended it."""
    done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    for task in done:
        task.result()


async def _begin(node: Managed, spinner: Spinner, states: States, *, is_managed: bool) -> None:
    """Configure and activate it at once, unless another process does.

    Raises:
        AuthGuardError: it cannot be configured.
    """
    for trigger in () if is_managed else (node.trigger_configure, node.trigger_activate):
        said = await spinner.do(trigger)
        if said is not TransitionCallbackReturn.SUCCESS and states.fault is not None:
            raise states.fault


def _own_map(given: argparse.Namespace) -> RosMap:
    """Return the map, in the enclave that it says.

    Raises:
        AuthGuardError: it is not valid, or a node of this process would be a plain one.
    """
    ros = read_map(given.map)
    if not given.demo:
        require_security(ros, ros.enclaves.gate, os.environ)
    return ros


def _place(given: argparse.Namespace) -> MediatorTarget:
    """Return where and what, read anew.

    Raises:
        AuthGuardError: something of it does not hold.
    """
    trust = read_trust(given.trust)
    require_bench(trust, demo=given.demo)
    site = trusted_site(given.site, trust)
    return MediatorTarget(
        ros=_own_map(given),
        run=given.run,
        site=site,
        binding=read_binding(given.binding, site),
        trust=lambda: read_trust(given.trust),
    )


def _say(line: dict[str, object]) -> None:
    sys.stdout.write(json.dumps(line) + "\n")
    with suppress(OSError):
        sys.stdout.flush()


if __name__ == "__main__":
    main()
