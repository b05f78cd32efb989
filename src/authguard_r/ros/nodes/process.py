# SPDX-License-Identifier: Apache-2.0
"""A process that is one node: in the map's domain and enclave, with names that nobody remaps.

Spec page: docs/spec/ros-stopping.md#processes
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable
from typing import Protocol

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions

from authguard_r.client.link import Log
from authguard_r.core.errors import AuthGuardError
from authguard_r.ros.map import RosMap
from authguard_r.ros.security import require_security

#: What a process ends with: its words, or what they name, are wrong.
WRONG = 2
#: The word for a bench: no DDS security is needed.
DEMO = "--demo"
#: A signal is looked for after so long at the latest, in seconds.
LOOK_S = 0.1


class Closing(Protocol):
    """What runs in a node."""

    def close(self) -> None:
        """End it."""
        ...


def run_node(
    name: str,
    words: list[str],
    wanted: tuple[str, ...],
    ready: Callable[..., tuple[RosMap, str, Callable[[Node], Closing]]],
) -> int:
    """Run one node until SIGTERM or SIGINT, and return the process's exit code.

    Words of ROS (`--ros-args`) are none of its words: nobody remaps a name, moves it to another
    domain or gives it another enclave than the map says. Outside its enclave it does not start, but
    with `--demo`, on a bench where nothing can be hurt.

    Args:
        name: of the node.
        words: of the command line.
        wanted: what each of them is.
        ready: takes the words; returns the map, the enclave, and what makes the node's work.
    """
    log = Log()
    given = [word for word in words if word != DEMO]
    if len(given) != len(wanted):
        log.say("refused", name, message=f"expected {' '.join(wanted)} [{DEMO}]")
        return WRONG
    try:
        ros, enclave, build = ready(*given)
        if len(given) == len(words):
            require_security(ros, enclave, os.environ)
        _spin(name, ros, enclave, build)
    except AuthGuardError as error:
        log.fault(name, error)
        return WRONG
    return 0


def _spin(name: str, ros: RosMap, enclave: str, build: Callable[[Node], Closing]) -> None:
    over = threading.Event()
    # not those of rclpy: they take the context away before a last word is said
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: over.set())
    context = Context()
    rclpy.init(
        args=["--ros-args", "--enclave", enclave],
        context=context,
        domain_id=ros.domain,
        signal_handler_options=SignalHandlerOptions.NO,
    )
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
    try:
        work = build(node)
        try:
            sys.stdout.write("ready\n")
            sys.stdout.flush()
            while not over.is_set():
                executor.spin_once(timeout_sec=LOOK_S)
        finally:
            work.close()
    finally:
        executor.shutdown()
        node.destroy_node()
        context.try_shutdown()
