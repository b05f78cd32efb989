# SPDX-License-Identifier: Apache-2.0
"""How soon a guarded robot stands, and its goal is canceled, when the gate's own node dies.

Run in an environment with rclpy (`tests/ros/make.sh`), in a network of its own:

    sh tests/ros/alone.sh ENVIRONMENT/bin/python benchmarks/ros_dead_node.py --json out.json

The processes are those that are deployed: gate, node, dead-man, the base's relay. A planner steers
and a goal runs beside that; then the node is killed or stopped, or what spins in it gets stuck.
Each trial has new processes, each fault takes its turn; times are from the fault to the zero in the
base's topic and to the canceled goal. `ros_faults.py` has the same of a node that is a stand-in.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import sys
import time
from contextlib import redirect_stdout
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "src")]

from geometry_msgs.msg import Twist  # noqa: E402
from test_msgs.action import Fibonacci  # noqa: E402

import machine  # noqa: E402
from fixtures.gate_process import until  # noqa: E402
from fixtures.ros_processes import TRANSPORT  # noqa: E402
from ros.deployed import FAULTS, guarded  # noqa: E402
from ros.graph import Goal, Stick  # noqa: E402
from ros.hospital import hospital  # noqa: E402
from ros_faults import in_turns, show  # noqa: E402

AHEAD = 0.2


def trial(fault: signal.Signals) -> tuple[float, float]:
    """Return how many milliseconds after the fault the base stood and the goal was canceled."""
    with (
        TemporaryDirectory(prefix="ag-ros-") as folder,
        hospital() as gate,
        guarded(Path(folder), gate) as robot,
    ):
        graph, arm = robot.graph, robot.graph.robot.chimes
        planner = graph.planner()
        assert Goal(
            planner, planner.client(Fibonacci, "/llm/chimes"), Fibonacci.Goal(order=3)
        ).accepted
        stick = Stick(planner, Twist, "/llm/cmd_vel")
        stick.message = Twist()
        stick.message.linear.x = AHEAD
        until(lambda: robot.wheels.speeds[-1:] == [AHEAD], "the velocity")
        time.sleep(random.uniform(0.1, 0.3))  # between two samples, wherever it hits
        begun = graph.signal(fault)
        stood = robot.stood_s(begun)
        until(lambda: arm.canceled, "the cancellation")
        graph.signal(signal.SIGKILL)
        return 1e3 * (stood - begun), 1e3 * (arm.canceled_s - begun)


def main() -> None:
    """Measure, print a table, write what was asked for."""
    asks = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    asks.add_argument("--trials", type=int, default=11)
    asks.add_argument("--json", type=Path)
    given = asks.parse_args()
    os.environ.update(TRANSPORT)
    # what a graph of the tests says at its end is for whoever looks for a cause
    with redirect_stdout(sys.stderr):
        once = {name: partial(trial, fault) for name, fault in FAULTS.items()}
        found = in_turns(once, given.trials)
    show(found)
    if given.json is not None:
        result = {
            "schema": "authguard-r/ros-dead-node/1",
            **machine.describe(Path(__file__).parent),
            "trials": given.trials,
            "load": [round(load, 1) for load in os.getloadavg()],
            "faults": found,
        }
        given.json.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
