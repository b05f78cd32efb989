# SPDX-License-Identifier: Apache-2.0
"""A model's streamed reply put together, so that a gate reads it whole.

    plan = chat_reply(chunk.model_dump() for chunk in completion)
    gate.propose(plan)

Nothing is repaired: a stream that ends before its end, or whose parts do not fit, is refused. The
calls are read by the gate. Spec page: docs/spec/normalize.md#openai
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import Any

from authguard_r.core.errors import MalformedError

_Json = dict[str, Any]


def chat_reply(chunks: Iterable[Mapping[str, Any]]) -> bytes:
    """Return the chat completion that a stream of `chat.completion.chunk` objects spells.

    Args:
        chunks: in the order in which they came, as plain data; untrusted.

    Raises:
        MalformedError: more than one choice, a part that fits nowhere, no `finish_reason`, or
            something after it.
    """
    text, calls, finish = "", list[_Json](), None
    for number, chunk in enumerate(chunks):
        where = f"chunks[{number}]"
        choices = _object(chunk, where).get("choices")
        if not isinstance(choices, list) or len(choices) > 1:
            raise MalformedError("expected at most one choice", where=f"{where}.choices")
        if not choices:  # how many tokens it took
            continue
        if finish is not None:
            raise MalformedError("expected nothing after the end", where=where)
        choice = _object(choices[0], f"{where}.choices[0]")
        if choice.get("index") not in {None, 0}:
            raise MalformedError("expected the first choice", where=f"{where}.choices[0].index")
        delta = _object(choice.get("delta"), f"{where}.choices[0].delta")
        if delta.get("function_call") is not None:
            place = f"{where}.choices[0].delta.function_call"
            raise MalformedError("expected calls in `tool_calls` only", where=place)
        text += _text(delta.get("content"), f"{where}.choices[0].delta.content")
        for at, part in enumerate(_listed(delta, f"{where}.choices[0].delta")):
            place = f"{where}.choices[0].delta.tool_calls[{at}]"
            _add_call(calls, _object(part, place), place)
        finish = choice.get("finish_reason")
    if finish is None:
        raise MalformedError("expected a `finish_reason`: the stream is not over", where="chunks")
    message = {"role": "assistant", "content": text, "tool_calls": calls}
    return _bytes({"choices": [{"finish_reason": finish, "index": 0, "message": message}]})


def _add_call(calls: list[_Json], part: _Json, where: str) -> None:
    """Add a part of a call to the call that it names, or begin the next one."""
    index, function = part.get("index"), _object(part.get("function") or {}, f"{where}.function")
    if index == len(calls) and type(index) is int:
        calls.append(
            {
                "id": part.get("id"),
                "type": part.get("type") or "function",
                "function": {"name": function.get("name"), "arguments": ""},
            }
        )
    elif index != len(calls) - 1 or type(index) is not int:
        raise MalformedError("expected the call before it, or the next", where=f"{where}.index")
    elif function.get("name") or part.get("id") not in {None, "", calls[index]["id"]}:
        raise MalformedError("expected only arguments of a call that was begun", where=where)
    told = _text(function.get("arguments"), f"{where}.function.arguments")
    calls[index]["function"]["arguments"] += told


def messages_reply(events: Iterable[Mapping[str, Any]]) -> bytes:
    """Return the message that a stream of the Messages API spells.

    Args:
        events: the `data` of each event in order, as plain data; untrusted.

    Raises:
        MalformedError: a part that fits nowhere, a block that is not ended, no `message_stop`, or
            something after it.
    """
    stream = _MessageStream()
    for number, event in enumerate(events):
        stream.take(event, f"events[{number}]")
    return stream.whole()


class _MessageStream:
    """A message of the Messages API, as far as its events have come."""

    def __init__(self) -> None:
        self._message: _Json = {}
        self._blocks: list[_Json] = []
        self._texts: list[str] = []
        self._is_open = False
        self._is_over = False

    def take(self, event: Mapping[str, Any], where: str) -> None:
        """Add an event.

        Raises:
            MalformedError: it fits nowhere.
        """
        kind = _object(event, where).get("type")
        fits = {
            "ping": True,
            "message_start": not self._message,
            "content_block_start": bool(self._message) and not self._is_open,
            "content_block_delta": self._is_open,
            "content_block_stop": self._is_open,
            "message_delta": bool(self._message) and not self._is_open,
            "message_stop": bool(self._message) and not self._is_open,
        }
        if self._is_over or not fits.get(str(kind), False):
            raise MalformedError("expected an event that fits here", where=f"{where}.type")
        if str(kind).startswith("content_block"):
            self._block(str(kind), event, where)
        elif kind == "message_start":
            self._message = dict(_object(event.get("message"), f"{where}.message"))
        elif kind == "message_delta":
            self._message |= _object(event.get("delta"), f"{where}.delta")
        self._is_over = kind == "message_stop"

    def _block(self, kind: str, event: Mapping[str, Any], where: str) -> None:
        begins = kind == "content_block_start"
        if event.get("index") != len(self._blocks) - (not begins):
            raise MalformedError("expected the blocks in order", where=f"{where}.index")
        if begins:
            self._blocks.append(_object(event.get("content_block"), f"{where}.content_block"))
            self._texts.append("")
        elif kind == "content_block_delta":
            delta = _object(event.get("delta"), f"{where}.delta")
            if delta.get("type") == "input_json_delta":
                self._texts[-1] += _text(delta.get("partial_json"), f"{where}.delta.partial_json")
        self._is_open = kind != "content_block_stop"

    def whole(self) -> bytes:
        """Return the whole message, each input exactly as the model spelled it.

        Raises:
            MalformedError: the stream is not over, or an input is no JSON object.
        """
        if not self._is_over:
            text = "expected `message_stop`: the stream is not over"
            raise MalformedError(text, where="events")
        spelled = map(_with_input, self._blocks, self._texts)
        head = json.dumps({key: said for key, said in self._message.items() if key != "content"})
        return f'{head[:-1]}, "content": [{", ".join(spelled)}]}}'.encode()


def _with_input(block: _Json, spelled: str) -> str:
    """Return a block as JSON, its input exactly as the model spelled it.

    Raises:
        MalformedError: the input is not one JSON object: it could be another block, too.
    """
    if block.get("type") != "tool_use" or not spelled:
        return json.dumps(block)
    try:
        read = json.loads(spelled)
    except (ValueError, RecursionError):
        read = None
    _object(read, f"{block.get('name')}.input")
    head = json.dumps({key: said for key, said in block.items() if key != "input"})
    return f'{head[:-1]}, "input": {spelled}}}'


def _listed(delta: _Json, where: str) -> list[Any]:
    parts = delta.get("tool_calls") or []
    if not isinstance(parts, list):
        raise MalformedError("expected a list", where=f"{where}.tool_calls")
    return parts


def _object(value: Any, where: str) -> _Json:
    if not isinstance(value, dict):
        message = f"expected an object as plain data, got `{type(value).__name__}`"
        raise MalformedError(message, where=where)
    return value


def _text(value: Any, where: str) -> str:
    if value is None:
        return ""
    if not isinstance(value, str):
        raise MalformedError("expected a string", where=where)
    return value


def _bytes(value: _Json) -> bytes:
    return json.dumps(value, ensure_ascii=False).encode(errors="backslashreplace")
