# SPDX-License-Identifier: Apache-2.0
"""The JSON Schema of one argument: the values that its binding reads, in the site's words.

A schema is advice: a model that keeps to it is refused less often. The binding decides, and every
call is read by it. Spec page: docs/spec/adapters.md#schemas
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from decimal import Decimal
from fractions import Fraction
from math import ceil, floor
from typing import Any

from authguard_r.core.identifiers import ParameterId
from authguard_r.normalize.binding import (
    POSE,
    REGION,
    Argument,
    ArgumentUse,
    ToolBinding,
    is_index,
)
from authguard_r.site.model import ActionModel, Site

Schema = dict[str, Any]
#: Longest list of names that a schema spells out; a longer one would fill a model's context.
MAX_NAMES = 100
#: A unit, how many of it one of the argument's is, and what is added: what people call that.
_UNITS = {
    ("mm/s", "1000", 0): "m/s",
    ("mm", "1000", 0): "m",
    ("mm", "10", 0): "cm",
    ("mN", "1000", 0): "N",
    ("ms", "1000", 0): "s",
    ("ms", "60000", 0): "min",
    ("g", "1000", 0): "kg",
    ("millikelvin", "1000", 273_150): "degrees Celsius",
}
#: The last decimal of an end that has no short one.
_DIGITS = 1_000_000
#: How many millimeters one of a length is, with nothing added.
_LENGTHS = {(Fraction(scale), 0) for scale in (1, 10, 1_000)}
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


class ArgumentSchemas:
    """Makes schemas of arguments.

    Args:
        site: whose names and ranges.
        names: longest list of names that is spelled out; of a longer one a schema says nothing.
        most: by parameter, the most that it may be, in the site's unit; None: the vocabulary's
            ranges.
    """

    def __init__(
        self, site: Site, *, names: int = MAX_NAMES, most: Mapping[str, int] | None = None
    ) -> None:
        self._names, self._most = names, most
        self._places, self._things = places_of(site), things_of(site)
        self._maps = tuple(dict.fromkeys(str(model.map) for model in site.regions.values()))
        self._site = site

    def of(self, tool: ToolBinding, name: str, argument: Argument) -> Schema:
        """Return what an argument may be, with its unit as the description."""
        if argument.use is ArgumentUse.FIXED:
            return constant(argument.constant())
        if argument.use is ArgumentUse.NOTED:
            return {**_STRING, "description": f"{name.rpartition('.')[2]}, for people"}
        if argument.each:
            offered = offered_of(argument.each)
            fields = {key: self.of(tool, key, each) for key, each in offered}
            item = nested(fields, required=required_of(offered))
            return {"type": "array", "items": item, "description": "places, in order"}
        if argument.values:
            return {**_STRING, "enum": list(argument.values)}
        return self._mapped(argument, self._site.vocabulary[tool.type])

    def _mapped(self, argument: Argument, kind: ActionModel) -> Schema:
        match argument.to:
            case "object":
                return self._name(self._things, "thing")
            case "destination" | "source" | "region":
                return self._name(self._places, "place" if argument.to == REGION else argument.to)
            case "route":
                return {"type": "array", "items": self._name(self._places, "place on the way")}
            case "pose.map":
                return self._name(self._maps, "map")
            case to if to in POSE and (Fraction(argument.per_unit), argument.offset) in _LENGTHS:
                return {"type": "number", "description": f"in {unit_of(argument, 'mm')}"}
            case to if to in POSE:  # degrees of latitude, or a grid of its own
                return {"type": "number"}
        return self._number(argument, kind)

    def _number(self, argument: Argument, kind: ActionModel) -> Schema:
        name = ParameterId(argument.to.removeprefix("params."))
        parameter = kind.params[name]
        if self._most is None:
            ends = {"minimum": parameter.low, "maximum": parameter.high}
            ends |= {} if argument.default is None else {"default": argument.default}
        else:
            ends = {"maximum": self._most[name]} if name in self._most else {}
        return {
            "type": "integer" if argument.whole else "number",
            "description": f"in {unit_of(argument, parameter.unit)}",
            **{end: _in_tool_units(value, argument, end) for end, value in ends.items()},
        }

    def _name(self, names: Sequence[str], what: str) -> Schema:
        listed = {"enum": list(names)} if 0 < len(names) <= self._names else {}
        return {**_STRING, "description": what, **listed}


def _in_tool_units(value: int, argument: Argument, end: str) -> int | float:
    """Return a number as the tool counts, inside the range where it has no short decimal."""
    exact = (value - argument.offset) / Fraction(argument.per_unit)
    if exact.denominator == 1:
        return int(exact)
    inward = ceil if end == "minimum" else floor
    scaled = exact * _DIGITS
    return float(exact) if scaled.denominator == 1 else inward(scaled) / _DIGITS


def unit_of(argument: Argument, unit: str) -> str:
    """Return the unit in which a planner gives a number."""
    scale = Fraction(argument.per_unit)
    known = _UNITS.get((unit, str(scale), argument.offset))
    if known is None:
        known = unit if scale == 1 else f"{scale} {unit}"
        known += f", plus {argument.offset} {unit}" if argument.offset else ""
    return known


def constant(value: Any) -> Schema:
    """Return the schema of an argument that is one value."""
    return {"enum": [float(value) if isinstance(value, Decimal) else value]}


def offered_of(arguments: Mapping[str, Argument]) -> list[tuple[str, Argument]]:
    """Return the arguments that a planner may give."""
    return [(path, a) for path, a in arguments.items() if a.use is not ArgumentUse.REFUSED]


def required_of(offered: Sequence[tuple[str, Argument]]) -> list[str]:
    """Return the paths of the arguments that a planner must give."""
    return [path for path, a in offered if not a.optional and a.use is not ArgumentUse.NOTED]


def nested(schemas: Mapping[str, Schema], *, required: Sequence[str]) -> Schema:
    """Return the schema of an object whose fields stand on dotted paths."""
    heads: dict[str, dict[str, Schema]] = {}
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


def _below(schemas: Mapping[str, Schema], required: Sequence[str]) -> Schema:
    """Return the schema of what lies below one name: a list's items, or an object's fields."""
    made = nested(schemas, required=required)
    if not all(map(is_index, made["properties"])):
        return made
    items = [made["properties"][key] for key in sorted(made["properties"], key=int)]
    least = max((int(key) + 1 for key in made["required"]), default=0)
    return {"type": "array", "prefixItems": items, "minItems": least, "maxItems": len(items)}
