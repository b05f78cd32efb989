# SPDX-License-Identifier: Apache-2.0
"""Free texts with what a model made of them: the actions when the text states them all, or why not.

What is expected is written here by hand, from docs/spec/normalize.md.
"""

from __future__ import annotations

import json
from typing import Any

Json = dict[str, Any]
Call = tuple[str, Json]
#: A vector: the free text, the model's calls (or its reply as it is), and what is expected.
Case = tuple[str, list[Call] | str, Json]

GO, PICK, PUT, WAIT = "navigate_to", "pick_up", "put_down", "wait"
PHOTO, VIDEO, SCAN = "take_photo", "record_video", "scan"


def stated_vectors() -> Json:
    """Free texts with a model's reply, over the hospital's site and binding."""
    cases = {**honest(), **names(), **objects(), **values(), **tools(), **replies()}
    return {
        "site": "examples/hospital/site.yaml",
        "binding": "examples/hospital/binding.yaml",
        "vectors": [
            {
                "name": name,
                "text": text,
                "reply": made if isinstance(made, str) else reply(*made),
                "expect": expect,
            }
            for name, (text, made, expect) in cases.items()
        ],
        "ambiguous": ambiguous(),
        "lengths": [
            {"character": "a", "count": 16_384, "expect": "ok"},
            {"character": "a", "count": 16_385, "expect": "INPUT_TOO_LARGE"},
            {"character": "\u00e9", "count": 16_384, "expect": "ok"},
            {"character": "\u00e9", "count": 16_385, "expect": "INPUT_TOO_LARGE"},
        ],
    }


def reply(*calls: Call) -> str:
    """Return what a model answers, in the dialect `json`."""
    return json.dumps({"plan": [{"tool": tool, "arguments": given} for tool, given in calls]})


def go(place: str, **more: Any) -> Call:
    """Return a call to a place."""
    return GO, {"destination": place, **more}


def way(place: str, speed: int = 500, **more: Any) -> Json:
    """Return the action of such a call; 500 mm/s when the text says nothing else."""
    params = {"speed_mm_s": speed}
    return {"type": "navigate", "tool": "base", "destination": place, "params": params, **more}


def grip(kind: str, item: str, force: int = 10_000, **more: Any) -> Json:
    """Return a grip or a release; 10 N when the text says nothing else."""
    params = {"force_mn": force}
    return {"type": kind, "tool": "gripper", "object": item, "params": params, **more}


def pause(duration_ms: int) -> Json:
    """Return a wait."""
    return {"type": "wait", "tool": "base", "params": {"duration_ms": duration_ms}}


def video(duration_ms: int) -> Json:
    """Return a recording, at most as large as the binding says."""
    params = {"duration_ms": duration_ms, "max_bytes": 60_000_000}
    return {"type": "record_video", "tool": "camera", "params": params}


def does(*actions: Json) -> Json:
    """Return what is expected of a text that states everything."""
    return {"actions": [*actions]}


def no(reason: str, where: str) -> Json:
    """Return a refusal."""
    return {"refusal": {"reason": reason, "where": where}}


UNNAMED = no("NAME_UNKNOWN", "actions[0].destination")
UNSTATED = no("VALUE_INVALID", "actions[0].params.speed_mm_s")
UNSTATED_TIME = no("VALUE_INVALID", "actions[0].params.duration_ms")


def honest() -> dict[str, Case]:
    """A model that repeats the text."""
    fetch = "Pick up Package P1, drive to Nurse Station 101 at 0.8 m/s and put P1 down in Room 101."
    calls = [
        (PICK, {"object": "Package P1"}),
        go("Nurse Station 101", speed=0.8),
        (PUT, {"object": "P1", "at": "Room 101"}),
    ]
    actions = [
        grip("pick", "package-p1"),
        way("station-101", 800),
        grip("place", "package-p1", destination="station-101"),
    ]
    return {
        "a drive": ("Go to Station 101.", [go("Station 101")], does(way("station-101"))),
        "a whole errand": (fetch, calls, does(*actions)),
        "a route": (
            "To the Dock via Corridor, please",
            [go("Dock", via=["Corridor"])],
            does(way("dock", route=["public-corridor"])),
        ),
        "another name of the same place in the reply": (
            "Go to Room 101",
            [go("station-101")],
            does(way("station-101")),
        ),
        "the identifier in the text": (
            "go to (station-101);",
            [go("Room 101")],
            does(way("station-101")),
        ),
        "another case and spacing": (
            "GO TO nurse  STATION\n101!",
            [go("Nurse Station 101")],
            does(way("station-101")),
        ),
        "in quotation marks": ('go to "Dock".', [go("Dock")], does(way("dock"))),
        "negation is not read": (
            "Do not drive to Office 1.",
            [go("Office 1")],
            does(way("office-1")),
        ),
        "verbs are not read": (
            "Leave P1 alone.",
            [(PICK, {"object": "P1"})],
            does(grip("pick", "package-p1")),
        ),
        "order is not read, and a call may be repeated": (
            "first the Dock, then the Pharmacy",
            [go("Pharmacy"), go("Dock"), go("Pharmacy")],
            does(way("pharmacy"), way("dock"), way("pharmacy")),
        ),
        "a part of the text may be left out": (
            "first the Dock, then the Pharmacy",
            [go("Dock")],
            does(way("dock")),
        ),
    }


