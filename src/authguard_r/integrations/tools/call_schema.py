# SPDX-License-Identifier: Apache-2.0
"""The JSON Schema of a tool's arguments that a model is shown, narrowed to what its binding reads.

The schema is advice: a model that keeps to it is refused less often. The binding decides, and every
call is read by it. Spec page: docs/spec/adapters.md#schemas
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from copy import deepcopy
from fractions import Fraction
from typing import Any

from authguard_r.core.identifiers import ParameterId
from authguard_r.normalize.binding import (
    POSE,
    REGION,
    Argument,
    ArgumentUse,
    Binding,
    is_index,
    ways_of,
)
from authguard_r.site.model import ActionModel, Parameter, Site

#: Longest list of names that a schema spells out; a longer one would fill a model's context.
MAX_NAMES = 100
_Json = dict[str, Any]
#: What a field says of values that are none of the binding's.
_VALUES = ("type", "enum", "const", "minimum", "maximum", "default", "anyOf", "oneOf")


def narrowed(schema: _Json, name: str, binding: Binding, site: Site) -> _Json:
    """Return a tool's schema with the fields and values that the binding reads.

    Args:
        schema: as the tool's server gives it; untrusted, and not changed.
        name: the tool's external name.
        binding: which says what each field means; one without the tool changes nothing.
        site: whose names and ranges are spelled out.
    """
    if name not in binding.tools:
        return schema
    ways = [
        (way.tool.arguments, set(way.tool.when), site.vocabulary[way.tool.type])
        for way in ways_of(binding, name)
        if not site.vocabulary[way.tool.type].state_writing
    ]
    found = deepcopy(schema)
    paths = dict.fromkeys(path for arguments, _, _ in ways for path in arguments)
    for path in paths:
        given = [(arguments.get(path), kind) for arguments, _, kind in ways]
        if all(one is None or one.use is ArgumentUse.REFUSED for one, _ in given):
            _drop(found, path.split("."))
        elif len(ways) == 1:
            _narrow(found, path.split("."), ways[0][0][path], ways[0][2], site)
    return found


def _drop(schema: _Json, path: Sequence[str]) -> None:
    """Leave a field out, and the objects that have no other."""
    parents = _parents(schema, path)
    if parents is None:
        return
    for parent, name in reversed(parents):
        parent["properties"].pop(name, None)
        parent["required"] = [field for field in parent.get("required", ()) if field != name]
        if parent["properties"]:
            return


def _narrow(
    schema: _Json, path: Sequence[str], argument: Argument, kind: ActionModel, site: Site
) -> None:
    parents = _parents(schema, path)
    if parents is None:
        return
    parent, name = parents[-1]
    field = parent["properties"][name]
    if not isinstance(field, dict):
        return
    required = set(parent.get("required", ()))
    needed = argument.use is not ArgumentUse.NOTED and not argument.optional
    parent["required"] = sorted(required | {name} if needed else required - {name})
    values = _values(argument, kind, site)
    if values:
        kept = {key: said for key, said in field.items() if key not in _VALUES}
        parent["properties"][name] = _described({**kept, **values}, argument, kind)


def _parents(schema: _Json, path: Sequence[str]) -> list[tuple[_Json, str]] | None:
    """Return the objects on a path with the field that leads on; None where the schema has none."""
    found: list[tuple[_Json, str]] = []
    for name in path:
        fields = schema.get("properties")
        if is_index(name) or not isinstance(fields, dict) or not isinstance(fields.get(name), dict):
            return None
        found.append((schema, name))
        schema = fields[name]
    return found


def _values(argument: Argument, kind: ActionModel, site: Site) -> _Json:
    """Return what a schema can say of the values that an argument may have; empty: nothing."""
    constant = argument.constant()
    if argument.use is ArgumentUse.FIXED:
        return {
            "const": constant if isinstance(constant, bool | int | str) else float(constant or 0)
        }
    if argument.use is not ArgumentUse.MAPPED:
        return {}
    if argument.to == "object":
        return _names(_spelled(item.names, name) for name, item in site.objects.items())
    if argument.to in {"source", "destination", REGION}:
        return _names(_spelled(item.names, name) for name, item in site.regions.items())
    if argument.values:
        return {"type": "string", "enum": list(argument.values)}
    parameter = kind.params.get(ParameterId(argument.to.removeprefix("params.")))
    if argument.to in POSE or parameter is None:
        return {}
    return {
        "type": "integer" if argument.whole else "number",
        "minimum": _in_tool_units(parameter.low, argument),
        "maximum": _in_tool_units(parameter.high, argument),
    }


def _names(spellings: Iterable[Sequence[str]]) -> _Json:
    names = [name for spelled in spellings for name in spelled]
    return {"type": "string", **({"enum": names} if 0 < len(names) <= MAX_NAMES else {})}


def _spelled(names: Sequence[str], identifier: str) -> Sequence[str]:
    """Return what people call a thing; its id is a name too, and shown where it is the only one."""
    return names or (identifier,)


def _in_tool_units(value: int, argument: Argument) -> int | float:
    exact = (value - argument.offset) / Fraction(argument.per_unit)
    return exact.numerator if exact.denominator == 1 else float(exact)


def _described(field: _Json, argument: Argument, kind: ActionModel) -> _Json:
    """Add the unit to a number's description, as the site names it."""
    parameter = kind.params.get(ParameterId(argument.to.removeprefix("params.")))
    if parameter is None or "minimum" not in field:
        return field
    said = str(field.get("description", "")).rstrip(" .")
    unit = f"Unit: {_unit_text(argument, parameter)}."
    return {**field, "description": f"{said}. {unit}" if said else unit}


def _unit_text(argument: Argument, parameter: Parameter) -> str:
    per_unit = "" if argument.per_unit == "1" else f"{argument.per_unit} "
    offset = f", plus {argument.offset} {parameter.unit}" if argument.offset else ""
    return f"{per_unit}{parameter.unit}{offset}"
