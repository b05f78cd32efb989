# SPDX-License-Identifier: Apache-2.0
"""What `ros2 run authguard_ros` starts: modules of `authguard_r.integrations.ros.nodes`."""

import signal
import sys
from importlib import import_module
from typing import NoReturn

#: What a process ends with that cannot be started.
WRONG = 2


def gate_node() -> NoReturn:
    """Stand between planners and the robot."""
    _start("node")


def actuator() -> NoReturn:
    """Relay velocities to the base while the gate's node lives."""
    _start("actuator")


def deadman() -> NoReturn:
    """Cancel what runs when the gate's node is gone.

    SIGINT is everybody's at once, from a terminal and from launch; this process has to be there
    until the gate's node is not. SIGTERM ends it.
    """
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    _start("deadman")


def estimator() -> NoReturn:
    """Attest where the robot is."""
    _start("estimator")


def _start(name: str) -> NoReturn:
    """Become a process; what is not installed is named, and nothing runs."""
    try:
        process = import_module(f"authguard_r.integrations.ros.nodes.{name}")
    except ImportError as error:
        sys.stderr.write(
            f"{name}: {error}; it needs `pip install 'authguard-r[ros]'` for this Python, "
            "and a shell that has sourced ROS 2\n"
        )
        sys.exit(WRONG)
    sys.exit(process.main())