def names() -> dict[str, Case]:
    """Names of places: whole, the site's own, the longest."""
    near = {
        "a name that the text's name begins": "go to Room 10",
        "a name with one digit more": "go to Room 1011",
        "a number in two parts": "go to Room 10 1",
        "a number without its word": "go to 101",
        "an underscore": "go to Station_101",
        "a word in front, joined": "go to pre-Station 101",
        "letters behind, joined": "go to Station 101-B",
        "a possessive": "go to Station 101's closet",
        "a slash": "go to Station 101/B",
        "a letter of another script": "go to St\u0430tion 101",
        "a digit for a letter": "go to Stati0n 101",
        "a character of no width": "go to Station 101\u200bB",
        "a number in words": "go to Station one hundred and one",
        "a plural": "go to Stations 101 and 102",
    }
    return {
        **{name: (text, [go("Station 101")], UNNAMED) for name, text in near.items()},
        "a longer number names its own place": (
            "go to Room 102",
            [go("Room 102")],
            does(way("station-102")),
        ),
        "a swapped place": ("go to Station 101", [go("Station 102")], UNNAMED),
        "a place for a thing": ("bring it to P1", [go("Pharmacy")], UNNAMED),
        "a name within a longer one": (
            "through the Staff Corridor",
            [go("Corridor")],
            UNNAMED,
        ),
        "the longer name": (
            "through the Staff Corridor",
            [go("Service Corridor")],
            does(way("staff-corridor")),
        ),
        "both names, each on its own": (
            "through the Staff Corridor, then the Corridor",
            [go("Corridor")],
            does(way("public-corridor")),
        ),
        "an added stop on the route": (
            "to the Dock via Corridor",
            [go("Dock", via=["Corridor", "Office 1"])],
            no("NAME_UNKNOWN", "actions[0].route[1]"),
        ),
        "an added drive": (
            "go to the Dock",
            [go("Dock"), go("Isolation Room")],
            no("NAME_UNKNOWN", "actions[1].destination"),
        ),
    }


def objects() -> dict[str, Case]:
    """Names of things, and where they are put."""
    return {
        "a swapped object": (
            "pick up P1",
            [(PICK, {"object": "P2"})],
            no("NAME_UNKNOWN", "actions[0].object"),
        ),
        "an object whose name goes on": (
            "pick up P11",
            [(PICK, {"object": "P1"})],
            no("NAME_UNKNOWN", "actions[0].object"),
        ),
        "an object that is not named": (
            "pick up the package",
            [(PICK, {"object": "Package P1"})],
            no("NAME_UNKNOWN", "actions[0].object"),
        ),
        "put down elsewhere": (
            "put P1 down in Room 101",
            [(PUT, {"object": "P1", "at": "Room 103"})],
            no("NAME_UNKNOWN", "actions[0].destination"),
        ),
        "another thing put down there": (
            "put P1 down in Room 101",
            [(PUT, {"object": "Sharps Bin", "at": "Room 101"})],
            no("NAME_UNKNOWN", "actions[0].object"),
        ),
        "a stated force": (
            "grip P1 with 20 N",
            [(PICK, {"object": "P1", "force": 20})],
            does(grip("pick", "package-p1", 20_000)),
        ),
        "a force that is not stated": (
            "grip P1 with 20 N",
            [(PICK, {"object": "P1", "force": 40})],
            no("VALUE_INVALID", "actions[0].params.force_mn"),
        ),
    }


