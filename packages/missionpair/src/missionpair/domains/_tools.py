# SPDX-License-Identifier: Apache-2.0
"""Tools as several domains offer them, each under its own name."""

from __future__ import annotations

from missionpair.layouts.words import ToolWords

_SPEED, _FORCE = "params.speed_mm_s", "params.force_mn"
_BYTES, _TIME = "params.max_bytes", "params.duration_ms"


def go(name: str, to: str, *, via: str = "via", speed: int, base: str = "base") -> ToolWords:
    """Return the tool that drives to a place."""
    return ToolWords(
        name=name,
        type="navigate",
        tool=base,
        arguments={"destination": to, "route": via, _SPEED: "speed"},
        usual={"speed_mm_s": speed},
    )


def take(name: str, thing: str, *, force: int, hand: str = "gripper") -> ToolWords:
    """Return the tool that picks a thing up."""
    return ToolWords(
        name=name,
        type="pick",
        tool=hand,
        arguments={"object": thing, _FORCE: "force"},
        usual={"force_mn": force},
    )


def put(name: str, thing: str, at: str, *, force: int, hand: str = "gripper") -> ToolWords:
    """Return the tool that puts down what is held."""
    return ToolWords(
        name=name,
        type="place",
        tool=hand,
        arguments={"object": thing, "destination": at, _FORCE: "force"},
        usual={"force_mn": force},
    )


def photo(name: str, *, megabytes: int = 4, camera: str = "camera") -> ToolWords:
    """Return the tool that takes one image of where the robot stands."""
    return ToolWords(
        name=name, type="take_photo", tool=camera, fixed={"max_bytes": megabytes * 10**6}
    )


def video(name: str, *, camera: str = "camera") -> ToolWords:
    """Return the tool that records where the robot stands."""
    arguments = {_TIME: "seconds", _BYTES: "megabytes"}
    return ToolWords(
        name=name,
        type="record_video",
        tool=camera,
        arguments=arguments,
        usual={"max_bytes": 3 * 10**6},
    )


def scan(name: str, tool: str = "lidar") -> ToolWords:
    """Return the tool that looks for obstacles and keeps nothing."""
    return ToolWords(name=name, type="scan_obstacles", tool=tool)


def wait(name: str) -> ToolWords:
    """Return the tool that stands still for a time."""
    return ToolWords(name=name, type="wait", tool="base", arguments={_TIME: "seconds"})


def say(name: str, tool: str = "speaker") -> ToolWords:
    """Return the tool that speaks."""
    return ToolWords(name=name, type="announce", tool=tool)


def inspect(name: str, thing: str, *, camera: str = "camera") -> ToolWords:
    """Return the tool that shows one thing to a model outside the robot."""
    return ToolWords(
        name=name,
        type="inspect",
        tool=camera,
        arguments={"object": thing, _BYTES: "megabytes"},
        usual={"max_bytes": 2 * 10**6},
    )


def use(name: str, kind: str, thing: str, *, hand: str = "gripper") -> ToolWords:
    """Return a tool that acts on a thing where it stands."""
    return ToolWords(name=name, type=kind, tool=hand, arguments={"object": thing})
