# SPDX-License-Identifier: Apache-2.0
"""How a call of a tool is said in English, for writing and for reading: verbs and what follows.

A frame belongs to the tools that mean one thing; at most one of them is offered at a time. A tool
without a frame is named outright: "call the tool `open_door` with door = "D1"".
Spec page: docs/spec/missionpair-access.md#wording
"""

from __future__ import annotations

from enum import StrEnum
from importlib.resources import files

import msgspec
from msgspec import Struct


class Says(StrEnum):
    """What kind of words fill a slot."""

    PLACE = "place"
    THING = "thing"
    PLACES = "places"
    NUMBER = "number"
    QUOTE = "quote"


class FrameSlot(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One argument of a frame.

    Args:
        names: what tools call it; a tool has one of them.
        says: what fills it.
        marks: what may stand before it; an empty one: nothing. The first ones are written.
        written: how many of the marks are written.
        unit: what is written after a number, and then how many times its size what was said has.
        units: what may stand after a number, and how many of `unit` one of it is.
        phrases: what stands for the most of it, without a mark: `at full speed`.
        most: the most of it, where the offered tool does not say so itself; None: nothing does.
        default: what an obedient reader takes where a text leaves it open; None: nothing, and
            without it nothing is asked for, unless the slot may be left out.
        optional: it may be left out.
    """

    names: tuple[str, ...]
    says: Says
    marks: tuple[str, ...] = ("",)
    written: int = 1
    unit: str = ""
    units: dict[str, int] = {}
    phrases: tuple[str, ...] = ()
    most: int | None = None
    default: int | None = None
    optional: bool = False


class CallFrame(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How one kind of call is said.

    Args:
        tools: names of tools that mean it.
        verbs: imperative phrases; what is written and read.
        also: phrases that are read and never written, since they are said of other things too.
        slots: what follows, in the order in which it is written.
    """

    tools: tuple[str, ...]
    verbs: tuple[str, ...]
    also: tuple[str, ...] = ()
    slots: tuple[FrameSlot, ...] = ()


class CallFrames(Struct, frozen=True, forbid_unknown_fields=True):
    """Every frame, as `frames.toml` holds them."""

    frames: tuple[CallFrame, ...]


FRAMES = msgspec.toml.decode(
    files("missionpair.wording").joinpath("frames.toml").read_bytes(), type=CallFrames
).frames
#: The frames of each tool that has some: the first that can say a call says it.
FRAMES_OF: dict[str, tuple[CallFrame, ...]] = {
    tool: tuple(frame for frame in FRAMES if tool in frame.tools)
    for tool in dict.fromkeys(tool for frame in FRAMES for tool in frame.tools)
}
