# SPDX-License-Identifier: Apache-2.0
"""A server's schema of a tool's arguments, narrowed to what its binding reads.

Spec page: docs/spec/adapters.md#schemas
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from typing import Any

from authguard_r.integrations.tools.argument_schema import ArgumentSchemas, Schema
from authguard_r.normalize.binding import (
    Argument,
    ArgumentUse,
    Binding,
    ToolBinding,
    is_index,
    ways_of,
)
from authguard_r.site.model import Site

#: What a field says for people, beside its values.
_SAID = ("title", "description", "examples")
#: Most references that are followed one after the other.
_REFERENCES = 8


def narrowed(schema: Schema, name: str, binding: Binding, site: Site) -> Schema:
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
        way.tool
        for way in ways_of(binding, name)
        if not site.vocabulary[way.tool.type].state_writing
    ]
    words, found = ArgumentSchemas(site), deepcopy(schema)
    for path in dict.fromkeys(path for way in ways for path in way.arguments):
        given = [way.arguments.get(path) for way in ways]
        if all(one is None or one.use is ArgumentUse.REFUSED for one in given):
            _drop(found, path.split("."))
        elif len(ways) == 1:
            argument = ways[0].arguments[path]
            _narrow(found, path.split("."), argument, words.of(ways[0], path, argument))
    _prune(found, found, [path.split(".") for way in ways for path in _bound(way)])
    return found


def _bound(way: ToolBinding) -> list[str]:
    also = [name for argument in way.arguments.values() for name in argument.also]
    return [*way.arguments, *way.when, *also]


def _prune(schema: Schema, root: Schema, bound: list[list[str]]) -> None:
    """Leave out the fields that no path leads to: a call with one is refused."""
    fields = schema.get("properties")
    if not isinstance(fields, dict):
        return
    for name in list(fields):
        below = [path[1:] for path in bound if path[0] == name]
        if not below:
            del fields[name]
            schema["required"] = [field for field in schema.get("required", ()) if field != name]
        elif all(below):
            fields[name] = _one_form(fields[name], root)
            _prune(fields[name], root, below)


def _drop(schema: Schema, path: Sequence[str]) -> None:
    """Leave a field out, and the objects that have no other."""
    parents = _parents(schema, path)
    if parents is None:
        return
    for parent, name in reversed(parents):
        parent["properties"].pop(name, None)
        parent["required"] = [field for field in parent.get("required", ()) if field != name]
        if parent["properties"]:
            return


def _narrow(schema: Schema, path: Sequence[str], argument: Argument, values: Schema) -> None:
    """Require a field or not, and let it be what its binding reads; a noted one stays as it is."""
    parents = _parents(schema, path)
    if parents is None:
        return
    parent, name = parents[-1]
    field, noted = parent["properties"][name], argument.use is ArgumentUse.NOTED
    if noted or argument.optional:
        parent["required"] = [other for other in parent.get("required", ()) if other != name]
    else:  # and so is each object that it stands in
        for outer, inner in parents:
            outer["required"] = sorted({*outer.get("required", ()), inner})
    if not noted:
        said = {key: field[key] for key in _SAID if key in field}
        parent["properties"][name] = {**values, **said}
        if "description" in said and values.get("type") in {"number", "integer"}:
            text = f"{str(said['description']).rstrip(' .')}, {values['description']}"
            parent["properties"][name]["description"] = text


def _parents(schema: Schema, path: Sequence[str]) -> list[tuple[Schema, str]] | None:
    """Return the objects on a path with the field that leads on; None where the schema has none."""
    found: list[tuple[Schema, str]] = []
    root = schema
    for name in path:
        fields = schema.get("properties")
        if is_index(name) or not isinstance(fields, dict) or not isinstance(fields.get(name), dict):
            return None
        fields[name] = _one_form(fields[name], root)
        found.append((schema, name))
        schema = fields[name]
    return found


def _one_form(field: Any, root: Schema) -> Any:
    """Return a field's schema where it stands, without a reference, and without null."""
    for _ in range(_REFERENCES):
        if not isinstance(field, dict):
            return field
        forms = [one for one in field.get("anyOf", ()) if one != {"type": "null"}]
        target = str(field.get("$ref", "")).removeprefix("#/$defs/")
        if len(forms) == 1:
            inner = forms[0]
        elif target in root.get("$defs", {}):
            inner = root["$defs"][target]
        else:
            return field
        said = {key: field[key] for key in _SAID if key in field}
        field = {**deepcopy(inner), **said} if isinstance(inner, dict) else inner
    return field
