# SPDX-License-Identifier: Apache-2.0
"""The nested arguments of a call, sorted by dotted paths: `poses.0.x`.

Spec page: docs/spec/normalize.md
"""

from __future__ import annotations

from typing import Any

from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.normalize.binding import is_index

#: The names at one level of a call: those below each, or the path that ends there. Under None: the
#: path of a list that may stand in the place of the object.
Tree = dict[str | None, Any]


def look(arguments: Any, path: str) -> Any:
    """Return what stands on a dotted path of a call's arguments; None when nothing does."""
    for depth, name in enumerate(path.split(".")):
        if isinstance(arguments, list) and depth and is_index(name):
            arguments = arguments[int(name)] if int(name) < len(arguments) else None
        elif isinstance(arguments, dict):
            arguments = arguments.get(name)
        else:
            return None
    return arguments


def suffix_of(path: str) -> str:
    """Return a dotted path as a place below the call: `.poses[0].x`."""
    first, *rest = path.split(".")
    return f".{first}" + "".join(f"[{name}]" if is_index(name) else f".{name}" for name in rest)


def tree_of(paths: dict[str, tuple[str, ...]]) -> Tree:
    """Return the names of nested arguments as nested tables with each path at its end."""
    tree: Tree = {}
    named = [(name, path) for path, names in paths.items() for name in names]
    for name, path in sorted(named, key=lambda one: -one[0].count(".")):  # what is below is there
        *parents, last = name.split(".")
        node = tree
        for parent in parents:
            node = node.setdefault(parent, {})
        if isinstance(node.get(last), dict):
            node[last][None] = path
        else:
            node[last] = path
    return tree


def flatten(
    tree: Tree, given: dict[str, Any], found: dict[str, Any], where: str, tool: str
) -> None:
    """Sort nested values by their paths.

    Raises:
        MalformedError: a value stands on no path, or on the same path as another one.
    """
    for name, value in given.items():
        _enter(tree.get(name), value, found, f"{where}.{ascii(name)[1:-1][:80]}", tool)


def _enter(below: Any, value: Any, found: dict[str, Any], where: str, tool: str) -> None:
    if below is None:
        raise unknown_field(tool, where)
    if isinstance(below, str):
        if below in found:
            raise refusal(Reason.VALUE_INVALID, "expected the value once", where)
        found[below] = value
    elif value is None:
        return  # as if nothing below it were there
    elif isinstance(value, list) and None in below:
        _enter(below[None], value, found, where, tool)
    elif "0" in below:
        if not isinstance(value, list):
            raise refusal(Reason.VALUE_INVALID, "expected a list", where)
        for number, item in enumerate(value):
            _enter(below.get(str(number)), item, found, f"{where}[{number}]", tool)
    elif isinstance(value, dict):
        flatten(below, value, found, where, tool)
    else:
        raise refusal(Reason.VALUE_INVALID, "expected an object", where)


def unknown_field(tool: str, where: str) -> MalformedError:
    """Return the refusal of a field that a tool does not have."""
    return refusal(Reason.FIELD_UNKNOWN, f"`{tool}` has no such field", where)


def refusal(reason: Reason, message: str, where: str) -> MalformedError:
    """Return a refusal with its reason and its place."""
    return MalformedError(message, where=where, reason=reason)
