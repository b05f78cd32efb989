# SPDX-License-Identifier: Apache-2.0
"""Calls that a text names outright: a tool in backticks, as a function call, or as JSON.

Spec page: docs/spec/missionpair-access.md#reading
"""

from __future__ import annotations

import json
import re
from collections.abc import Collection
from typing import Any

import msgspec
from msgspec import Struct

from missionpair.pair import Value, WordedCall
from missionpair.wording.lexing import Text

_KEY = r"([A-Za-z_][A-Za-z0-9_.]*|\"(?:[^\"\\]|\\.)*\")"
_FIRST = re.compile(rf"\s*(?:with\b|using\b|:)?\s*{_KEY}\s*=\s*")
_LATER = re.compile(rf"\s*(?:,\s*and\b|,|and\b)\s*{_KEY}\s*=\s*")
_CALLED = re.compile(r"([A-Za-z_][A-Za-z0-9_]*)\s*\(")
_IN_CALL = re.compile(rf"\s*,?\s*{_KEY}\s*[=:]\s*")
_SINGLE = re.compile(r"'([^'\\\n]*)'")
_JSON = json.JSONDecoder()
#: Where a plan or a call may keep its calls.
_LISTS = ("plan", "steps", "actions", "calls")
_NAMES = ("tool", "name", "action", "function")
_ARGUMENTS = ("arguments", "args", "parameters", "input")


class Outright(Struct, frozen=True):
    """What is called outright, and the place of the first token after it."""

    calls: tuple[WordedCall, ...]
    end: int


def called_outright(text: Text, place: int, offered: Collection[str]) -> Outright | None:
    """Return what is called outright here; None where nothing is.

    Args:
        text: the text.
        place: where in it.
        offered: names of tools; others are no calls.
    """
    token = text.tokens[place]
    if token.kind == "code":
        if token.text in offered:
            arguments, end = _arguments(text.raw, token.end, _FIRST, _LATER)
            return Outright((WordedCall(tool=token.text, arguments=arguments),), text.place(end))
        return None
    if token.text == "{":
        return _from_json(text, token.start, offered)
    match = _CALLED.match(text.raw, token.start)
    if match is None or match[1] not in offered:
        return None
    arguments, end = _arguments(text.raw, match.end(), _IN_CALL, _IN_CALL)
    return Outright((WordedCall(tool=match[1], arguments=arguments),), text.place(end))


def _arguments(
    raw: str, position: int, first: re.Pattern[str], later: re.Pattern[str]
) -> tuple[dict[str, Value], int]:
    """Return arguments `key = JSON`, and where they end."""
    found: dict[str, Value] = {}
    pattern = first
    while (match := pattern.match(raw, position)) is not None:
        try:
            value, end = _literal(raw, match.end())
            key = json.loads(match[1]) if match[1].startswith('"') else match[1]
            found[key] = msgspec.convert(value, Value)
        except (ValueError, RecursionError):  # msgspec's error is a ValueError
            break
        position, pattern = end, later
    return found, position


def _literal(raw: str, position: int) -> tuple[Any, int]:
    """Return a JSON value, or what stands in single quotes, and where it ends.

    Raises:
        ValueError: neither stands here.
    """
    quoted = _SINGLE.match(raw, position)
    if quoted is not None:
        return quoted[1], quoted.end()
    return _JSON.raw_decode(raw, position)


def _from_json(text: Text, start: int, offered: Collection[str]) -> Outright | None:
    """Return the calls of a JSON object: a call, or a plan of calls."""
    try:
        value, end = _JSON.raw_decode(text.raw, start)
    except (ValueError, RecursionError):
        return None
    listed: Any = next((value[key] for key in _LISTS if key in value), [value])
    if not isinstance(listed, list):
        return None
    calls = tuple(filter(None, (_call(entry, offered) for entry in listed)))
    return Outright(calls, text.place(end)) if calls else None


def _call(entry: Any, offered: Collection[str]) -> WordedCall | None:
    if not isinstance(entry, dict):
        return None
    name = next((entry[key] for key in _NAMES if key in entry), None)
    arguments: Any = next((entry[key] for key in _ARGUMENTS if key in entry), {})
    if not isinstance(name, str) or name not in offered:
        return None
    try:
        return WordedCall(tool=name, arguments=msgspec.convert(arguments, dict[str, Value]))
    except ValueError:
        return None
