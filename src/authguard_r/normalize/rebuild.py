# SPDX-License-Identifier: Apache-2.0
"""From an action back to the call that is dispatched: a pure function of what was authorized.

The planner's own bytes never reach the executor. What it left open, what it only noted, how it
spelled a name and where in a room it pointed are gone: equal action scopes are equal calls. A
field that no bound tool can carry refuses the action instead of dropping the field.
Spec page: docs/spec/binding.md#rebuilding
"""

from __future__ import annotations

from typing import Any

import msgspec

from authguard_r.core.action import Action
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import ActionType, ParameterId, ToolId
from authguard_r.core.reasons import Reason
from authguard_r.normalize.binding import (
    POSE,
    REGION,
    STOPS,
    Argument,
    ArgumentUse,
    Binding,
    ToolBinding,
    ToolWay,
    is_index,
    ways_of,
)
from authguard_r.normalize.dialects import Call
from authguard_r.normalize.places import Places
from authguard_r.normalize.quantity import COORDINATE, unscale
from authguard_r.site.model import Site

#: The place of every rebuilt call, which has no author.
WHERE = "rebuilt"
_BYTES = msgspec.json.Encoder(order="sorted", decimal_format="number")


class _CannotCarryError(Exception):
    """This way has no place for a field of the action; another way may."""


class Rebuilder:
    """Turns actions of one site into calls of one planner interface.

    Args:
        site: the site whose words the actions are in.
        binding: sound for that site (`normalize.binding.require_sound`).
    """

    def __init__(self, site: Site, binding: Binding) -> None:
        self._site = site
        self._places = Places(site)
        self._ways: dict[tuple[ActionType, ToolId], list[ToolWay]] = {}
        for name in sorted(binding.tools):  # an order that the binding's digest covers
            for way in ways_of(binding, name):
                self._ways.setdefault((way.tool.type, way.tool.tool), []).append(way)

    def rebuild(self, action: Action, *, tool: str | None = None) -> Call:
        """Return the exact call that carries the action out.

        Args:
            action: what was authorized, in the site's words.
            tool: the external tool to use; None: the first, by name, that can carry it.

        Raises:
            MalformedError: no way carries every field of the action (`TOOL_UNKNOWN`).

        Source: section "Normalized Actions". Guaranteed: equal scopes are equal calls, and binding
        the call gives the same scope again, but for what attested state fills. Wrong reading: that
        a call can be rebuilt does not mean that it is allowed.
        """
        for way in self._ways.get((action.type, action.tool), ()):
            if tool in {None, way.name}:
                try:
                    return Call(way.name, self._arguments(way.tool, action), WHERE)
                except _CannotCarryError:
                    continue
        raise MalformedError(
            f"expected a bound tool that carries `{action.type}` by `{action.tool}` as it is",
            where="action.tool",
            reason=Reason.TOOL_UNKNOWN,
        )

    def _arguments(self, tool: ToolBinding, action: Action) -> dict[str, Any]:
        fields = _fields_of(action)
        for target, value in tool.fixed.items():
            if target not in POSE and fields.pop(target, None) != value:
                raise _CannotCarryError
        for target in tool.attested:
            fields.pop(target, None)
        targets = {argument.to for argument in tool.arguments.values()}
        if POSE[0] in targets:
            frame = tool.fixed.get(POSE[2])
            fields |= self._pose(fields.pop("destination", None), targets, frame)
        if STOPS in targets:
            fields[STOPS] = (*fields.pop("route", ()), fields.pop("destination", None))
        return nested({**self._given(tool.arguments, fields, tool.type), **tool.when})

    def _given(
        self, arguments: dict[str, Argument], fields: dict[str, Any], kind: ActionType
    ) -> dict[str, Any]:
        """Return the value of each argument by its path; every field must have been used."""
        given: dict[str, Any] = {}
        for path, argument in arguments.items():
            if argument.use is not ArgumentUse.MAPPED:
                if argument.constant() is not None:
                    given[path] = argument.constant()
            elif argument.to in fields:
                given[path] = self._spelled(argument, fields.pop(argument.to), kind)
            elif not argument.optional or argument.default is not None:
                raise _CannotCarryError
        if fields:
            raise _CannotCarryError
        return given

    def _spelled(self, argument: Argument, value: Any, kind: ActionType) -> Any:
        """Return a field's value as the tool reads it."""
        if argument.each:
            return [self._item(argument, region, kind) for region in value]
        if argument.to == "route":
            return [_name(region, self._site.regions) for region in value]
        if argument.to == "object":
            return _name(value, self._site.objects)
        if argument.to in {"source", "destination", REGION}:
            return _name(value, self._site.regions)
        if argument.to == POSE[2]:
            return value
        if argument.values:
            return _word(value, argument.values)
        parameter = COORDINATE
        if argument.to not in POSE:
            name = ParameterId(argument.to.removeprefix("params."))
            parameter = self._site.vocabulary[kind].params[name]
        return _carried(unscale(value, argument, parameter))

    def _item(self, argument: Argument, region: Any, kind: ActionType) -> Any:
        targets = {one.to for one in argument.each.values()}
        fields = {REGION: region} if REGION in targets else self._pose(region, targets, None)
        return nested(self._given(argument.each, fields, kind))

    def _pose(self, region: Any, targets: set[str], frame: Any) -> dict[str, Any]:
        """Return where a robot halts in a region, once that position means this region."""
        model = self._site.regions.get(region)
        if model is None or frame not in {None, model.map}:
            raise _CannotCarryError
        seen = model.map if POSE[2] in targets else frame
        try:
            found = self._places.region_at(model.approach, seen, where=WHERE)
        except MalformedError as error:
            raise _CannotCarryError from error
        if found != region:
            raise _CannotCarryError
        place: dict[str, Any] = dict(zip(POSE, (*model.approach, model.map), strict=True))
        return {target: value for target, value in place.items() if target in targets}


def call_bytes(call: Call) -> bytes:
    """Return the bytes by which two dispatched calls are compared: canonical, numbers exact."""
    return _BYTES.encode({"tool": call.tool, "arguments": call.arguments})


def _carried(value: Any) -> Any:
    if value is None:
        raise _CannotCarryError
    return value


def _fields_of(action: Action) -> dict[str, Any]:
    """Return what the action settles, by target; an empty route settles nothing."""
    fields: dict[str, Any] = {
        "object": action.object,
        "source": action.source,
        "destination": action.destination,
        "route": action.route or None,
        **{f"params.{name}": value for name, value in action.params.items()},
    }
    return {target: value for target, value in fields.items() if value is not None}


def _name(item: str, known: Any) -> str:
    """Return the first external spelling of a region or object, its id when it has none."""
    model = _carried(known.get(item))
    return str(model.names[0]) if model.names else item


def _word(value: int, values: dict[str, int]) -> Any:
    """Return the first word that means the number."""
    return _carried(next((word for word, number in values.items() if number == value), None))


def nested(flat: dict[str, Any]) -> dict[str, Any]:
    """Return arguments by path as the tool has them: nested, counted names as lists."""
    whole: dict[str, Any] = {}
    for path, value in flat.items():
        *parents, last = path.split(".")
        node = whole
        for parent in parents:
            node = node.setdefault(parent, {})
        node[last] = value
    return {name: _listed(value) for name, value in whole.items()}


def _listed(value: Any) -> Any:
    if not isinstance(value, dict):
        return value
    if value and all(map(is_index, value)):
        return [_listed(value[str(number)]) for number in range(len(value))]
    return {name: _listed(item) for name, item in value.items()}
