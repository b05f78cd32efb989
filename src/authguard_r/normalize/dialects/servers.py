# SPDX-License-Identifier: Apache-2.0
"""Replies of further model servers and of LangChain: Gemini, Bedrock, Ollama.

As in `tool_use`, a reply is taken whole and says that it was finished; what is neither a call nor
prose of the format refuses it. Spec page: docs/spec/normalize.md#dialects
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
)

#: Fields of a part of a Gemini reply that belong to what the model thought, by both spellings.
_GEMINI_PROSE = {"text", "thought", "thoughtSignature", "thought_signature"}
#: How LangChain calls a message of the model, by the form that it is written in.
_AI = {"ai", "AIMessage"}
#: How a server may say in a LangChain message that it was finished, and with which words.
_ENDS = ("finish_reason", "stop_reason", "stopReason", "done_reason")
_FINISHED = frozenset({"stop", "STOP", "tool_calls", "tool_use", "end_turn"})


def read_gemini(value: Any) -> tuple[Call, ...]:
    """Return the calls of a whole `generateContent` reply: one candidate, finished with `STOP`.

    Names are as the REST interface spells them, or as its Python client does.

    Args:
        value: the reply as strict JSON spells it; untrusted.

    Raises:
        MalformedError: not such a reply, unfinished, or with a part that is no text and no call.
    """
    reply = expect(value, dict, "input")
    candidate = only(reply.get("candidates"), "candidates")
    expect_no_call(reply, "")
    finish = "finish_reason" if "finish_reason" in candidate else "finishReason"
    require_finished(candidate, finish, {"STOP"}, "candidates[0].")
    content = expect(candidate.get("content"), dict, "candidates[0].content")
    return tuple(_gemini_calls(content.get("parts"), "candidates[0].content.parts"))


def _gemini_calls(parts: Any, where: str) -> Iterator[Call]:
    for part, place in items_of(parts, where):
        said = {name: item for name, item in part.items() if item is not None}
        call = next((name for name in ("functionCall", "function_call") if name in said), None)
        expect_fields(said, _GEMINI_PROSE if call is None else {call, *_GEMINI_PROSE}, place)
        if call is not None:
            asked = expect(said[call], dict, f"{place}.{call}")
            known = {name: item for name, item in asked.items() if item is not None}
            expect_fields(known, {"id", "name", "args"}, f"{place}.{call}")
            yield call_of({"args": {}, **known}, "name", "args", f"{place}.{call}")


def read_bedrock(value: Any) -> tuple[Call, ...]:
    """Return the calls of a whole reply of Bedrock's Converse API: its `toolUse` blocks, in order.

    Args:
        value: the reply as strict JSON spells it; untrusted.

    Raises:
        MalformedError: not such a reply, unfinished, or with a block of another kind.
    """
    reply = expect(value, dict, "input")
    require_finished(reply, "stopReason", {"tool_use", "end_turn"})
    expect_no_call(reply, "")
    output = expect(reply.get("output"), dict, "output")
    message = expect(output.get("message"), dict, "output.message")
    expect_model(message, "output.message.")
    calls = []
    for block, where in items_of(message.get("content"), "output.message.content"):
        expect_fields(block, {"text", "reasoningContent", "toolUse"}, where)
        if "toolUse" in block:
            use = expect(block["toolUse"], dict, f"{where}.toolUse")
            expect_fields(use, {"toolUseId", "name", "input"}, f"{where}.toolUse")
            calls.append(call_of(use, "name", "input", f"{where}.toolUse"))
    return tuple(calls)


def read_ollama(value: Any) -> tuple[Call, ...]:
    """Return the calls of a whole reply of Ollama's chat interface, which is not streamed.

    Args:
        value: the reply as strict JSON spells it; untrusted.

    Raises:
        MalformedError: it is not such a reply, or it is not finished.
    """
    reply = expect(value, dict, "input")
    expect_no_call(reply, "")
    if reply.get("done") is not True:
        raise MalformedError("expected a finished reply, with `true`", where="done")
    if "done_reason" in reply:
        require_finished(reply, "done_reason", {"stop"})
    message = expect(reply.get("message"), dict, "message")
    expect_model(message, "message.")
    expect_no_call(message, "message.", "tool_calls")
    calls = []
    for item, where in items_of(message.get("tool_calls") or [], "message.tool_calls"):
        function = expect(item.get("function"), dict, f"{where}.function")
        expect_fields(function, {"name", "arguments", "index"}, f"{where}.function")
        if "arguments" in function and function["arguments"] is None:
            function = {**function, "arguments": {}}
        calls.append(call_of(function, "name", "arguments", f"{where}.function"))
    return tuple(calls)


def read_langchain(value: Any) -> tuple[Call, ...]:
    """Return the `tool_calls` of one LangChain message of a model, plain or as it is stored.

    Args:
        value: the message as strict JSON spells it; untrusted.

    Raises:
        MalformedError: not such a message, with a call that LangChain could not read, or with calls
            in a server's own form alone.
    """
    message, where = expect(value, dict, "input"), ""
    kind = message.get("type")
    for inner in ("data", "kwargs"):  # `messages_to_dict` and `dumpd` wrap a message
        if isinstance(message.get(inner), dict):
            expect_no_call(message, where)
            message, where = message[inner], f"{inner}."
            kind = message.get("type", kind)
    if kind not in _AI or message.get(
        "tool_call_chunks"
    ):  # LangChain completes a chunk's arguments
        raise MalformedError("expected a whole message of type `ai`", where=f"{where}type")
    if message.get("invalid_tool_calls"):
        text = "expected none: the framework could not read this call"
        raise MalformedError(text, where=f"{where}invalid_tool_calls")
    told = expect(message.get("response_metadata", {}), dict, f"{where}response_metadata")
    for name in _ENDS:
        if told.get(name) is not None:
            require_finished(told, name, _FINISHED, f"{where}response_metadata.")
    calls = []
    for item, place in items_of(message.get("tool_calls") or [], f"{where}tool_calls"):
        expect_fields(item, {"name", "args", "id", "type"}, place)
        calls.append(call_of(item, "name", "args", place))
    beside = expect(message.get("additional_kwargs", {}), dict, f"{where}additional_kwargs")
    if not calls and beside.get("tool_calls"):
        text = "expected calls in the message's own `tool_calls`"
        raise MalformedError(text, where=f"{where}additional_kwargs.tool_calls")
    return tuple(calls)
