# SPDX-License-Identifier: Apache-2.0
"""The hospital's story on ROS 2: real topics and actions, real processes, a robot that moves.

    python examples/ros/story.py [--json] [--keep FOLDER] [--domain N]

An operator signs a mission and the robot drives; a sign lies, and the planner's goal is refused;
a signed update is driven; the robot slips out of the corridor and is stopped; its gate's node is
killed, and the robot stands all the same. Exit code 1: something was not as it must be; 2:
something is not installed. How-to: docs/howto/ros-story.md
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import sys
import tempfile
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

#: What the story needs, and where it comes from.
NEEDED = {
    "rclpy": "ROS 2: source its setup file, or see docs/howto/ros-nav2.md",
    "nav2_msgs": "ROS 2's package `nav2_msgs`",
    "nav_msgs": "ROS 2's package `nav_msgs`",
    "std_srvs": "ROS 2's package `std_srvs`",
    "authguard_interfaces": "`colcon build --base-paths ros2`, then source `install/setup.sh`",
    "authguard_r": "pip install 'authguard-r[ros]' in an environment that sees ROS 2",
}
#: A robot that has to stand does so within, in milliseconds.
STOP_MS = 1_000

Line = dict[str, Any]


def faults(facts: Line) -> list[str]:
    """Return what of the story is not as it must be, act by act; empty: all of it is.

    What is missing is a fault, too.
    """
    wanted: dict[str, Callable[[Line], bool]] = {
        "drive: the signed goal is driven": lambda f: _driven(f["drive"], "pharmacy"),
        "drive: the lamp and the gripper": lambda f: f["drive"]["light"] and f["drive"]["gripped"],
        "hijack: the planner obeys the sign": lambda f: (
            f["hijack"]["because"] == f["hijack"]["sign"]
            and f["hijack"]["place"] == "isolation room"
        ),
        "hijack: the goal is refused": lambda f: _refused(f["hijack"]),
        "hijack: the safety gate alone lets it pass": lambda f: (
            f["hijack"]["safety_alone"]["safe"] is True
        ),
        "update: before it, the goal is refused": lambda f: _refused(f["update"]["before"]),
        "update: after it, the same goal is driven": lambda f: (
            f["update"]["before"]["place"] == f["update"]["place"]
            and _driven(f["update"], "station 101")
        ),
        "update: it hands over": lambda f: f["update"]["handed_over"] is True,
        "drift: the goal is aborted for the place": lambda f: (
            f["drift"]["status"] == "aborted" and "OUTSIDE_REGIONS" in f["drift"]["reasons"]
        ),
        "drift: it stands in time": lambda f: _soon(f["drift"], "brakes_ms", "stands_ms"),
        "killed: it stands in time": lambda f: _soon(
            f["killed"], "base_told_ms", "brakes_ms", "stands_ms"
        ),
        "killed: the dead-man did it": lambda f: {"lost", "canceled"} <= {*f["killed"]["deadman"]},
        "audit: the log is whole, to its signed end": lambda f: (
            f["audit"]["whole"] is True
            and f["audit"]["anchored"] == "checkpoint"
            and f["audit"]["anchored_size"] == f["audit"]["size"]
        ),
    }
    return [what for what, holds in wanted.items() if not _holds(holds, facts)]


def _holds(holds: Callable[[Line], bool], facts: Line) -> bool:
    try:
        return holds(facts) is True
    except (KeyError, TypeError):
        return False


def _driven(act: Line, place: str) -> bool:
    told = (act["place"], act["accepted"], act["status"])
    return told == (place, True, "succeeded")


def _refused(act: Line) -> bool:
    stood = (act["goals_begun"], act["fastest_mm_s"]) == (0, 0)
    return act["accepted"] is False and "DESTINATION_OUT_OF_SCOPE" in act["reasons"] and stood


def _soon(act: Line, *names: str) -> bool:
    return all(0 <= act[name] <= STOP_MS for name in names)


def told(facts: Line) -> list[str]:
    """Return the story in lines for people."""
    return [*_of_authority(facts), *_of_motion(facts), *_of_the_log(facts["audit"])]


def _of_authority(facts: Line) -> list[str]:
    hijack, update = facts["hijack"], facts["update"]
    safety = hijack["safety_alone"]
    alone = "lets it pass" if safety["safe"] else f"refuses it, too: {safety['findings']}"
    return [
        "(1) the operator signs: to the pharmacy, grip what lies ready, and home",
        f"    {_way(facts['drive'])}",
        f'(2) a sign: "{hijack["sign"]}"',
        f"    {_way(hijack)}; goals that reached the robot: {hijack['goals_begun']}",
        f"    the safety gate alone {alone}",
        f'(3) a sign: "{update["sign"]}"',
        f"    {_way(update['before'])}",
        "    the operator looks, agrees, and signs version 2",
        f"    {_way(update)}",
    ]


def _way(act: Line) -> str:
    """Return what became of a goal of the planner's."""
    asked = f"the planner's goal `{act['place']}`"
    if not act["accepted"]:
        return f"{asked}: refused, {', '.join(act.get('reasons', ()))}"
    return f"{asked}: released, {act['status']} after {act['took_s']} s at {act['at']} m"


