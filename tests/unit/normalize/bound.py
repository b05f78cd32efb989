# SPDX-License-Identifier: Apache-2.0
"""A small site with the standard words, and bindings of a few lines for it."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from authguard_r.authoring.binding.check import BindingReport, check_binding
from authguard_r.authoring.binding.samples import probe_site
from authguard_r.core.action import Action
from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.normalize.bind import Binder
from authguard_r.normalize.binding import Binding, load_binding
from authguard_r.normalize.dialects import Call
from authguard_r.normalize.interface import Surface
from authguard_r.normalize.rebuild import Rebuilder
from authguard_r.site.model import Region, Site
from authguard_r.site.source import convert
from authguard_r.site.words import standard_words

Plain = dict[str, Any]


def plain(tools: Plain, **more: Any) -> Plain:
    return {"schema": "authguard-r/binding/1", "id": "test", "tools": tools, **more}


def square(x: int, y: int = 0, *, frame: str = "map", side: int = 2000, **more: Any) -> Region:
    points = ((x, y), (x + side, y), (x + side, y + side), (x, y + side))
    approach = more.pop("approach", (x + side // 2, y + side // 2))
    return Region(map=frame, floor=0, points=points, approach=approach, tags=("public",), **more)


def site(**regions: Region) -> Site:
    """Return three squares apart, `Square 1` to `Square 3`, and whatever is added to them."""
    empty = Binding(schema="authguard-r/binding/1", id="test", tools={})
    base = probe_site(empty, standard_words())
    return msgspec.structs.replace(base, regions={**base.regions, **regions})


def load(tools: Plain, where: Site | None = None) -> Binding:
    return load_binding(plain(tools), site=where or site(), where="binding")


def fault(tool: Any, where: Site | None = None) -> tuple[str, str]:
    """Return place and message of the first fault of a binding with one tool `go`."""
    with pytest.raises(MalformedError) as caught:
        load({"go": tool}, where)
    return caught.value.where, caught.value.message


def bind(tool: Any, arguments: Plain, where: Site | None = None) -> Action:
    """Return what a call of the one tool `go` means."""
    place = where or site()
    return Binder(place, load({"go": tool}, place)).bind(Call("go", arguments, "input"))


def refused(
    tool: Any, arguments: Plain, reason: Reason, where: str, at: Site | None = None
) -> MalformedError:
    """Assert that a call of the one tool `go` is refused for this reason in this place."""
    with pytest.raises(MalformedError) as caught:
        bind(tool, arguments, at)
    assert (caught.value.reason, caught.value.where) == (reason, where)
    return caught.value


def rebuilt(tool: Any, action: Action, where: Site | None = None) -> Plain:
    """Return the arguments of the call of the one tool `go` that carries the action out."""
    place = where or site()
    call = Rebuilder(place, load({"go": tool}, place)).rebuild(action)
    assert (call.tool, call.where) == ("go", "rebuilt")
    return call.arguments


def mapped(to: str, **more: Any) -> Plain:
    return {"use": "mapped", "to": to, **more}


def fixed(value: Any, **more: Any) -> Plain:
    return {"use": "fixed", "value": value, **more}


def number(to: str) -> Plain:
    return mapped(to, per_unit="1000")


NOTED: Plain = {"use": "noted"}
REFUSED: Plain = {"use": "refused"}

#: A nested goal with a position in meters, as ROS has it.
POSE: Plain = {
    "header.frame_id": mapped("pose.map"),
    "pose.position.x": number("pose.x"),
    "pose.position.y": number("pose.y"),
    "pose.position.z": fixed(0, optional=True),
    "pose.orientation.z": NOTED,
    "pose.orientation.w": {"use": "noted", "value": 1},
}
HELD: Plain = {
    "attested": ["source"],
    "fixed": {"params.speed_mm_s": 500},
    "monitored": ["params.speed_mm_s"],
}
GO_TO_POSE: Plain = {
    "type": "navigate",
    "tool": "base",
    **HELD,
    "arguments": {
        **{f"goal.{path}": argument for path, argument in POSE.items()},
        "behavior_tree": fixed("", optional=True),
    },
}
GO_BY_STOPS: Plain = {
    "type": "navigate",
    "tool": "base",
    **HELD,
    "arguments": {"poses": mapped("stops", each=POSE)},
}
WAIT: Plain = {"type": "wait", "tool": "base"}


def wait(**argument: Any) -> Plain:
    """Return a tool that waits, with one argument `seconds`."""
    given = {**mapped("params.duration_ms", per_unit="1000"), **argument}
    return {**WAIT, "arguments": {"seconds": given}}


def spot(x: Any, y: Any, frame: Any = "map") -> Plain:
    """Return a stamped pose in meters."""
    return {"header": {"frame_id": frame}, "pose": {"position": {"x": x, "y": y}}}


def unchecked(tools: Plain) -> Binding:
    """Return a binding that may be unsound."""
    return convert(plain(tools), Binding, where="binding")


def report(tools: Plain, where: Site | None = None, *surfaces: Surface) -> BindingReport:
    return check_binding(unchecked(tools), where or site(), interface=surfaces)


def faults(found: BindingReport) -> list[str]:
    return [fault.where for fault in found.faults]
