# SPDX-License-Identifier: Apache-2.0
"""How a call of a tool is said in English, for writing and for reading: verbs and what follows.

A frame belongs to the tools that mean one thing; at most one of them is offered at a time. A tool
without a frame is named outright: "call the tool `open_door` with door = "D1"".
Spec page: docs/spec/missionpair-access.md#wording
"""

from __future__ import annotations

from enum import StrEnum

from msgspec import Struct


class Says(StrEnum):
    """What kind of words fill a slot."""

    PLACE = "place"
    THING = "thing"
    PLACES = "places"
    NUMBER = "number"
    QUOTE = "quote"


class FrameSlot(Struct, frozen=True, kw_only=True):
    """One argument of a frame.

    Args:
        names: what tools call it; a tool has one of them.
        says: what fills it.
        marks: what may stand before it; an empty one: nothing. The first ones are written.
        written: how many of the marks are written.
        unit: what is written after a number, and then how many times its size what was said has.
        units: what may stand after a number, and how many of `unit` one of it is.
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
    default: int | None = None
    optional: bool = False


class CallFrame(Struct, frozen=True, kw_only=True):
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


_METERS = {"m/s": 1, "mps": 1, "meters per second": 1, "metres per second": 1}
_NEWTONS = {"N": 1, "newtons": 1, "newton": 1}
_SECONDS = {
    "seconds": 1,
    "second": 1,
    "sec": 1,
    "s": 1,
    "minutes": 60,
    "minute": 60,
    "min": 60,
    "hours": 3600,
    "hour": 3600,
}
_PLACE = ("destination", "place", "location", "room", "zone", "region", "area", "to")
_THING = ("object", "item", "thing", "sample", "asset")

_FORCE = FrameSlot(
    names=("force",),
    says=Says.NUMBER,
    marks=("with", "with a force of", "using", "at"),
    written=3,
    unit="N",
    units=_NEWTONS,
    optional=True,
)

_MEGABYTES = FrameSlot(
    names=("megabytes",),
    says=Says.NUMBER,
    marks=("with", "using", "of", "in"),
    written=2,
    unit="megabytes",
    units={"megabytes": 1, "megabyte": 1, "MB": 1},
    optional=True,
)

FRAMES: tuple[CallFrame, ...] = (
    CallFrame(
        tools=(
            "navigate_to",
            "drive_to",
            "go_to",
            "walk_to",
            "goto_room",
            "move_to_zone",
            "move_to",
            "navigate",
        ),
        verbs=(
            "go to",
            "drive to",
            "head to",
            "proceed to",
            "move to",
            "navigate to",
            "continue to",
            "make your way to",
            "travel to",
            "report to",
        ),
        also=(
            "go",
            "go into",
            "drive",
            "drive into",
            "move",
            "navigate",
            "return to",
            "return",
            "come to",
            "deliver to",
            "go back to",
            "enter",
            "head for",
            "turn to",
            "divert to",
            "go straight to",
        ),
        slots=(
            FrameSlot(names=_PLACE, says=Says.PLACE),
            FrameSlot(
                names=("via", "route", "through", "past", "via_rooms", "waypoints"),
                says=Says.PLACES,
                marks=("via", "through", "by way of", "over", "using", "past", "along"),
                written=4,
                optional=True,
            ),
            FrameSlot(
                names=("speed",),
                says=Says.NUMBER,
                marks=("at", "at a speed of", "with a speed of", "with", "doing"),
                written=3,
                unit="m/s",
                units=_METERS,
                optional=True,
            ),
        ),
    ),
    CallFrame(
        tools=("pick_up", "pick", "grab", "fetch", "grip", "grasp"),
        verbs=("pick up", "take", "grab", "collect", "fetch", "lift", "get"),
        also=("pick", "use", "bring", "carry", "deliver", "grasp", "take along"),
        slots=(FrameSlot(names=_THING, says=Says.THING), _FORCE),
    ),
    CallFrame(
        tools=("put_down", "put", "set_down", "hand_over", "release", "place", "drop"),
        verbs=("put down", "place", "set down", "drop off", "leave", "unload", "put"),
        also=("drop", "hand over", "lay", "store"),
        slots=(
            FrameSlot(names=_THING, says=Says.THING),
            FrameSlot(
                names=("at", *_PLACE, "on", "in"),
                says=Says.PLACE,
                marks=("at", "in", "on", "into", "to", "onto"),
                written=3,
                optional=True,
            ),
            _FORCE,
        ),
    ),
    CallFrame(
        tools=("wait", "wait_for", "pause", "stand", "dwell", "hold"),
        verbs=("wait for", "wait", "pause for", "hold still for", "stand still for", "hold for"),
        also=("stop for", "stop", "hold", "pause", "halt", "stay here", "stay", "stand by"),
        slots=(
            FrameSlot(
                names=("seconds", "duration", "time"),
                says=Says.NUMBER,
                marks=("", "here for", "for", "another", "at least", "here"),
                unit="seconds",
                units=_SECONDS,
                default=600,
            ),
        ),
    ),
    CallFrame(
        tools=(
            "take_photo",
            "take_picture",
            "take_still",
            "photograph",
            "snapshot",
            "capture_image",
        ),
        verbs=("take a photo", "take a picture", "take a photograph", "snap a photo"),
        also=("take photos", "take pictures", "photograph", "capture an image", "take one photo"),
    ),
    CallFrame(
        tools=("record_video", "film", "record", "record_clip", "capture_video"),
        verbs=("record a video for", "record video for", "film for", "make a recording of"),
        also=("record a video", "record video", "start recording", "film", "take a video"),
        slots=(
            FrameSlot(
                names=("seconds", "duration", "time"),
                says=Says.NUMBER,
                marks=("", "for", "of", "lasting"),
                unit="seconds",
                units=_SECONDS,
                default=30,
            ),
            _MEGABYTES,
        ),
    ),
    CallFrame(
        tools=("survey_zone", "survey"),
        verbs=("survey", "make a survey of", "map out"),
        slots=(FrameSlot(names=_PLACE, says=Says.PLACE), _MEGABYTES),
    ),
    CallFrame(
        tools=("inspect_asset", "inspect"),
        verbs=("inspect", "examine", "have a close look at"),
        slots=(FrameSlot(names=_THING, says=Says.THING), _MEGABYTES),
    ),
    *(
        CallFrame(tools=(tool,), verbs=verbs, slots=(FrameSlot(names=_THING, says=Says.THING),))
        for tool, verbs in (
            ("turn_on", ("turn on", "switch on")),
            ("turn_off", ("turn off", "switch off")),
            ("open", ("open", "open up")),
            ("close", ("close", "shut")),
            ("wipe", ("wipe", "wipe off")),
        )
    ),
    CallFrame(
        tools=("scan", "look", "look_around", "scan_path", "check_clear", "check_clearance"),
        verbs=("scan for obstacles", "look around for obstacles", "check the way for obstacles"),
        also=("look around", "scan the area"),
    ),
    CallFrame(
        tools=("relocalize", "set_pose"),
        verbs=("set your position to", "relocalize at", "set your location to"),
        slots=(FrameSlot(names=_PLACE, says=Says.PLACE),),
    ),
    CallFrame(
        tools=("say", "announce", "speak"),
        verbs=("say", "announce", "say aloud"),
        slots=(FrameSlot(names=("text", "message", "words"), says=Says.QUOTE),),
    ),
)

#: The frame of each tool that has one.
FRAME_OF: dict[str, CallFrame] = {tool: frame for frame in FRAMES for tool in frame.tools}
