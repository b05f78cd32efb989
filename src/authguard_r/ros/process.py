# SPDX-License-Identifier: Apache-2.0
"""A process that is one node: in the map's domain and enclave, with names that nobody remaps.

Spec page: docs/spec/ros-stopping.md#processes
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import Protocol

import rclpy
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions

from authguard_r.client.link import Log
from authguard_r.core.errors import AuthGuardError
from authguard_r.ros.map import RosMap

#: What a process ends with: its words, or what they name, are wrong.
WRONG = 2


class Closing(Protocol):
    """What runs in a node."""

    def close(self) -> None:
        """End it."""
        ...


def run_node(
    name: str,
    words: list[str],
    ready: Callable[..., tuple[RosMap, str, Callable[[Node], Closing]]],
) -> int:
    """Run one node until SIGTERM or SIGINT, and return the process's exit code.

    Words of ROS (`--ros-args`) are none of its words: nobody remaps a name, moves it to another
    domain or gives it another enclave than the map says.

    Args:
        name: of the node.
        words: of the command line.
        ready: takes the words; returns the map, the enclave, and what makes the node's work.
    """
    log = Log()
    wanted = tuple(inspect.signature(ready).parameters)
    if len(words) != len(wanted):
        log.say("refused", name, message=f"expected {' '.join(wanted).upper()}")
        return WRONG
    try:
        ros, enclave, build = ready(*words)
        _spin(name, ros, enclave, build)
    except AuthGuardError as error:
        log.fault(name, error)
        return WRONG
    return 0


def _spin(name: str, ros: RosMap, enclave: str, build: Callable[[Node], Closing]) -> None:
    context = Context()
    rclpy.init(
        args=["--ros-args", "--enclave", enclave],
        context=context,
        domain_id=ros.domain,
        signal_handler_options=SignalHandlerOptions.NO,
    )
    rclpy.signals.install_signal_handlers(SignalHandlerOptions.ALL)
    node = Node(
        name,
        context=context,
        use_global_arguments=False,
        enable_rosout=False,
        start_parameter_services=False,
        parameter_overrides=[Parameter("start_type_description_service", value=False)],
    )
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    work = build(node)
    try:
        sys.stdout.write("ready\n")
        sys.stdout.flush()
        with suppress(ExternalShutdownException, KeyboardInterrupt):
            executor.spin()
    finally:
        work.close()
        executor.shutdown()
        node.destroy_node()
        context.try_shutdown()
