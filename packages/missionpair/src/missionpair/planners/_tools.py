# SPDX-License-Identifier: Apache-2.0
"""The tools that a planner is offered: a binding in the form in which models read tools.

Nothing of a mission is in it, and nothing of the gate: names, what they are for, what arguments
they take. Arguments that the binding refuses, and tools that no planner may use, are not offered.
Spec page: docs/spec/binding.md
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from decimal import Decimal
from fractions import Fraction
from types import MappingProxyType
from typing import Any

from authguard_r.core.identifiers import ParameterId, RobotId
from authguard_r.normalize.binding import (
    POSE,
    REGION,
    Argument,
    ArgumentUse,
    Binding,
    ToolBinding,
    is_index,
    ways_of,
)
from authguard_r.site.model import ActionModel, Site
from missionpair.briefing import OfferedTool

#: A unit and how many of it one of the argument's is: what people call that.
_UNITS = {
    ("mm/s", "1000"): "m/s",
    ("mm", "1000"): "m",
    ("mm", "10"): "cm",
    ("mN", "1000"): "N",
    ("ms", "1000"): "s",
    ("ms", "60000"): "min",
    ("g", "1000"): "kg",
}
_OBJECT, _STRING = "object", {"type": "string"}


def places_of(site: Site) -> tuple[str, ...]:
    """Return the spellings of places that a planner may use; an id only where there is no other."""
    return tuple(
        name for region, model in site.regions.items() for name in model.names or (str(region),)
    )


def things_of(site: Site) -> tuple[str, ...]:
    """Return the spellings of things that a planner may use; an id only where there is no other."""
    return tuple(
        name for item, model in site.objects.items() for name in model.names or (str(item),)
    )


def tools_of(
    site: Site,
    binding: Binding,
    *,
    robot: RobotId | None = None,
    beyond: Mapping[str, str] = MappingProxyType({}),
    in_words: bool = True,
) -> tuple[OfferedTool, ...]:
    """Return the tools of a binding, in its order.

    Args:
        site: whose names and words they speak.
        binding: the planner's interface.
        robot: leave out what it cannot do; None offers every tool.
        beyond: tools by action type that are offered although the robot's profile lacks them.
        in_words: list the names that an argument may be; else it is any text, as interfaces have it
            that do not know their site.
    """
    able = None if robot is None else site.robots[robot].profile.tools
    more = set(beyond.items())
    offered = []
    for name in binding.tools:
        found = [way.tool for way in ways_of(binding, name)]
        usable = [
            tool
            for tool in found
            if not site.vocabulary[tool.type].state_writing
            and (
                able is None
                or tool.tool in able.get(tool.type, ())
                or (tool.type, tool.tool) in more
            )
        ]
        if usable:
            words = _Words(site, in_words=in_words, most=_most(site, robot))
            offered.append(_tool(name, usable, words))
    return tuple(offered)


class _Words:
    """Makes the schema of one argument.

    Args:
        site: whose names.
        in_words: list them.
        most: by parameter, the most that the robot can do, in the site's unit.
    """

    def __init__(self, site: Site, *, in_words: bool, most: Mapping[str, int]) -> None:
        self._in_words, self._most = in_words, most
        self._places, self._things = places_of(site), things_of(site)
        self._maps = tuple(dict.fromkeys(str(model.map) for model in site.regions.values()))
        self.site = site

    def schema(self, tool: ToolBinding, name: str, argument: Argument) -> dict[str, Any]:
        """Return what the argument may be, as JSON schema."""
        if argument.use is ArgumentUse.FIXED:
            return _constant(argument.constant())
        if argument.use is ArgumentUse.NOTED:
            return {**_STRING, "description": f"{name.rpartition('.')[2]}, for people"}
        if argument.each:
            item = _nested(
                {key: self.schema(tool, key, each) for key, each in _offered(argument.each)},
                required=_required(_offered(argument.each)),
            )
            return {"type": "array", "items": item, "description": "places, in order"}
        if argument.values:
            return {**_STRING, "enum": list(argument.values)}
        return self._mapped(argument, self.site.vocabulary[tool.type])

    def _mapped(self, argument: Argument, kind: ActionModel) -> dict[str, Any]:
        match argument.to:
            case "object":
                return self._name(self._things, "thing")
            case "destination" | "source" | "region":
                return self._name(self._places, "place" if argument.to == REGION else argument.to)
            case "route":
                return {"type": "array", "items": self._name(self._places, "place on the way")}
            case "pose.map":
                return self._name(self._maps, "map")
            case to if to in POSE:
                return {"type": "number", "description": f"in {unit_of(argument, 'mm')}"}
        name = argument.to.removeprefix("params.")
        end = self._most.get(name)
        most = (
            {} if end is None else {"maximum": _plain(Fraction(end) / Fraction(argument.per_unit))}
        )
        return {
            "type": "integer" if argument.whole else "number",
            "description": f"in {unit_of(argument, kind.params[ParameterId(name)].unit)}",
            **most,
        }

    def _name(self, names: Sequence[str], what: str) -> dict[str, Any]:
        listed = {"enum": list(names)} if self._in_words and names else {}
        return {**_STRING, "description": what, **listed}


def _most(site: Site, robot: RobotId | None) -> dict[str, int]:
    """Return how fast and how hard a robot can, by parameter; nothing of any robot."""
    if robot is None:
        return {}
    profile = site.robots[robot].profile
    return {"speed_mm_s": profile.max_speed_mm_s, "force_mn": profile.max_force_mn}


def _plain(value: Fraction) -> int | float:
    return int(value) if value.denominator == 1 else float(value)


def unit_of(argument: Argument, unit: str) -> str:
    """Return the unit in which a planner gives a number."""
    scale = Fraction(argument.per_unit)
    if scale == 1:
        return unit
    return _UNITS.get((unit, str(scale)), f"{scale} {unit}")


def _tool(name: str, ways: list[ToolBinding], words: _Words) -> OfferedTool:
    """Return one tool; where it can be used in several ways, what each of them takes."""
    schemas: dict[str, dict[str, Any]] = {}
    needed: list[set[str]] = []
    for way in ways:
        offered = _offered(way.arguments)
        for path, argument in offered:
            _take_in(schemas, path, words.schema(way, path, argument))
        for path, constant in way.when.items():
            _take_in(schemas, path, _constant(constant))
        needed.append({*_required(offered), *way.when})
    always = set.intersection(*needed)
    required_paths = [path for path in schemas if path in always]
    kinds = dict.fromkeys(str(way.type).replace("_", " ") for way in ways)
    return OfferedTool(
        name=name,
        description=f"{' or '.join(kinds)}, with the {ways[0].tool}.".capitalize(),
        parameters=_nested(schemas, required=required_paths),
    )


def _take_in(schemas: dict[str, dict[str, Any]], path: str, schema: dict[str, Any]) -> None:
    """Let an argument be what it is in one more way of its tool."""
    held = schemas.setdefault(path, schema)
    if held == schema:
        return
    if set(held) == set(schema) == {"enum"}:
        new = [one for one in schema["enum"] if one not in held["enum"]]
        schemas[path] = {"enum": [*held["enum"], *new]}
        return
    others = held.get("anyOf", [held])
    schemas[path] = {"anyOf": others if schema in others else [*others, schema]}


def _offered(arguments: dict[str, Argument]) -> list[tuple[str, Argument]]:
    return [(path, a) for path, a in arguments.items() if a.use is not ArgumentUse.REFUSED]


def _required(offered: list[tuple[str, Argument]]) -> list[str]:
    return [path for path, a in offered if not a.optional and a.use is not ArgumentUse.NOTED]


def _constant(value: Any) -> dict[str, Any]:
    return {"enum": [float(value) if isinstance(value, Decimal) else value]}


def _nested(schemas: dict[str, dict[str, Any]], *, required: list[str]) -> dict[str, Any]:
    """Return the schema of an object whose fields stand on dotted paths."""
    heads: dict[str, dict[str, dict[str, Any]]] = {}
    for path, schema in schemas.items():
        head, _, rest = path.partition(".")
        heads.setdefault(head, {})[rest] = schema
    properties = {}
    for head, below in heads.items():
        inner = [path.partition(".")[2] for path in required if path.startswith(f"{head}.")]
        leaf = below.pop("", None)
        found = [leaf] if leaf is not None else []
        found += [_below(below, inner)] if below else []
        properties[head] = found[0] if len(found) == 1 else {"anyOf": found}
    wanted = dict.fromkeys(path.partition(".")[0] for path in required)
    return {
        "type": _OBJECT,
        "properties": properties,
        "required": list(wanted),
        "additionalProperties": False,
    }


def _below(schemas: dict[str, dict[str, Any]], required: list[str]) -> dict[str, Any]:
    """Return the schema of what lies below one name: a list's items, or an object's fields."""
    made = _nested(schemas, required=required)
    if not all(map(is_index, made["properties"])):
        return made
    items = [made["properties"][key] for key in sorted(made["properties"], key=int)]
    return {"type": "array", "prefixItems": items, "maxItems": len(items)}
