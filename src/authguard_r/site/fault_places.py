# SPDX-License-Identifier: Apache-2.0
"""Where plain data is wrong, and what is allowed there: names for places, values for enums.

`msgspec` reports the entry of a mapping as `[...]`, and no allowed values. Both are in the type.
"""

from __future__ import annotations

import re
from difflib import get_close_matches
from typing import Annotated, Any

import msgspec
from msgspec import inspect

#: One step of a place: `.field`, `[3]` of a list, or `[...]` of a mapping.
_STEP = re.compile(r"\.[^.\[]+|\[[^\]]*\]")
#: What a file says that it is.
_SCHEMA = re.compile(r"authguard-r/([a-z]+(?:-[a-z]+)*)/[0-9]+")
_PLAIN_TYPES: dict[Any, Any] = {
    inspect.IntType: int,
    inspect.StrType: str,
    inspect.BoolType: bool,
    inspect.NoneType: type(None),
}
_BOUNDS = ("ge", "gt", "le", "lt", "multiple_of", "pattern", "min_length", "max_length")
_ENUM = "Invalid enum value "
_TYPES = re.compile(r"([Ee]xpected|got) `(array|bool|float|int|null|object|str)`")
#: What is in the pattern of an id, as the message shows it.
_ID = "[a-z0-9][a-z0-9_.:-]{0,63}"
#: What an author calls each type.
_TYPE_NAMES = {
    "array": "a list",
    "bool": "true or false",
    "float": "a number with a point",
    "int": "a whole number",
    "null": "nothing",
    "object": "a mapping",
    "str": "text",
}
_UNKNOWN = re.compile(r"Object contains unknown field `(.*)`", re.DOTALL)


def fault_of(data: object, kind: Any, error: msgspec.ValidationError) -> tuple[str, str]:
    """Return what is wrong with plain data, and where; `[...]` is replaced by the entry's name.

    Args:
        data: the plain data.
        kind: what it had to be.
        error: as `msgspec.convert` raised it.
    """
    text, _, place = str(error).partition(" - at ")
    place = place.rpartition(" in ")[2]  # a key's fault is reported as "`key` in `$.place`"
    node: Any = inspect.type_info(kind)
    value: Any = data
    names: list[str] = []
    for step in _STEP.findall(place.strip("`").removeprefix("$")):
        name, node, value = _entered(step, _member(node, value), value)
        names.append(name)
    found, node = "".join(names).removeprefix("."), _member(node, value)
    text = _TYPES.sub(lambda m: f"{m[1]} {_TYPE_NAMES.get(m[2], m[0])}", text)
    if _ID in text:
        text = "expected an id of at most 64 characters of a-z, 0-9 and `_.:-`"
    if unknown := _UNKNOWN.fullmatch(text):
        text = _unknown_field(unknown[1], node)
    if text.startswith(_ENUM) and isinstance(node, inspect.EnumType | inspect.LiteralType):
        allowed = node.values if isinstance(node, inspect.LiteralType) else [*node.cls]
        text = f"got {text.removeprefix(_ENUM)}, expected {listed(map(str, allowed))}"
    text = text[:1].lower() + text[1:]
    if found == "schema" or (not found and "unknown field `schema`" in text):
        text = _named_kind(data) + text
    return text, found


def _unknown_field(name: str, node: Any) -> str:
    """Return what is wrong with a field that is not one, and which fields are allowed."""
    known = [field.encode_name for field in getattr(node, "fields", ())]
    close = get_close_matches(name, known, 1)
    meant = f" (did you mean `{close[0]}`?)" if close else ""
    allowed = f"; allowed: {', '.join(sorted(known))}" if known else ""
    return f"object contains unknown field `{name}`{meant}{allowed}"


def _named_kind(data: object) -> str:
    """Return which kind of file the data says that it is; empty where it does not say."""
    said = data.get("schema") if isinstance(data, dict) else None
    kind = _SCHEMA.fullmatch(said) if isinstance(said, str) else None
    return f"this file is a {kind[1].replace('-', ' ')}: " if kind else ""


def listed(values: Any) -> str:
    """Return the values that are allowed, for people."""
    found = sorted(f"`{value}`" for value in values)
    return found[0] if len(found) == 1 else f"one of {', '.join(found)}"


def _member(node: Any, value: Any) -> Any:
    """Return the type of a union that a value is closest to; any other type is itself."""
    types = [one for one in getattr(node, "types", ()) if not isinstance(one, inspect.NoneType)]
    if isinstance(value, list):
        types = [one for one in types if hasattr(one, "item_type")] or types
    elif isinstance(value, dict):
        types = [one for one in types if hasattr(one, "fields")] or types
    return types[0] if types else node


def _entered(step: str, node: Any, value: Any) -> tuple[str, Any, Any]:
    """Return the name of one step, with type and data behind it; None for what is unknown."""
    if step == "[...]":
        below = getattr(node, "value_type", None)
        for key, item in value.items() if isinstance(value, dict) else ():
            if not _fits(item, below):
                return f".{key}", below, item
        return step, below, None
    if step.startswith("["):
        number = int(step[1:-1])
        below = getattr(node, "item_type", None)
        has_it = isinstance(value, list) and number < len(value)
        return step, below, value[number] if has_it else None
    fields = {field.encode_name: field.type for field in getattr(node, "fields", ())}
    name = step[1:]
    return step, fields.get(name), value.get(name) if isinstance(value, dict) else None


def _fits(value: Any, node: Any) -> bool:
    """Return whether a value is of a type, as far as structs, enums and lists tell."""
    if types := getattr(node, "types", ()):
        return any(_fits(value, one) for one in types)
    if hasattr(node, "item_type"):
        is_list = isinstance(value, list) and len(value) >= (node.min_length or 0)
        return is_list and all(_fits(item, node.item_type) for item in value)
    kind = getattr(node, "cls", None) or _PLAIN_TYPES.get(type(node), Any)
    bounds = {name: getattr(node, name, None) for name in _BOUNDS}
    if kind in {int, str}:
        bounds = {name: bound for name, bound in bounds.items() if bound is not None}
        kind = Annotated[kind, msgspec.Meta(**bounds)]
    try:
        msgspec.convert(value, kind)
    except msgspec.ValidationError:
        return False
    return True
