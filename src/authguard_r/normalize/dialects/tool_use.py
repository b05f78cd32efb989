# SPDX-License-Identifier: Apache-2.0
"""Tool use as model servers and tool protocols write it: OpenAI, Anthropic, MCP.

A reply is taken whole, as a server sends it, so that a reply which was cut off is seen as such.
What the model says beside its calls is prose: it is never looked at.
Spec page: docs/spec/normalize.md#dialects
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.normalize.dialects.call import Call, expect, expect_fields
from authguard_r.normalize.parse import read_json

_PROSE = frozenset({"text", "thinking", "redacted_thinking"})
_REPLY = {"type": "message", "role": "assistant"}


def read_openai(value: Any) -> tuple[Call, ...]:
    """Return the calls of a whole chat-completions reply; exactly one finished choice.

    Args:
        value: the reply as strict JSON spells it; untrusted.

    Raises:
        MalformedError: not such a reply, unfinished, or with a call in the retired form.
    """
    reply = expect(value, dict, "input")
    choices = expect(reply.get("choices"), list, "choices")
    if len(choices) != 1:
        raise MalformedError(f"expected one choice, got {len(choices)}", where="choices")
    choice = expect(choices[0], dict, "choices[0]")
    _require_finished(choice, "finish_reason", {"tool_calls", "stop"}, "choices[0].finish_reason")
    message = expect(choice.get("message"), dict, "choices[0].message")
    if message.get("function_call") is not None:  # else a call would be dropped in silence (L11)
        where = "choices[0].message.function_call"
        raise MalformedError("expected calls in `tool_calls` only", where=where)
    found = expect(message.get("tool_calls") or [], list, "choices[0].message.tool_calls")
    return tuple(
        _openai_call(item, f"choices[0].message.tool_calls[{number}]")
        for number, item in enumerate(found)
    )


def _openai_call(item: Any, where: str) -> Call:
    call = expect(item, dict, where)
    if call.get("type") != "function":
        raise MalformedError("expected a call of type `function`", where=f"{where}.type")
    function = expect(call.get("function"), dict, f"{where}.function")
    name = expect(function.get("name"), str, f"{where}.function.name")
    place = f"{where}.function.arguments"
    text = expect(function.get("arguments"), str, place)
    return Call(name, expect(read_json(text, where=place), dict, place), place)


def read_anthropic(value: Any) -> tuple[Call, ...]:
    """Return the calls of a whole Messages reply: its `tool_use` blocks, in order.

    Text and thinking are prose. A block of any other type is something that a server did or is to
    do, so it refuses the whole reply.

    Args:
        value: the reply as strict JSON spells it; untrusted.

    Raises:
        MalformedError: not such a reply, unfinished, or with a block of another type.
    """
    reply = expect(value, dict, "input")
    for name, wanted in _REPLY.items():
        if reply.get(name, wanted) != wanted:
            raise MalformedError(f"expected `{wanted}`", where=name)
    _require_finished(reply, "stop_reason", {"tool_use", "end_turn"}, "stop_reason")
    blocks = expect(reply.get("content"), list, "content")
    return tuple(_anthropic_calls(blocks))


def _anthropic_calls(blocks: list[Any]) -> Iterator[Call]:
    for number, item in enumerate(blocks):
        where = f"content[{number}]"
        block = expect(item, dict, where)
        kind = expect(block.get("type"), str, f"{where}.type")
        if kind in _PROSE:
            continue
        if kind != "tool_use":
            raise MalformedError("expected text, thinking or `tool_use`", where=f"{where}.type")
        expect_fields(block, {"type", "id", "name", "input", "caller"}, where)
        if block.get("caller", {"type": "direct"}) != {"type": "direct"}:
            raise MalformedError("expected a call by the model itself", where=f"{where}.caller")
        expect(block.get("id"), str, f"{where}.id")
        name = expect(block.get("name"), str, f"{where}.name")
        place = f"{where}.input"
        yield Call(name, expect(block.get("input"), dict, place), place)


def read_mcp(value: Any) -> tuple[Call, ...]:
    """Return the calls of one `tools/call` request, or of a list of them.

    Args:
        value: the request as strict JSON spells it; untrusted.

    Raises:
        MalformedError: not such a request, another method, a notification, or an id used twice.
    """
    if isinstance(value, dict):
        return (_mcp_call(value, "input"),)
    items = expect(value, list, "input")
    calls = tuple(_mcp_call(item, f"input[{number}]") for number, item in enumerate(items))
    seen: set[Any] = set()
    for number, item in enumerate(items):
        if item["id"] in seen:  # the answers could not be distinguished
            raise MalformedError("expected each id once", where=f"input[{number}].id")
        seen.add(item["id"])
    return calls


def _mcp_call(item: Any, where: str) -> Call:
    request = expect(item, dict, where)
    expect_fields(request, {"jsonrpc", "id", "method", "params"}, where)
    for name, wanted in (("jsonrpc", "2.0"), ("method", "tools/call")):
        if request.get(name) != wanted:
            raise MalformedError(f"expected `{wanted}`", where=f"{where}.{name}")
    if type(request.get("id")) not in {str, int}:
        raise MalformedError("expected a string or a whole number", where=f"{where}.id")
    params = expect(request.get("params"), dict, f"{where}.params")
    expect_fields(params, {"name", "arguments", "_meta"}, f"{where}.params")
    if params.get("_meta", {}) != {}:
        place = f"{where}.params._meta"
        raise MalformedError("expected it empty", where=place, reason=Reason.FIELD_UNKNOWN)
    name = expect(params.get("name"), str, f"{where}.params.name")
    place = f"{where}.params.arguments"
    return Call(name, expect(params.get("arguments", {}), dict, place), place)


def _require_finished(reply: dict[str, Any], name: str, wanted: set[str], where: str) -> None:
    """Refuse a reply that was cut off: its last arguments or its last call may be missing."""
    reason = reply.get(name)
    if not isinstance(reason, str) or reason not in wanted:
        shown = ascii(reason)[:80]
        raise MalformedError(f"expected a finished reply, got {name} `{shown}`", where=where)
