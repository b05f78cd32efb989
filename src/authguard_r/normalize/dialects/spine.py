# SPDX-License-Identifier: Apache-2.0
"""SPINE and RoboGuard plans, which RoboPAIR's Jackal also speaks: one string that holds a list.

The list is of calls with bare words, `[goto(dock), inspect(desk, is it tidy?)]`, or of tuples,
`[("goto", "dock")]`. A bare word is text without quotes, up to the next comma or parenthesis, so
free text that holds a comma becomes one argument more, which no binding takes.
Spec page: docs/spec/normalize.md#dialects
"""

from __future__ import annotations

import re
from typing import Any

from authguard_r.core.errors import MalformedError
from authguard_r.normalize.dialects.call import Call, expect, numbered
from authguard_r.normalize.dialects.python_code import read_literal
from authguard_r.normalize.parse import NUMBER, read_json, read_number

#: How a plan looks that is written as text: a list whose first thing is a call, a tuple, a list.
LIST = re.compile(r"[ \t\r\n]*\[[ \t\r\n]*(?:[A-Za-z_][A-Za-z0-9_]*\(|[(\[])")
_TUPLES = re.compile(r"[ \t\r\n]*\[[ \t\r\n]*[(\[]")
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(?=\()")
_SPACE = re.compile(r"[ \t\r\n]*")
#: No quotation mark of any kind and no bracket; an apostrophe may stand inside a word.
#: A named argument is none: the list of calls that has them is Python.
_WORD = re.compile(
    r"(?![A-Za-z_][A-Za-z0-9_]*=)[^()\[\]{},\"'`\x00-\x1f\x7f][^()\[\]{},\"`\x00-\x1f\x7f]*"
)


def read_spine(text: str) -> tuple[Call, ...]:
    """Return the calls of a whole reply, or of the bare list.

    Raises:
        MalformedError: neither, or anything in it that is no call.
    """
    if text.lstrip(" \t\r\n")[:1] == "{":
        return read_spine_reply(read_json(text, where="input"))
    return _read_list(text, "input")


def read_spine_reply(value: Any) -> tuple[Call, ...]:
    """Return the calls under `plan`; every other key holds prose, which is never looked at.

    Args:
        value: the reply as strict JSON spells it; untrusted.

    Raises:
        MalformedError: no plan, another value than text beside it, or a plan that is broken.
    """
    reply = expect(value, dict, "input")
    for name, beside in reply.items():
        if name != "plan":
            expect(beside, str, f"input.{ascii(name)[1:-1][:80]}")
    plan = reply.get("plan")
    if isinstance(plan, list):
        return _tuples(plan, "plan")
    return _read_list(expect(plan, str, "plan"), "plan")


def _read_list(text: str, where: str) -> tuple[Call, ...]:
    if _TUPLES.match(text):
        return _tuples(read_literal(text, where=where), where)
    return _calls(text, where)


def _tuples(items: Any, where: str) -> tuple[Call, ...]:
    calls = []
    for number, item in enumerate(expect(items, list, where)):
        place = f"{where}[{number}]"
        parts = expect(item, list, place)
        name = expect(parts[0] if parts else None, str, f"{place}[0]")
        calls.append(Call(name, numbered(parts[1:]), place))
    return tuple(calls)


def _calls(text: str, where: str) -> tuple[Call, ...]:
    at = _expect(text, _skip(text, 0), "[", where)
    calls: list[Call] = []
    while calls or text[at : at + 1] != "]":
        name = _NAME.match(text, at)
        if name is None:
            raise MalformedError("expected a call such as `goto(dock)`", where=f"{where}[{at}]")
        values, end = _words(text, name.end() + 1, where)
        calls.append(Call(name.group(), numbered(values), f"{where}[{at}]"))
        if text[end : end + 1] == "]":
            at = end
            break
        at = _expect(text, end, ",", where)
    at = _skip(text, at + 1)
    if at < len(text):
        raise MalformedError("expected nothing after the list", where=f"{where}[{at}]")
    return tuple(calls)


def _words(text: str, at: int, where: str) -> tuple[list[Any], int]:
    """Return the words up to the closing parenthesis, and where the text goes on after it."""
    found: list[Any] = []
    at = _skip(text, at)
    while found or text[at : at + 1] != ")":
        word = _WORD.match(text, at)
        if word is None:
            raise MalformedError("expected a word without quotes", where=f"{where}[{at}]")
        found.append(_value(word.group().rstrip(" "), f"{where}[{at}]"))
        at = _skip(text, word.end())
        if text[at : at + 1] == ")":
            break
        at = _expect(text, at, ",", where)
    return found, _skip(text, at + 1)


def _value(word: str, where: str) -> Any:
    if NUMBER.fullmatch(word) is None:
        return word
    try:
        return read_number(word)
    except ValueError as error:
        raise MalformedError(str(error), where=where) from error


def _expect(text: str, at: int, mark: str, where: str) -> int:
    if text[at : at + 1] != mark:
        raise MalformedError(f"expected `{mark}`", where=f"{where}[{at}]")
    return _skip(text, at + 1)


def _skip(text: str, at: int) -> int:
    space = _SPACE.match(text, at)
    return at if space is None else space.end()
