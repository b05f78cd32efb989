# SPDX-License-Identifier: Apache-2.0
"""Tool lists as planners are given them, held to names that a binding can hold.

Only names are taken: a list's own word that a tool is harmless decides nothing (L1). What is not
understood is an error with its place, never left out: no person would look at a tool that the
skeleton forgot. How-to: docs/howto/onboarding.md
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from enum import StrEnum
from typing import Any

from msgspec import Struct

from authguard_r.core.encoding import MAX_BYTES
from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.normalize.interface import ITEM
from authguard_r.normalize.parse import read_json
from authguard_r.site.names import shown, skeleton

#: Most bytes of a list: what the strict readers of the files made from it take.
MAX_LIST = MAX_BYTES
#: Most tools (or topics, services and actions) of a list, and most fields of one tool.
MAX_TOOLS = 1_000
MAX_FIELDS = 500
#: Longest path of a field within fields, in characters.
MAX_PATH = 300

_TOOL = re.compile(r"[A-Za-z0-9_/][A-Za-z0-9_.:/-]{0,127}")
FIELD = re.compile(r"[A-Za-z_$@][A-Za-z0-9_$@:/-]{0,99}")
#: What an entry of a `tools` array may say, around its function and of it.
_AROUND = frozenset({"type", "function"})
_FUNCTION = frozenset({"name", "description", "parameters", "response", "strict"})
_FLAT = frozenset({"string", "integer", "number", "boolean", "float"})


class Source(StrEnum):
    """Where a tool list comes from."""

    MCP = "mcp"
    OPENAI = "openai"
    ROS = "ros"


class ListedTool(Struct, frozen=True):
    """One tool of a list.

    Args:
        name: its external name.
        fields: the path of every field; true for one whose inside the list does not say.
    """

    name: str
    fields: dict[str, bool]


def list_text(data: bytes, *, where: str) -> str:
    """Return a list's bytes as text.

    Raises:
        MalformedError: too long (`INPUT_TOO_LARGE`), empty, or not UTF-8.
    """
    if len(data) > MAX_LIST:
        message = f"expected a list of at most {MAX_LIST} bytes"
        raise MalformedError(message, where=where, reason=Reason.INPUT_TOO_LARGE)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise MalformedError("expected UTF-8", where=f"{where}[{error.start}]") from error
    if not text.strip():
        raise MalformedError("expected a list of tools, got nothing", where=where)
    return text


def read_mcp(text: str, *, where: str) -> tuple[ListedTool, ...]:
    """Return the tools of a `tools/list` result, of the whole answer around it, or of an array.

    Args:
        text: what the server said; untrusted.
        where: the file's name, for places.

    Raises:
        MalformedError: with the place; also for one page of a longer list.
    """
    value = read_json(text, where=where)
    if isinstance(value, dict) and isinstance(value.get("result"), dict):
        value, where = value["result"], f"{where}:result"
    if isinstance(value, dict) and value.get("nextCursor") is not None:
        message = "expected the whole list: there is more behind `nextCursor`"
        raise MalformedError(message, where=f"{where}:nextCursor")
    return _tools(_array(value, where), _mcp_tool)


def read_openai(text: str, *, where: str) -> tuple[ListedTool, ...]:
    """Return the functions of a `tools` array: of chat completions, of responses, or one a line.

    Args:
        text: what the planner's program sends; untrusted.
        where: the file's name, for places.

    Raises:
        MalformedError: with the place; also for a tool that the model's server runs itself.
    """
    lines = [line for line in text.splitlines() if line.strip()]
    if len(lines) > 1 and all(
        line.lstrip()[0] == "{" and line.rstrip().endswith("}") for line in lines
    ):
        items = [(read_json(line, where=f"{where}:{n}"), f"{where}:{n}") for n, line in _few(lines)]
        return _tools(items, _openai_tool)
    return _tools(_array(read_json(text, where=where), where), _openai_tool)


def _few(lines: list[str]) -> Iterator[tuple[int, str]]:
    require_few(len(lines), "tools")
    return enumerate(lines, 1)


def _array(value: Any, where: str) -> list[tuple[Any, str]]:
    """Return the items of a list, or of the list under `tools`, each with its place."""
    if isinstance(value, dict):
        value = value.get("tools")
    if not isinstance(value, list):
        raise MalformedError("expected a list of tools", where=where)
    require_few(len(value), "tools", where)
    return [(item, f"{where}:tools[{number}]") for number, item in enumerate(value)]


def require_few(count: int, what: str, where: str = "list") -> None:
    """Refuse a list of nothing, and one that is too long to be looked through by a person.

    Raises:
        MalformedError: none, or more than `MAX_TOOLS` (`INPUT_TOO_LARGE`).
    """
    if count == 0:
        raise MalformedError(f"expected {what}, got none", where=where)
    if count > MAX_TOOLS:
        message = f"expected at most {MAX_TOOLS} {what}, got {count}"
        raise MalformedError(message, where=where, reason=Reason.INPUT_TOO_LARGE)


def _tools(
    items: list[tuple[Any, str]], read: Callable[[dict[str, Any], str], tuple[Any, str]]
) -> tuple[ListedTool, ...]:
    """Return the tools of a list; no two may be taken for each other.

    Args:
        items: each with its place.
        read: returns a tool's schema and its place.
    """
    found: list[ListedTool] = []
    names = Apart("tool")
    for item, where in items:
        if not isinstance(item, dict):
            raise MalformedError("expected an object", where=where)
        about = item["function"] if isinstance(item.get("function"), dict) else item
        name = about.get("name")
        if not isinstance(name, str):
            raise MalformedError("expected a tool with a name", where=f"{where}.name")
        names.add(tool_name(name, f"{where}.name"), f"{where}.name")
        schema, place = read(item, where)
        found.append(ListedTool(name, schema_fields(schema, f"{place} of {name}")))
    return tuple(found)


def _mcp_tool(item: dict[str, Any], where: str) -> tuple[Any, str]:
    place = f"{where}.inputSchema"
    if not isinstance(item.get("inputSchema"), dict):
        raise MalformedError("expected the schema of the tool's arguments", where=place)
    return item["inputSchema"], place


def _openai_tool(item: dict[str, Any], where: str) -> tuple[Any, str]:
    if item.get("type", "function") != "function":
        kind = shown(str(item.get("type")))
        message = f"expected a function, got `{kind}`: no gate sees this tool"
        raise MalformedError(message, where=f"{where}.type")
    wrapped = isinstance(item.get("function"), dict)
    about = item["function"] if wrapped else item
    _require_known(item, _AROUND if wrapped else _FUNCTION | {"type"}, where)
    _require_known(about, _FUNCTION | {"type"}, f"{where}.function" if wrapped else where)
    schema = about.get("parameters")
    place = f"{where}.parameters"
    if schema is not None and not isinstance(schema, dict):
        raise MalformedError("expected the schema of the function's arguments", where=place)
    return schema or {}, place


def _require_known(said: dict[str, Any], known: frozenset[str], where: str) -> None:
    """Refuse a key that is not read: a schema under another name would leave a tool no fields."""
    for key in said:
        if key not in known:
            hint = "; is this an MCP list? --from mcp" if key == "inputSchema" else ""
            raise MalformedError(
                f"expected {', '.join(sorted(known))}, got `{shown(key)}`{hint}",
                where=f"{where}.{shown(key)}",
            )


def tool_name(name: str, where: str) -> str:
    """Return a tool's name once it is one that a person can tell from others.

    Raises:
        MalformedError: another character than letters, digits and `_.:/-`, or more than 128.
    """
    if _TOOL.fullmatch(name) is None:
        message = f"expected a name of letters, digits and `_.:/-`, got `{shown(name)}`"
        raise MalformedError(message, where=where)
    return name


class Apart:
    """Names of one kind, no two of which a person could take for each other.

    Args:
        kind: what they name, for messages.
    """

    def __init__(self, kind: str) -> None:
        self._kind = kind
        self._seen: dict[str, str] = {}

    def add(self, name: str, where: str) -> None:
        """Take a name in.

        Raises:
            MalformedError: it was there before, or one that looks like it.
        """
        look = skeleton(name.strip("/"))
        twin = self._seen.get(look)
        if twin == name:
            raise MalformedError(
                f"expected each {self._kind} once, got `{name}` again", where=where
            )
        if twin is not None:
            message = (
                f"expected a name that cannot be taken for `{twin}`, got `{name}`; leave one out: "
                "the gate refuses a tool without a binding"
            )
            raise MalformedError(message, where=where)
        self._seen[look] = name


def schema_fields(schema: dict[str, Any], where: str) -> dict[str, bool]:
    """Return the leaves of a JSON schema; true: what is below the list does not say.

    Raises:
        MalformedError: a field's name that a path cannot hold, two that differ by case alone, or
            more than `MAX_FIELDS`.
    """
    found: dict[str, bool] = {}
    for path, is_open in _leaves(schema, "", where):
        require_path(path, where)
        found[path] = is_open
        if len(found) > MAX_FIELDS:
            message = f"expected at most {MAX_FIELDS} fields of one tool"
            raise MalformedError(message, where=where, reason=Reason.INPUT_TOO_LARGE)
    return found


def require_path(path: str, where: str) -> None:
    """Refuse a path that is too long for a file that people read.

    Raises:
        MalformedError: longer than `MAX_PATH` characters.
    """
    if len(path) > MAX_PATH:
        message = f"expected a path of at most {MAX_PATH} characters, got `{shown(path)}`"
        raise MalformedError(message, where=where)


def _leaves(schema: dict[str, Any], prefix: str, where: str) -> Iterator[tuple[str, bool]]:
    properties = schema.get("properties")
    seen: dict[str, str] = {}
    for name, below in (properties if isinstance(properties, dict) else {}).items():
        place = f"{where}: {prefix}{shown(name)}"
        if FIELD.fullmatch(name) is None:
            message = f"expected a field's name of letters, digits and `_`, got `{shown(name)}`"
            raise MalformedError(message, where=place)
        twin = seen.setdefault(name.casefold(), name)
        if twin != name:
            raise MalformedError(f"expected a name other than `{twin}` in case", where=place)
        path, inner = f"{prefix}{name}", below if isinstance(below, dict) else {}
        items = inner.get("items")
        if isinstance(inner.get("properties"), dict) and inner["properties"]:
            yield from _leaves(inner, f"{path}.", where)
        elif (
            isinstance(items, dict)
            and isinstance(items.get("properties"), dict)
            and items["properties"]
        ):
            yield from _leaves(items, f"{path}.{ITEM}.", where)
        else:
            kind = inner.get("type")
            yield path, not isinstance(kind, str) or kind not in _FLAT