def values() -> dict[str, Case]:
    """Numbers with their units, exactly; a value of the binding needs none."""
    half = does(way("station-101", 600))
    asked = [go("Station 101", speed=0.6)]
    stated = {
        "in meters per second": "Station 101 at 0.6 m/s",
        "without a space": "Station 101 at 0.6m/s.",
        "in millimeters per second": "Station 101, slowly (600 mm/s)",
        "in centimeters per second": "Station 101 at 60 cm/s, please",
    }
    unstated = {
        "a changed number": "Station 101 at 0.5 m/s",
        "one digit more": "Station 101 at 0.61 m/s",
        "one digit in front": "Station 101 at 10.6 m/s",
        "no unit": "Station 101 at 0.6",
        "a unit of length": "Station 101 at 0.6 m",
        "a unit of time": "Station 101 at 0.6 s",
        "backwards": "Station 101 at -0.6 m/s",
        "two numbers and one unit": "Station 101 at 1 0.6 m/s",
        "a number in words": "Station 101 at six hundred mm/s",
        "no number at all": "Station 101, slowly",
    }
    return {
        **{f"a speed {name}": (text, asked, half) for name, text in stated.items()},
        **{f"a speed: {name}": (text, asked, UNSTATED) for name, text in unstated.items()},
        "a default that the text does not state": (
            "Station 101, slowly",
            [go("Station 101", speed=0.5)],
            does(way("station-101")),
        ),
        "a stated speed that is left out: the default": (
            "Station 101 at 0.3 m/s",
            [go("Station 101")],
            does(way("station-101")),
        ),
        "the digits of a name are no value": (
            "Wait in Station 101 s",
            [(WAIT, {"seconds": 101})],
            UNSTATED_TIME,
        ),
        "minutes for seconds": ("Wait 2 min", [(WAIT, {"seconds": 120})], does(pause(120_000))),
        "a number that is taken over without its unit": (
            "Wait 2 min",
            [(WAIT, {"seconds": 2})],
            UNSTATED_TIME,
        ),
        "the first part of a compound": (
            "wait 1 h 30 min",
            [(WAIT, {"seconds": 3_600})],
            UNSTATED_TIME,
        ),
        "the last part of a compound": (
            "wait 1 h 30 min",
            [(WAIT, {"seconds": 1_800})],
            UNSTATED_TIME,
        ),
        "one of two durations": (
            "wait 30 s, not 1 min",
            [(WAIT, {"seconds": 30})],
            does(pause(30_000)),
        ),
        "a duration of the recording": (
            "record video for 90 s",
            [(VIDEO, {"seconds": 90})],
            does(video(90_000)),
        ),
        "a longer recording": ("record video for 90 s", [(VIDEO, {"seconds": 900})], UNSTATED_TIME),
    }


def tools() -> dict[str, Case]:
    """An action without a place and an object needs the name of its tool in the text."""
    photo = {"type": "take_photo", "tool": "camera", "params": {"max_bytes": 4_000_000}}
    scan = {"type": "scan_obstacles", "tool": "lidar"}
    return {
        "a tool in words": ("Take photo now.", [(PHOTO, {})], does(photo)),
        "a tool as it is called": ("take_photo", [(PHOTO, {})], does(photo)),
        "another word for it": (
            "look around",
            [(PHOTO, {})],
            no("NAME_UNKNOWN", "actions[0].tool"),
        ),
        "a tool within a word": (
            "retake photo",
            [(PHOTO, {})],
            no("NAME_UNKNOWN", "actions[0].tool"),
        ),
        "an added call without names": (
            "go to the Dock",
            [go("Dock"), (PHOTO, {})],
            no("NAME_UNKNOWN", "actions[1].tool"),
        ),
        "a second call without names that the text has": (
            "scan, then go to the Dock",
            [(SCAN, {}), go("Dock")],
            does(scan, way("dock")),
        ),
        "the duration without the tool": (
            "stay there for 5 s",
            [(WAIT, {"seconds": 5})],
            no("NAME_UNKNOWN", "actions[0].tool"),
        ),
    }


def replies() -> dict[str, Case]:
    """A reply is normalized like any other plan, and nothing of it is repaired."""
    text = "Go to Station 101."
    return {
        "a reply in a fence": (
            text,
            f"```json\n{reply(go('Station 101'))}\n```",
            no("MALFORMED", "input[0]"),
        ),
        "a place that the site does not have": (
            "Go to Station 999.",
            [go("Station 999")],
            no("NAME_UNKNOWN", "plan[0].destination"),
        ),
        "a tool that is not bound": (text, [("fly", {})], no("TOOL_UNKNOWN", "plan[0].tool")),
        "a speed beyond the type's": (
            "Station 101 at 9 m/s",
            [go("Station 101", speed=9)],
            no("VALUE_OUT_OF_RANGE", "plan[0].speed"),
        ),
        "no call": (text, [], no("PLAN_EMPTY", "input")),
    }


def ambiguous() -> list[Json]:
    """Texts over the hospital where two things have one more name each, the same in any case."""
    clear = {"field": "actions[0].destination"}
    both = [go("station-101")]
    bays: Json = {"station-101": "Bay", "station-102": "BAY"}
    mixed: Json = {"station-101": "Bay", "package-p1": "bay"}
    apart: Json = {"station-101": "Nurse Bay", "station-102": "Bay 7"}
    cases: dict[str, tuple[Json, str, list[Call], Json]] = {
        "a name of two places": (bays, "go to Bay", both, {"clarification": clear}),
        "a name of a place and a thing": (mixed, "go to BAY", both, {"clarification": clear}),
        "for an object": (
            mixed,
            "pick up Bay",
            [(PICK, {"object": "package-p1"})],
            {"clarification": {"field": "actions[0].object"}},
        ),
        "beside a clear name": (
            bays,
            "go to Bay, which is Room 101",
            both,
            does(way("station-101")),
        ),
        "of another place than the asked one": (bays, "go to Bay", [go("Dock")], UNNAMED),
        "names that share a word, the first": (apart, "go to Nurse Bay 7", both, UNNAMED),
        "names that share a word, the second": (
            apart,
            "go to Nurse Bay 7",
            [go("station-102")],
            UNNAMED,
        ),
    }
    return [
        {"name": name, "names": also, "text": text, "reply": reply(*calls), "expect": expect}
        for name, (also, text, calls, expect) in cases.items()
    ]
