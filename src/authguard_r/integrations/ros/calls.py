# SPDX-License-Identifier: Apache-2.0
"""What is mediated, as the calls that a binding speaks of: the shapes of rosbridge's operations.

A goal is `send_action_goal {action, action_type, args}`, a service `call_service {service, type,
args}`, a message `publish {topic, type, msg}`, each with the name that moves the robot.
Spec page: docs/spec/ros.md#calls
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from msgspec import Struct
from msgspec.structs import replace

from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.integrations.ros.map import Mediated, MediationKind, RosMap
from authguard_r.normalize.binding import Binding, ToolBinding, ways_of
from authguard_r.normalize.dialects import Call
from authguard_r.site.model import ActionModel, Site, stopping_mm

#: The parameter that makes velocities a stream.
DURATION = "duration_ms"
_VELOCITY = ("_mm_s", "_urad_s")


class CallForm(Struct, frozen=True):
    """The shape of a call.

    Args:
        tool: its name.
        name: the argument that says what moves.
        type: the argument that says of which type.
        body: the argument that has the message.
    """

    tool: str
    name: str
    type: str
    body: str


_PUBLISH = CallForm("publish", "topic", "type", "msg")
FORMS = {
    MediationKind.ACTION: CallForm("send_action_goal", "action", "action_type", "args"),
    MediationKind.SERVICE: CallForm("call_service", "service", "type", "args"),
    MediationKind.MESSAGE: _PUBLISH,
    MediationKind.STREAM: _PUBLISH,
}


def call_of(item: Mediated, plain: dict[str, Any]) -> Call:
    """Return the call that a planner's message is; its content is untrusted."""
    form = FORMS[item.kind]
    arguments: dict[str, Any] = {form.name: item.private, form.type: item.type}
    if plain:  # a type without a field says nothing
        arguments[form.body] = plain
    return Call(form.tool, arguments, "ros")


def body_of(item: Mediated, arguments: dict[str, Any]) -> Any:
    """Return the message's data among a rebuilt call's arguments."""
    return arguments.get(FORMS[item.kind].body, {})


def item_of(call: Call, ros: RosMap) -> str:
    """Return which mediated thing a rebuilt call moves, by its name in the map.

    Raises:
        MalformedError: none.
    """
    for key, item in ros.mediated.items():
        form = FORMS[item.kind]
        said = (call.tool, call.arguments.get(form.name), call.arguments.get(form.type))
        if said == (form.tool, item.private, item.type):
            return key
    raise MalformedError(
        "expected something that the map mediates", where="call", reason=Reason.TOOL_UNKNOWN
    )


def bound(binding: Binding, ros: RosMap, site: Site) -> Binding:
    """Return the part of a binding that speaks of what is mediated: actions are rebuilt in it.

    Raises:
        MalformedError: nothing of the binding is a mediated thing, or it is mediated as another
            kind than what it does.
    """
    kept: dict[str, tuple[ToolBinding, ...]] = {}
    known: set[str] = set()
    for name in binding.tools:
        ways = [way.tool for way in ways_of(binding, name)]
        items = [_item(name, tool, ros) for tool in ways]
        for tool, key in zip(ways, items, strict=True):
            if key:
                _require_kind(key, ros.mediated[key].kind, site.vocabulary[tool.type])
        known.update(items)
        mine = tuple(tool for tool, key in zip(ways, items, strict=True) if key)
        if mine:
            kept[name] = mine
    for key in ros.mediated:
        if key not in known:
            raise MalformedError(
                "expected a way of the binding with this name and type", where=f"mediated.{key}"
            )
    return replace(binding, tools=kept)


def fitted(binding: Binding, ros: RosMap, site: Site) -> Binding:
    """Return the part of a binding that speaks of what is mediated, for a robot that can be held.

    What a node looks at before it serves, and who asks whether it would.

    Args:
        binding: sound for the site; the gate's own.
        ros: the robot's map.
        site: the site.

    Raises:
        MalformedError: the site has no such robot; its profile does not say how it brakes, and it
            has streams; or as `bound`.
    """
    robot = site.robots.get(ros.robot)
    if robot is None:
        raise MalformedError("expected a robot of the site", where="map.robot")
    spoken = bound(binding, ros, site)
    for key, item in ros.mediated.items():
        # a robot that is not known to stand is not steered
        if item.kind is MediationKind.STREAM and stopping_mm(robot.profile, 1) is None:
            text = "expected a robot whose profile says how it brakes"
            raise MalformedError(text, where=f"mediated.{key}")
    return spoken


def spelled(binding: Binding, ros: RosMap, takes: Callable[[str, str], bool]) -> Binding:
    """Return a binding whose actions are rebuilt with the names that the installed types have.

    Distributions of ROS name a field differently: Nav2's `poses` was a list until Kilted.

    Args:
        binding: as `bound` returns it.
        ros: the robot's map.
        takes: tells whether the type of what is mediated under a key has a path.
    """
    found: dict[str, tuple[ToolBinding, ...]] = {}
    for name in binding.tools:
        ways = [way.tool for way in ways_of(binding, name)]
        found[name] = tuple(_spelled(tool, name, _item(name, tool, ros), takes) for tool in ways)
    return replace(binding, tools=found)


def _spelled(
    tool: ToolBinding, name: str, key: str, takes: Callable[[str, str], bool]
) -> ToolBinding:
    below = f"{next(form.body for form in FORMS.values() if form.tool == name)}."
    arguments = {}
    for path, argument in tool.arguments.items():
        names = (path, *argument.also)
        fits = (n for n in names if n.startswith(below) and takes(key, n.removeprefix(below)))
        first = next(fits, path)
        others = tuple(other for other in names if other != first)
        arguments[first] = argument if first == path else replace(argument, also=others)
    return replace(tool, arguments=arguments)


def velocities(kind: ActionModel) -> frozenset[str]:
    """Return the velocities of an action type that is some for a time; empty: it is none."""
    names = {str(name) for name in kind.params} - {DURATION}
    is_stream = DURATION in kind.params and all(name.endswith(_VELOCITY) for name in names)
    return frozenset(names) if is_stream else frozenset()


def _item(name: str, tool: ToolBinding, ros: RosMap) -> str:
    """Return which mediated thing a way moves, empty when none."""
    constants = {path: a.constant() for path, a in tool.arguments.items()} | tool.when
    for key, item in ros.mediated.items():
        form = FORMS[item.kind]
        said = (name, constants.get(form.name), constants.get(form.type))
        if said == (form.tool, item.private, item.type):
            return key
    return ""


def _require_kind(key: str, kind: MediationKind, model: ActionModel) -> None:
    """Require that velocities are a stream, and nothing else that moves is a message."""
    where = f"mediated.{key}.kind"
    if kind is MediationKind.STREAM and not velocities(model):
        raise MalformedError("expected velocities and a duration in the binding", where=where)
    if kind is MediationKind.MESSAGE and model.moves:
        raise MalformedError("expected a stream: a topic that moves the robot", where=where)
