# SPDX-License-Identifier: Apache-2.0
"""The gate's node, whose executors or event loop get stuck for ever when a signal says so.

Nothing of the node is another than in earnest: it is only known here what spins.
"""

from __future__ import annotations

import signal
import threading
from typing import Any

from authguard_r.integrations.ros.nodes import loop, node

#: What gets stuck of which signal.
EXECUTORS, LOOP = signal.SIGUSR1, signal.SIGUSR2
#: Of the three executors the one alone that reaches the robot.
ROBOTS = signal.Signals.SIGWINCH
_spinners: list[loop.Spinner] = []
_never = threading.Event()


def main() -> None:
    """Be the node."""
    begin = loop.Spinner.start

    def started(spinner: loop.Spinner) -> None:
        _spinners.append(spinner)
        begin(spinner)

    loop.Spinner.start = started  # type: ignore[method-assign]
    signal.signal(EXECUTORS, _stick_executors)
    signal.signal(LOOP, _stick_loop)
    signal.signal(ROBOTS, _stick_robots)
    node.main()


def _stick_executors(*_: Any) -> None:
    for spinner in _spinners:
        spinner._executor.create_task(_never.wait)


def _stick_robots(*_: Any) -> None:
    for spinner in _spinners:
        if spinner.node.get_name() == "gate_robot":
            spinner._executor.create_task(_never.wait)


def _stick_loop(*_: Any) -> None:
    _never.wait()  # a handler runs on the thread of the event loop


if __name__ == "__main__":
    main()
