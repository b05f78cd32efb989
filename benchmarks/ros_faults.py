# SPDX-License-Identifier: Apache-2.0
"""`python benchmarks/ros_faults.py --ros ENVIRONMENT`: how soon a robot stands without its gate.

The node is a stand-in here, so that single faults can be put into it; `ros_dead_node.py` has the
gate's own. From a fault to the zero velocity in a base's driver, and to the canceled goal in
an action's server: real processes over real DDS, each trial with new ones. `ENVIRONMENT` is a
folder with rclpy. Run it where no other robot is (`unshare -rn sh -c 'ip link set lo up; ...'`).
"""

from __future__ import annotations

import argparse
import json
import os
import random
import statistics
import sys
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import machine

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))
from fixtures.ros_processes import Driving, Robot, Watched

#: Told to a base with the events of DDS, and to one with its own watch alone.
FAULTS = {
    "kill -9": ("SIGKILL", ()),
    "kill -9, own watch alone": ("SIGKILL", ("no-events",)),
    "SIGSTOP": ("SIGSTOP", ()),
    "a clean end": ("leave", ()),
    "a dead-locked executor": ("deadlock", ()),
    "a stuck asyncio loop": ("stick", ()),
    "a lease that ends": ("end", ()),
}
#: Reached in a trial before any of this was written, in milliseconds.
ACTUATOR_MS, CANCELED_MS = 100.0, 98.0


def trial(python: str, fault: str, base: tuple[str, ...]) -> tuple[float, float]:
    """Return how many milliseconds after the fault the base stood and the goal was canceled."""
    with Robot(python) as robot:
        driving = Driving(Watched(robot, *base))
        time.sleep(random.uniform(0, 0.2))  # between two samples, wherever it hits
        begun = driving.fault(fault)
        return driving.stopped_ms(begun), driving.canceled_ms(begun)


def in_turns(
    faults: Mapping[str, Callable[[], tuple[float, float]]], trials: int
) -> dict[str, Any]:
    """Return medians and extremes of every fault; faults take turns.

    Args:
        faults: by its name, what does a trial of one and returns how many milliseconds after it
            the base stood and the goal was canceled.
        trials: of each.
    """
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in faults}
    for number in range(trials):
        for name, once in faults.items():
            times[name].append(once())
            stands, canceled = times[name][-1]
            said = f"{number + 1}/{trials} {name}: stands {stands:.0f} ms, canceled {canceled:.0f}"
            print(said, file=sys.stderr, flush=True)
    return {
        name: {
            "stands_ms": _told([stands for stands, _ in samples]),
            "canceled_ms": _told([canceled for _, canceled in samples]),
        }
        for name, samples in times.items()
    }


def show(found: Mapping[str, Any]) -> None:
    """Print a table of what `in_turns` returned."""
    print("| fault | stands, ms: median (most) | canceled, ms: median (most) |\n|---|---|---|")
    for name, told in found.items():
        stands, canceled = told["stands_ms"], told["canceled_ms"]
        print(f"| {name} | {stands['median']:.0f} ({stands['most']:.0f}) ", end="")
        print(f"| {canceled['median']:.0f} ({canceled['most']:.0f}) |")


def _told(samples: list[float]) -> dict[str, Any]:
    return {
        "median": round(statistics.median(samples), 1),
        "least": round(min(samples), 1),
        "most": round(max(samples), 1),
        "samples": [round(sample, 1) for sample in samples],
    }


def main() -> int:
    """Measure, print a table, write what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--ros", type=Path, required=True, help="an environment with rclpy")
    parser.add_argument("--trials", type=int, default=11)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    python = str(options.ros / "bin" / "python")
    once = {name: partial(trial, python, *fault) for name, fault in FAULTS.items()}
    found = in_turns(once, options.trials)
    show(found)
    result = {
        "schema": "authguard-r/ros-faults/1",
        **machine.describe(Path(__file__).parent),
        "trials": options.trials,
        "load": [round(load, 1) for load in os.getloadavg()],  # what else the machine had to do
        "before": {"stands_ms": ACTUATOR_MS, "canceled_ms": CANCELED_MS},
        "faults": found,
    }
    if options.json is not None:
        options.json.write_text(json.dumps(result, indent=2) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
