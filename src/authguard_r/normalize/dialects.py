# SPDX-License-Identifier: Apache-2.0
"""Planner dialects: each turns one way of writing a plan into the same list of calls.

A dialect reads structure only; names and values are the binding's. What does not fit is refused
with its place. Spec page: docs/spec/normalize.md#dialects
"""

from __future__ import annotations

from enum import StrEnum
from typing import Any

from msgspec import Struct

from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.normalize.parse import MAX_CALLS, read_calls, read_json


class Dialect(StrEnum):
    """How a plan is written; `auto` names the one that fits."""

    AUTO = "auto"
    OPENAI = "openai"
    JSON = "json"
    CALLS = "calls"


class Call(Struct, frozen=True):
    """One call of a planner: the tool's external name, its arguments, where it stood."""

    tool: str
    arguments: dict[str, Any]
    where: str


def read_plan(text: str, dialect: Dialect) -> tuple[Call, ...]:
    """Return the calls of a plan, in order.

    Args:
        text: what the planner wrote.
        dialect: how to read it.

    Raises:
        MalformedError: broken, empty, too long, or in no known dialect.
    """
    calls = _read(text, dialect)
    if not calls:
        raise MalformedError("expected at least one call", where="input", reason=Reason.PLAN_EMPTY)
    if len(calls) > MAX_CALLS:
        raise MalformedError(
            f"expected at most {MAX_CALLS} calls, got {len(calls)}",
            where="input",
            reason=Reason.INPUT_TOO_LARGE,
        )
    return calls


def _read(text: str, dialect: Dialect) -> tuple[Call, ...]:
    """Read in one dialect; `auto` goes by the first character and by what a reply says it is."""
    if dialect is Dialect.CALLS:
        return _calls(text)
    if dialect is Dialect.AUTO and text.lstrip(" \t\r\n")[:1] not in {"{", "["}:
        return _calls(text)
    value = read_json(text, where="input")
    if dialect is Dialect.AUTO:
        is_reply = isinstance(value, dict) and "choices" in value
        return _openai(value) if is_reply else _json(value)
    return _openai(value) if dialect is Dialect.OPENAI else _json(value)


def _openai(value: Any) -> tuple[Call, ...]:
    """A whole chat-completions reply as a server sends it; exactly one finished choice."""
    reply = _of(value, dict, "input")
    choices = _of(reply.get("choices"), list, "choices")
    if len(choices) != 1:
        raise MalformedError(f"expected one choice, got {len(choices)}", where="choices")
    choice = _of(choices[0], dict, "choices[0]")
    reason = choice.get("finish_reason")
    if not isinstance(reason, str) or reason not in {"tool_calls", "stop"}:
        raise MalformedError(
            f"expected a finished reply, got finish_reason `{reason}`",
            where="choices[0].finish_reason",
        )
    message = _of(choice.get("message"), dict, "choices[0].message")
    found = _of(message.get("tool_calls") or [], list, "choices[0].message.tool_calls")
    return tuple(
        _openai_call(item, f"choices[0].message.tool_calls[{number}]")
        for number, item in enumerate(found)
    )


def _openai_call(item: Any, where: str) -> Call:
    call = _of(item, dict, where)
    if call.get("type") != "function":
        raise MalformedError("expected a call of type `function`", where=f"{where}.type")
    function = _of(call.get("function"), dict, f"{where}.function")
    name = _of(function.get("name"), str, f"{where}.function.name")
    place = f"{where}.function.arguments"
    text = _of(function.get("arguments"), str, place)
    return Call(name, _of(read_json(text, where=place), dict, place), place)


def _json(value: Any) -> tuple[Call, ...]:
    """`{"tool", "arguments"}`, a list of these, or `{"plan": [...]}`; no other key."""
    where = "input"
    if isinstance(value, dict) and set(value) == {"plan"}:
        value, where = value["plan"], "plan"
    if isinstance(value, dict):
        return (_json_call(value, where),)
    items = _of(value, list, where)
    return tuple(_json_call(item, f"{where}[{n}]") for n, item in enumerate(items))


def _json_call(item: Any, where: str) -> Call:
    call = _of(item, dict, where)
    extra = sorted(set(call) - {"tool", "arguments"})
    if extra:
        raise MalformedError(
            f"expected `tool` and `arguments` only, got `{extra[0]}`",
            where=f"{where}.{extra[0]}",
            reason=Reason.FIELD_UNKNOWN,
        )
    name = _of(call.get("tool"), str, f"{where}.tool")
    return Call(name, _of(call.get("arguments"), dict, f"{where}.arguments"), where)


def _calls(text: str) -> tuple[Call, ...]:
    """`navigate_to(destination="Station 101", speed=0.8)`, one call after the other."""
    return tuple(Call(name, arguments, where) for name, arguments, where in read_calls(text))


def _of(value: Any, kind: type[Any], where: str) -> Any:
    if isinstance(value, kind):
        return value
    expected = {"dict": "an object", "list": "a list", "str": "a string"}[kind.__name__]
    raise MalformedError(f"expected {expected}", where=where)
