# SPDX-License-Identifier: Apache-2.0
"""A process that is one node: in the map's domain and enclave, with names that cannot be remapped.

Spec page: docs/spec/ros-stopping.md#processes
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Protocol

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import get_rmw_implementation_identifier

from authguard_r.client.link import ProcessLog
from authguard_r.core.errors import AuthGuardError, EnvironmentFault
from authguard_r.core.reasons import Reason
from authguard_r.integrations.ros.map import RosMap
from authguard_r.integrations.ros.security import ENABLE, RMW, SECURED, require_security
from authguard_r.keys.trust import Trust

RCLError = rclpy_implementation.RCLError
#: What a process ends with: its words, or what they name, are wrong.
WRONG = 2
#: The word for a bench: no DDS security is needed.
DEMO = "--demo"
#: A signal is looked for after so long at the latest, in seconds.
LOOK_S = 0.1


class NodeCleanup(Protocol):
    """What runs in a node."""

    def close(self) -> None:
        """End it."""
        ...


@contextmanager
def made_by_ros(enclave: str) -> Iterator[None]:
    """Say why ROS 2 makes no node: it has no security, or no folder for its logs.

    Args:
        enclave: which one the node would be in.

    Raises:
        EnvironmentFault: it makes none.
    """
    try:
        yield
    except RCLError as error:
        raise EnvironmentFault(
            f"ROS 2 makes no node in `{enclave}`: {error}",
            reason=Reason.SERVICE_UNAVAILABLE,
            where="rclpy",
        ) from error


def require_bench(trust: Trust, *, demo: bool) -> None:
    """Require that a process without DDS security trusts a demonstration alone.

    Raises:
        EnvironmentFault: it would stand before a robot in earnest, or beside secured processes.
    """
    if demo:
        require_unsecured()
    if demo and not trust.demo:
        raise EnvironmentFault(
            f"expected no `{DEMO}`: the trust root is no demonstration's",
            reason=Reason.SETUP_INVALID,
            where=DEMO,
        )


def require_unsecured() -> None:
    """Require that no word of DDS security is set: on a bench all processes are without.

    Raises:
        EnvironmentFault: a name is remapped.
    """
    if ENABLE in os.environ:
        raise EnvironmentFault(
            f"expected no `{DEMO}` where `{ENABLE}` is set",
            reason=Reason.SETUP_INVALID,
            where=DEMO,
        )


def run_node(
    name: str,
    words: list[str],
    wanted: tuple[str, ...],
    ready: Callable[..., tuple[RosMap, str, Callable[[Node], NodeCleanup]]],
) -> int:
    """Run one node until SIGTERM or SIGINT, and return the process's exit code.

    It takes no arguments of ROS (`--ros-args`): they cannot remap a name, move it to another domain
    or give it another enclave than the map says. Outside its enclave it does not start, but with
    `--demo`, on a bench where nothing can be hurt and no word of DDS security is set.

    Args:
        name: of the node.
        words: of the command line.
        wanted: what each of them is.
        ready: takes the words; returns the map, the enclave, and what makes the node's work.
    """
    log = ProcessLog()
    given = [word for word in words if word != DEMO]
    if "--help" in given or "-h" in given:
        sys.stdout.write(f"{name} {' '.join(wanted)} [{DEMO}]\n")
        return 0
    if len(given) != len(wanted):
        log.say("refused", name, message=f"expected {' '.join(wanted)} [{DEMO}]")
        return WRONG
    try:
        ros, enclave, build = ready(*given)
        if len(given) == len(words):
            require_security(ros, enclave, os.environ)
        else:
            require_unsecured()
        _spin(name, ros, enclave, build)
    except AuthGuardError as error:
        log.fault(name, error)
        return WRONG
    return 0


def _spin(name: str, ros: RosMap, enclave: str, build: Callable[[Node], NodeCleanup]) -> None:
    over = threading.Event()
    # not those of rclpy: they take the context away before a last word is said
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: over.set())
    with made_node(name, ros, enclave) as node:
        executor = SingleThreadedExecutor(context=node.context)
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


@contextmanager
def made_node(name: str, ros: RosMap, enclave: str) -> Iterator[Node]:
    """Yield a node in the map's domain and an enclave, which takes no ROS arguments."""
    with ros_context(ros, enclave) as context:
        node = plain_node(name, context, enclave)
        try:
            yield node
        finally:
            node.destroy_node()


@contextmanager
def ros_context(ros: RosMap, enclave: str) -> Iterator[Context]:
    """Yield a place in ROS: the map's domain, and an enclave.

    Raises:
        EnvironmentFault: ROS 2 makes none, or took a middleware that keeps to no keystore.
    """
    context = Context()
    if ENABLE in os.environ and (loaded := get_rmw_implementation_identifier()) not in SECURED:
        raise EnvironmentFault(
            f"expected a middleware with DDS security, got `{loaded}`",
            reason=Reason.SETUP_INVALID,
            where=RMW,
        )
    with made_by_ros(enclave):
        rclpy.init(
            args=["--ros-args", "--enclave", enclave],
            context=context,
            domain_id=ros.domain,
            signal_handler_options=SignalHandlerOptions.NO,
        )
    try:
        yield context
    finally:
        context.try_shutdown()


def plain_node(name: str, context: Context, enclave: str, *, namespace: str = "") -> Node:
    """Return a node that serves no parameters, says nothing to `/rosout`, and hears no clock."""
    with made_by_ros(enclave):
        return Node(
            name,
            namespace=namespace,
            context=context,
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
            parameter_overrides=[Parameter("start_type_description_service", value=False)],
        )
