# SPDX-License-Identifier: Apache-2.0
"""Tool use as model servers and tool protocols write it: OpenAI's two APIs, Anthropic, MCP.

A reply is taken whole, as a server sends it, so that a reply which was cut off is seen as such.
What the model says beside its calls is prose: it is never looked at.
Spec page: docs/spec/normalize.md#dialects
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from authguard_r.core.errors import MalformedError
from authguard_r.normalize.dialects.call import (
    Call,
    call_of,
    expect,
    expect_fields,
    expect_model,
    expect_no_call,
    items_of,
    only,
    require_finished,
    spelled,
)

_PROSE = frozenset({"text", "thinking", "redacted_thinking"})
_REPLY = {"type": "message", "role": "assistant"}
#: What a server says of a call that the model made, not a program or another tool.
_ITSELF = (None, {"type": "direct"})


def read_openai(value: Any) -> tuple[Call, ...]:
    """Return the calls of a chat completion with one finished choice, or of its bare message.

    `content`, `reasoning_content` and every other field without a call are prose. A bare message
    does not say whether it was finished: text that was cut off is no JSON, so it is refused.

    Args:
        value: the reply as strict JSON spells it; untrusted.

    Raises:
        MalformedError: not such a reply, unfinished, or with a call in the retired form.
    """
    reply = expect(value, dict, "input")
    message, where = reply, ""
    if "choices" in reply:
        choice = only(reply["choices"], "choices")
        require_finished(choice, "finish_reason", {"tool_calls", "stop"}, "choices[0].")
        expect_no_call(reply, "")
        expect_no_call(choice, "choices[0].")
        message, where = (
            expect(choice.get("message"), dict, "choices[0].message"),
            "choices[0].message.",
        )
    expect_model(message, where)
    expect_no_call(message, where, "tool_calls")  # else it would be dropped in silence (L11)
    return tuple(
        _openai_call(item, place)
        for item, place in items_of(message.get("tool_calls") or [], f"{where}tool_calls")
    )


def _openai_call(call: dict[str, Any], where: str) -> Call:
    if call.get("type") not in {None, "function"}:
        raise MalformedError("expected a call of type `function`", where=f"{where}.type")
    function = expect(call.get("function"), dict, f"{where}.function")
    place = f"{where}.function"
    expect_fields(function, {"name", "arguments"}, place)
    name = expect(function.get("name"), str, f"{place}.name")
    return Call(name, spelled(function, place), f"{place}.arguments", f"{place}.name")


def read_responses(value: Any) -> tuple[Call, ...]:
    """Return the calls of a whole reply of OpenAI's Responses API, in order.

    Messages and reasoning are prose. An item of any other type is something that a server did or
    is to do, so it refuses the whole reply.

    Args:
        value: the reply as strict JSON spells it; untrusted.

    Raises:
        MalformedError: not such a reply, unfinished, or with an item of another type.
    """
    reply = expect(value, dict, "input")
    require_finished(reply, "status", {"completed"})
    expect_no_call(reply, "")
    return tuple(_response_calls(reply.get("output")))


def _response_calls(output: Any) -> Iterator[Call]:
    for item, where in items_of(output, "output"):
        kind = expect(item.get("type"), str, f"{where}.type")
        if kind in {"message", "reasoning"}:
            continue
        if kind != "function_call":
            wanted = "expected `message`, `reasoning` or `function_call`"
            raise MalformedError(wanted, where=f"{where}.type")
        if item.get("caller") not in _ITSELF:
            raise MalformedError("expected a call by the model itself", where=f"{where}.caller")
        if item.get("status") is not None:
            require_finished(item, "status", {"completed"}, f"{where}.")
        name = expect(item.get("name"), str, f"{where}.name")
        yield Call(name, spelled(item, where), f"{where}.arguments", f"{where}.name")


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
    require_finished(reply, "stop_reason", {"tool_use", "end_turn"})
    expect_no_call(reply, "")
    return tuple(_anthropic_calls(reply.get("content")))


def _anthropic_calls(blocks: Any) -> Iterator[Call]:
    for given, where in items_of(blocks, "content"):
        block = {name: item for name, item in given.items() if item is not None}
        kind = expect(block.get("type"), str, f"{where}.type")
        if kind in _PROSE:
            continue
        if kind != "tool_use":
            raise MalformedError("expected text, thinking or `tool_use`", where=f"{where}.type")
        expect_fields(block, {"type", "id", "name", "input", "caller"}, where)
        if block.get("caller") not in _ITSELF:
            raise MalformedError("expected a call by the model itself", where=f"{where}.caller")
        expect(block.get("id"), str, f"{where}.id")
        yield call_of(block, "name", "input", where)


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
    meta = expect(params.get("_meta", {}), dict, f"{where}.params._meta")
    expect_fields(meta, {"progressToken"}, f"{where}.params._meta")  # where a client hears of it
    arguments = {} if params.get("arguments") is None else params["arguments"]
    return call_of({**params, "arguments": arguments}, "name", "arguments", f"{where}.params")