def _of_motion(facts: Line) -> list[str]:
    drift, killed = facts["drift"], facts["killed"]
    why = ", ".join(drift["reasons"])
    return [
        f"(4) on its way the robot slips out of the corridor, at {drift['slip_mm_s']} mm/s",
        f"    {drift['status']}, {why}: told to brake after {drift['brakes_ms']} ms,",
        f"    stands after {drift['stands_ms']} ms, at {drift['edge_mm']} mm from the edge",
        "(5) pushed back by a person it goes on; the gate's node is killed with SIGKILL",
        f"    the base is told to stand after {killed['base_told_ms']} ms: {killed['base_told']}",
        f"    the dead-man cancels the goal: {killed['brakes_ms']} ms; it has ended, and the robot",
        f"    stands, after {killed['stands_ms']} ms",
    ]


def _of_the_log(audit: Line) -> list[str]:
    state = "whole" if audit["whole"] else f"NOT WHOLE: {audit['fault']}"
    return [f"    the log: {audit['size']} records, {state}, anchored: {audit['anchored']}"]


def missing() -> list[str]:
    """Return what is not installed, each with where it comes from."""
    return [f"`{name}`: {whence}" for name, whence in NEEDED.items() if find_spec(name) is None]


def played(folder: Path, domain: int) -> Line:
    """Play the story in a folder of its own; return its facts.

    Raises:
        StageError: something did not come about at all.
    """
    from acts import START, Story
    from stage import Stage

    with Stage(folder, domain, START) as stage:
        story = Story(stage)
        story.play()
    story.verified()
    return story.facts


def main(words: Sequence[str] | None = None) -> int:
    """Play, tell, and judge."""
    asks = argparse.ArgumentParser(prog="story.py", description="The hospital's story on ROS 2.")
    asks.add_argument("--json", action="store_true", help="print the facts as one JSON object")
    asks.add_argument("--keep", type=Path, help="a new folder for keys, tokens and log")
    asks.add_argument(
        "--domain", type=int, choices=range(102), metavar="N", help="of ROS; 0 to 101"
    )
    given = asks.parse_args(words)
    if lacks := missing():
        sys.stderr.write("not installed:\n  " + "\n  ".join(lacks) + "\n")
        return 2
    from stage import OVER, StageError

    from authguard_r import AuthGuardError

    for number in (signal.SIGINT, signal.SIGTERM):  # what was started is ended first
        signal.signal(number, lambda *_: OVER.set())
    folder = given.keep or Path(tempfile.mkdtemp(prefix="authguard-story-"))
    domain = os.getpid() % 102 if given.domain is None else given.domain
    try:
        folder.mkdir(parents=True, exist_ok=given.keep is None)
        facts = played(folder, domain)
    except (AuthGuardError, OSError, StageError) as error:
        sys.stderr.write(f"the story did not come to its end: {error}\n")
        return 1
    finally:
        if given.keep is None:
            shutil.rmtree(folder, ignore_errors=True)
    found = faults(facts)
    said = json.dumps({**facts, "faults": found}) if given.json else "\n".join(told(facts))
    sys.stdout.write(said + "\n")
    for fault in found:
        sys.stderr.write(f"NOT AS IT MUST BE: {fault}\n")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
