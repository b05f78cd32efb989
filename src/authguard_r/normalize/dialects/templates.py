# SPDX-License-Identifier: Apache-2.0
"""What open-weight models write around their calls: the tags of chat templates, ReAct, a fence.

Each reader takes the whole text. Free text may stand before the first tag, after a fence also;
nothing else may stand beside the calls, and a call within a call is broken JSON. What a model
thinks must have ended before its calls begin. Spec page: docs/spec/normalize.md#wrappers
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Any

from msgspec import Struct

from authguard_r.core.errors import MalformedError
from authguard_r.normalize.dialects.call import Call, Dialect, call_of, expect, expect_fields
from authguard_r.normalize.dialects.python_code import read_call_list, read_code
from authguard_r.normalize.parse import read_json, read_json_sequence

_SPACE = " \t\r\n"
_NAME = r"[A-Za-z_][A-Za-z0-9_.:-]{0,127}"
#: DeepSeek's tags: a wide bar, and a low block between the words.
_BEGIN, _END, _CALL, _CALL_END, _SEP, _LAST = (
    f"<\uff5c{words.replace(' ', chr(0x2581))}\uff5c>"
    for words in (
        *("tool calls begin", "tool calls end", "tool call begin", "tool call end"),
        *("tool sep", "end of sentence"),
    )
)
#: What a model's last token may be spelled as, when its server leaves it in the text.
_ENDS = ("<|im_end|>", "</s>", "<|eot_id|>", "<|eom_id|>", "<|eot|>", _LAST)
_MISTRAL = re.compile(rf" *({_NAME})(?:\[CALL_ID\][A-Za-z0-9]{{1,40}})?(?:\[ARGS\])?(?=\{{)")
_DEEPSEEK = re.compile(rf"{_CALL}({_NAME}){_SEP}")
_DEEPSEEK_FENCED = re.compile(rf"{_CALL}function{_SEP}({_NAME})\n```json\n")
_HARMONY = re.compile(
    rf"<\|start\|>assistant(?: to=functions\.({_NAME}))?<\|channel\|>(analysis|commentary|final)"
    rf"(?: to=functions\.({_NAME}))?(?: ?(?:<\|constrain\|>)? ?json)?<\|message\|>"
)
_REACT = re.compile(rf"(?:\A|\n)Action: *({_NAME})[ \t]*\r?\n(?:[ \t]*\r?\n)?Action Input:")
_STRAY = re.compile(r"(?:\A|\n)(?:Action|Action Input|Observation|Final Answer):")
_LETTERS = re.compile(r"[^\n]")
#: Where a model begins to think, and where it has thought.
_THINKS = re.compile(r"<think(?:ing)?>|\[THINK\]")
_THOUGHT = re.compile(r"</think(?:ing)?>|\[/THINK\]")
_FENCE = re.compile(r"^```([A-Za-z_]{0,16})[ \t]*\r?$", re.MULTILINE)


class TemplateReading(Struct, frozen=True):
    """Calls that stood within a template, and how much free text stood around them.

    Args:
        calls: in order.
        before: characters of free text before the first tag.
        after: characters of free text after the last one.
    """

    calls: tuple[Call, ...]
    before: int = 0
    after: int = 0


def read_hermes(text: str) -> TemplateReading:
    """Return the calls of `<tool_call>{"name", "arguments"}</tool_call>`, as Hermes and Qwen write.

    Raises:
        MalformedError: a tag without its other one, text between or after the calls, broken JSON.
    """
    before, *parts = trimmed(text).split("<tool_call>")
    calls = []
    for place, part in _placed(before, parts, "<tool_call>"):
        inner, closed, rest = part.partition("</tool_call>")
        if not closed or rest.strip(_SPACE):
            wanted = "expected nothing but calls from here on, each within `<tool_call>`"
            raise MalformedError(wanted, where=f"input[{place}]")
        calls.append(_named(read_json(inner, where=f"input[{place}]"), f"input[{place}]"))
    return TemplateReading(tuple(calls), before=_thought(before, "<tool_call>"))


def read_mistral(text: str) -> TemplateReading:
    """Return the calls after `[TOOL_CALLS]`: a list, or `name[ARGS]{...}` with a tag for each.

    Raises:
        MalformedError: neither, or text after the calls.
    """
    before, *parts = trimmed(text).split("[TOOL_CALLS]")
    prose = _thought(before, "[TOOL_CALLS]")
    if len(parts) == 1 and parts[0].lstrip(_SPACE)[:1] == "[":
        where = f"input[{len(before)}]"
        items = expect(read_json(parts[0], where=where), list, where)
        return TemplateReading(
            tuple(_named(one, f"{where}[{n}]") for n, one in enumerate(items)), prose
        )
    calls = []
    for place, part in _placed(before, parts, "[TOOL_CALLS]"):
        where = f"input[{place}]"
        name = _MISTRAL.match(part)
        if name is None:
            raise MalformedError("expected `name[ARGS]{...}` or a list of calls", where=where)
        arguments = read_json(part[name.end() :], where=f"{where}.arguments")
        calls.append(Call(name[1], expect(arguments, dict, f"{where}.arguments"), where))
    return TemplateReading(tuple(calls), before=prose)


def read_llama(text: str) -> TemplateReading:
    """Return the calls after `<|python_tag|>`: `{"name", "parameters"}`, or calls as Python.

    Raises:
        MalformedError: a second tag, text beside the calls, neither form.
    """
    before, tag, body = trimmed(text).partition("<|python_tag|>")
    prose, where = _thought(before, tag), f"input[{len(before)}]"
    if tag in body:
        raise MalformedError(f"expected `{tag}` once", where=where)
    if body.lstrip(_SPACE)[:1] != "{":
        return TemplateReading(read_code(body, where=where), before=prose)
    items = read_json_sequence(body, where=where)
    return TemplateReading(
        tuple(_named(one, f"{where}[{n}]", "parameters") for n, one in enumerate(items)), prose
    )


def read_pythonic(text: str) -> TemplateReading:
    """Return the calls of `[go(to="Dock"), scan()]`, which Llama 3.2 and 4 write.

    Raises:
        MalformedError: anything else than one list of calls with literals.
    """
    return TemplateReading(read_call_list(trimmed(text).lstrip(_SPACE), where="input"))


def read_deepseek(text: str) -> TemplateReading:
    """Return the calls between DeepSeek's tags, with fences (V3, R1) or without them (V3.1).

    Raises:
        MalformedError: a tag that is missing, text between or after the calls, broken JSON.
    """
    before, _, body = trimmed(text).partition(_BEGIN)
    place = len(before) + len(_BEGIN)
    if not body.endswith(_END) or _BEGIN in body or body.count(_END) > 1:
        raise MalformedError(f"expected `{_END}` once, at the end", where=f"input[{len(text)}]")
    calls = []
    *parts, rest = body[: -len(_END)].split(_CALL_END)
    for part in parts:
        where, call = f"input[{place}]", part.lstrip(_SPACE)
        fenced = _DEEPSEEK_FENCED.match(call)
        name = fenced or _DEEPSEEK.match(call)
        if name is None or (fenced and not call.endswith("\n```")):
            raise MalformedError("expected a call within its tags", where=where)
        arguments = read_json(call[name.end() : -4 if fenced else None], where=f"{where}.arguments")
        calls.append(Call(name[1], expect(arguments, dict, f"{where}.arguments"), where))
        place += len(part) + len(_CALL_END)
    if rest.strip(_SPACE):
        raise MalformedError("expected a call within its tags", where=f"input[{place}]")
    return TemplateReading(tuple(calls), before=_thought(before, _BEGIN))


def read_harmony(text: str) -> TemplateReading:
    """Return the call of a gpt-oss reply: messages in channels, the last one to a function.

    Raises:
        MalformedError: a message without its end, to another tool, or after the call.
    """
    whole = text.strip(_SPACE)
    begun = "" if whole.startswith("<|start|>") else "<|start|>assistant"  # by the server
    body, calls, at, prose, is_over = begun + whole, list[Call](), 0, 0, False
    while at < len(body):
        where = f"input[{max(0, at - len(begun))}]"
        head = _HARMONY.match(body, at)
        if head is None or is_over:
            raise MalformedError("expected whole messages, a call as the last one", where=where)
        end, name = body.find("<|", head.end()), head[1] or head[3]
        is_over = bool(name) or head[2] == "final"
        mark = "<|call|>" if name else "<|return|>" if is_over else "<|end|>"
        if end < 0 and name:  # a server that stops at the mark leaves it out
            end, mark = len(body), ""
        said = body[head.end() : end]
        if (head[1] and head[3]) or end < 0 or not body.startswith(mark, end):
            raise MalformedError(f"expected `{mark}` after the message", where=where)
        if name:
            calls.append(Call(name, expect(read_json(said, where=where), dict, where), where))
        else:
            prose += len(said)
        at = end + len(mark)
    return TemplateReading(tuple(calls), before=prose)


def read_react(text: str) -> TemplateReading:
    """Return the call of `Action: name` and `Action Input: {...}`, which end a ReAct turn.

    Raises:
        MalformedError: a second action, a final answer or an observation beside it, no JSON object.
    """
    said = trimmed(text).removesuffix("\nObservation:").rstrip(_SPACE)  # where agents stop
    head = _REACT.search(said)
    if head is None:
        raise MalformedError("expected `Action: name`, then `Action Input: {...}`", where="input")
    stray = _STRAY.search(said[: head.start()]) or _STRAY.search(said, head.end())
    if stray is not None:
        raise MalformedError("expected one action and nothing after it", where="input")
    where = f"input[{head.end()}]"
    arguments = expect(read_json(said[head.end() :], where=where), dict, where)
    prose = _thought(said[: head.start()], "Action:")
    return TemplateReading((Call(head[1], arguments, where),), before=prose)


def fenced(text: str) -> tuple[str, str, int, int]:
    """Return what the one Markdown fence of a text encloses.

    Returns:
        The text within at its own place, its language, and the characters of free text before and
        after it.

    Raises:
        MalformedError: the text has several fences, or an open one.
    """
    marks = list(_FENCE.finditer(text))
    if len(marks) != 2 or text.count("```") != 2 or marks[1][1]:
        raise MalformedError("expected one whole fenced block", where="input")
    opens, closes = marks
    before, rest = _thought(text[: opens.start()], "```"), text[closes.end() :]
    if _THINKS.search(rest) or _THOUGHT.search(rest):
        raise MalformedError("expected the model's thoughts to end before the block", where="input")
    inner = blank(text[: opens.end()]) + text[opens.end() : closes.start()]
    return inner, opens[1], before, len(rest.strip(_SPACE))


def blank(text: str) -> str:
    """Return text with nothing but its lines, so that what comes after it keeps its place."""
    return _LETTERS.sub(" ", text)


def _named(item: Any, where: str, arguments: str = "arguments") -> Call:
    """Return the call of `{"name", "arguments"}`; an `id` only matches answers to calls."""
    call = expect(item, dict, where)
    expect_fields(call, {"name", arguments, "id", "type"}, where)
    if call.get("type", "function") != "function":
        raise MalformedError("expected a call of type `function`", where=f"{where}.type")
    return call_of(call, "name", arguments, where)


def _placed(before: str, parts: list[str], tag: str) -> Iterator[tuple[int, str]]:
    """Yield each part of a text that was split at a tag, with its place."""
    place = len(before)
    for part in parts:
        yield place, part
        place += len(tag) + len(part)


def trimmed(text: str) -> str:
    """Return text without the mark of its end, which a server may leave in it."""
    whole = text.rstrip(_SPACE)
    if not whole.endswith(_ENDS):
        return whole
    return whole.removesuffix(next(filter(whole.endswith, _ENDS))).rstrip(_SPACE)


def _thought(prose: str, tag: str) -> int:
    """Return how many characters of free text there are.

    Raises:
        MalformedError: what the model thinks in it has not ended, so its calls are thoughts too.
    """
    thought = [end.end() for end in _THOUGHT.finditer(prose)]
    if _THINKS.search(prose, max(thought, default=0)):
        raise MalformedError(f"expected `</think>` before `{tag}`", where="input")
    return len(prose.strip(_SPACE))


#: What shows a template, and what reads it; a text that shows two is in none of them.
TEMPLATES: tuple[tuple[str, Dialect, Callable[[str], TemplateReading]], ...] = (
    ("<tool_call>", Dialect.HERMES, read_hermes),
    ("[TOOL_CALLS]", Dialect.MISTRAL, read_mistral),
    ("<|python_tag|>", Dialect.LLAMA, read_llama),
    (_BEGIN, Dialect.DEEPSEEK, read_deepseek),
    ("<|channel|>", Dialect.HARMONY, read_harmony),
    ("Action Input:", Dialect.REACT, read_react),
)
