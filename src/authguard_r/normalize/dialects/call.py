# SPDX-License-Identifier: Apache-2.0
"""What every dialect reads a plan into, and the two questions that all of them ask of a value.

A call is what the planner asked for, in the planner's own words: names are resolved and values
judged by the binding alone. Spec page: docs/spec/normalize.md#dialects
"""

from __future__ import annotations

from collections.abc import Iterator
from collections.abc import Set as AbstractSet
from enum import StrEnum
from typing import Any

from msgspec import Struct

from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.normalize.parse import MAX_CALLS, read_json


class Dialect(StrEnum):
    """How a plan is written; `auto` names the one that fits."""

    AUTO = "auto"
    OPENAI = "openai"
    RESPONSES = "responses"
    ANTHROPIC = "anthropic"
    GEMINI = "gemini"
    BEDROCK = "bedrock"
    OLLAMA = "ollama"
    LANGCHAIN = "langchain"
    MCP = "mcp"
    HERMES = "hermes"
    MISTRAL = "mistral"
    LLAMA = "llama"
    PYTHONIC = "pythonic"
    DEEPSEEK = "deepseek"
    HARMONY = "harmony"
    REACT = "react"
    REPLY = "reply"
    JSON = "json"
    CALLS = "calls"
    PYTHON = "python"
    BADROBOT = "badrobot"
    SPINE = "spine"
    GO2 = "go2"
    DOLPHINS = "dolphins"
    STEPS = "steps"
    ROS2 = "ros2"


#: Fields in which some program has calls. Those that tell whole replies of servers apart are not
#: here: a reply of two servers at once is read by both, and they must agree.
_CALL_FIELDS = frozenset(
    {"tool_calls", "function_call", "function", "delta", "tool", "plan", "actions", "steps", "op"}
)


class Call(Struct, frozen=True):
    """One call of a planner.

    Args:
        tool: its external name, as the planner spelled it; untrusted.
        arguments: by external name, possibly nested; positional ones are called `1`, `2`, ...
            Numbers are `int` or exact `Decimal`, never floats. Untrusted.
        where: the place in the planner's text, for messages.
        named: the place of the tool's name, where it is another one.
    """

    tool: str
    arguments: dict[str, Any]
    where: str
    named: str = ""


def expect(value: Any, kind: type[Any], where: str) -> Any:
    """Return the value when it is of the kind.

    Raises:
        MalformedError: it is of another, or absent.
    """
    if isinstance(value, kind):
        return value
    expected = {"dict": "an object", "list": "a list", "str": "a string"}[kind.__name__]
    raise MalformedError(f"expected {expected}", where=where)


def expect_fields(value: dict[str, Any], allowed: AbstractSet[str], where: str) -> None:
    """Refuse an object with a field that the dialect does not have.

    Raises:
        MalformedError: with the first such field as the place (`FIELD_UNKNOWN`).
    """
    if not value.keys() <= allowed:
        shown = ascii(min(value.keys() - allowed))[1:-1][:80]
        raise MalformedError(
            f"expected {_listed(allowed)} only, got `{shown}`",
            where=f"{where}.{shown}",
            reason=Reason.FIELD_UNKNOWN,
        )


def expect_model(message: dict[str, Any], where: str) -> None:
    """Refuse a message that says that somebody else than the model wrote it.

    Raises:
        MalformedError: its `role` is another than `assistant`.
    """
    if message.get("role", "assistant") != "assistant":
        raise MalformedError("expected `assistant`", where=f"{where}role")


def expect_no_call(value: dict[str, Any], where: str, *known: str) -> None:
    """Refuse an object with a call in a place where its format has none: it would be lost.

    Args:
        value: an object of which other fields are not looked at.
        where: its place, with a dot at its end; empty at the top.
        known: fields in which the format has its calls.

    Raises:
        MalformedError: with the first such field as the place.
    """
    if _CALL_FIELDS.isdisjoint(value):
        return
    for name in sorted(_CALL_FIELDS.intersection(value).difference(known)):
        if value[name] not in (None, [], {}):
            raise MalformedError("expected no calls in this field", where=f"{where}{name}")


def items_of(value: Any, where: str) -> Iterator[tuple[dict[str, Any], str]]:
    """Yield every object of a list with its place.

    Raises:
        MalformedError: it is no list, or something in it is no object.
    """
    for number, item in enumerate(expect(value, list, where)):
        yield expect(item, dict, f"{where}[{number}]"), f"{where}[{number}]"


def only(value: Any, where: str) -> dict[str, Any]:
    """Return the one object of a list.

    Raises:
        MalformedError: there are more, or none.
    """
    items = expect(value, list, where)
    if len(items) != 1:
        raise MalformedError(f"expected one item, got {len(items)}", where=where)
    found: dict[str, Any] = expect(items[0], dict, f"{where}[0]")
    return found


def call_of(item: dict[str, Any], tool: str, arguments: str, where: str) -> Call:
    """Return the call in an object, by the names of its two fields.

    Raises:
        MalformedError: one of them is missing or of another kind.
    """
    named, place = f"{where}.{tool}", f"{where}.{arguments}"
    name = expect(item.get(tool), str, named)
    return Call(name, expect(item.get(arguments), dict, place), place, named)


def spelled(item: dict[str, Any], where: str) -> dict[str, Any]:
    """Return `arguments` that a server gives as JSON text; an empty text or null means none.

    Raises:
        MalformedError: no text, or not one JSON object.
    """
    place = f"{where}.arguments"
    is_null = "arguments" in item and item["arguments"] is None
    text = "" if is_null else expect(item.get("arguments"), str, place)
    found: dict[str, Any] = expect(read_json(text, where=place), dict, place) if text else {}
    return found


def require_finished(
    reply: dict[str, Any], name: str, wanted: AbstractSet[str], where: str = ""
) -> None:
    """Refuse a reply that was cut off: its last arguments or its last call may be missing.

    Raises:
        MalformedError: the field that says how it ended says something else.
    """
    reason = reply.get(name)
    if not isinstance(reason, str) or reason not in wanted:
        text = f"expected a finished reply, got {name} `{ascii(reason)[:80]}`"
        raise MalformedError(text, where=f"{where}{name}")


def expect_few(count: int) -> None:
    """Refuse more calls than a plan may have.

    Raises:
        MalformedError: more than `MAX_CALLS` (`INPUT_TOO_LARGE`).
    """
    if count > MAX_CALLS:
        raise MalformedError(
            f"expected at most {MAX_CALLS} calls, got {count}",
            where="input",
            reason=Reason.INPUT_TOO_LARGE,
        )


def numbered(values: list[Any]) -> dict[str, Any]:
    """Return positional values under the names `1`, `2`, ..."""
    return {str(number): value for number, value in enumerate(values, 1)}


def _listed(names: AbstractSet[str]) -> str:
    return ", ".join(f"`{name}`" for name in sorted(names))
