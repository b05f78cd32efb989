# SPDX-License-Identifier: Apache-2.0
"""A server's schema of a tool's arguments, narrowed to what its binding reads.

Spec page: docs/spec/adapters.md#schemas
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy

from authguard_r.integrations.tools.argument_schema import ArgumentSchemas, Schema
from authguard_r.normalize.binding import Argument, ArgumentUse, Binding, is_index, ways_of
from authguard_r.site.model import Site

#: What a field says for people, beside its values.
_SAID = ("title", "description", "examples")


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
    return found


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
    field, required = parent["properties"][name], set(parent.get("required", ()))
    needed = argument.use is not ArgumentUse.NOTED and not argument.optional
    parent["required"] = sorted(required | {name} if needed else required - {name})
    if argument.use is not ArgumentUse.NOTED:
        said = {key: field[key] for key in _SAID if key in field}
        parent["properties"][name] = {**values, **said}
        if "description" in said and values.get("type") in {"number", "integer"}:
            text = f"{str(said['description']).rstrip(' .')}, {values['description']}"
            parent["properties"][name]["description"] = text


def _parents(schema: Schema, path: Sequence[str]) -> list[tuple[Schema, str]] | None:
    """Return the objects on a path with the field that leads on; None where the schema has none."""
    found: list[tuple[Schema, str]] = []
    for name in path:
        fields = schema.get("properties")
        if is_index(name) or not isinstance(fields, dict) or not isinstance(fields.get(name), dict):
            return None
        found.append((schema, name))
        schema = fields[name]
    return found
