# SPDX-License-Identifier: Apache-2.0
"""Strict parsers for what planners write: parsed, never evaluated, never repaired (L12).

JSON: UTF-8, bounded length and depth, no duplicate keys, no NaN, no lone surrogates; numbers stay
exact decimals, so that no float ever reaches a comparison (L3).
Spec page: docs/spec/normalize.md
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from decimal import Decimal, InvalidOperation
from typing import Any

from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason

#: Longest planner reply that is looked at, in bytes.
MAX_TEXT = 1 << 18
MAX_DEPTH = 32
MAX_CALLS = 256
#: Longest number, in characters: more digits than any quantity has.
MAX_NUMBER = 40

#: A number as JSON spells it.
NUMBER = re.compile(r"-?(?:0|[1-9][0-9]*)(?:\.[0-9]+)?(?:[eE][+-]?[0-9]{1,3})?")
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_SPACE = re.compile(r"[ \t\r\n]*")
_STRING_OR_BRACKET = re.compile(r'"(?:[^"\\]|\\.)*"?|[\[\]{}]', re.DOTALL)
#: What the decoder says where text stops being JSON, as a planner's author reads it.
_FAULTS = {
    "Extra data": "expected nothing after the JSON value",
    "Expecting value": "expected a JSON value",
    "Expecting property name enclosed in double quotes": "expected a name in double quotes",
    "Expecting ',' delimiter": "expected `,`",
    "Expecting ':' delimiter": "expected `:`",
    "Unterminated string starting at": "expected an end of the string that begins here",
}
_WORDS: dict[str, bool | None] = {
    "true": True,
    "True": True,
    "false": False,
    "False": False,
    "null": None,
    "None": None,
}


def read_text(data: bytes) -> str:
    """Return a planner's bytes as text.

    Raises:
        MalformedError: too long (`INPUT_TOO_LARGE`) or not UTF-8.
    """
    if len(data) > MAX_TEXT:
        raise MalformedError(
            f"expected at most {MAX_TEXT} bytes, got {len(data)}",
            where="input",
            reason=Reason.INPUT_TOO_LARGE,
        )
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise MalformedError("expected UTF-8", where=f"input[{error.start}]") from error


def read_json(text: str, *, where: str) -> Any:
    """Return the value that strict JSON spells; numbers are `int` or `Decimal`.

    Raises:
        MalformedError: with the place where the text stops being JSON.
    """
    return _checked(text, where, lambda: _STRICT.decode(text))


def read_json_sequence(text: str, *, where: str) -> list[Any]:
    """Return the values that strict JSON spells, one after the other, with `;` between them.

    Raises:
        MalformedError: with the place where the text stops being that.
    """

    def values() -> list[Any]:
        found, at = [], _skip(text, 0)
        while at < len(text):
            value, at = _STRICT.raw_decode(text, at)
            found.append(value)
            at = _skip(text, at)
            if at < len(text):
                if text[at] != ";":
                    raise json.JSONDecodeError("expected `;`", text, at)
                at = _skip(text, at + 1)
                if at == len(text):
                    raise json.JSONDecodeError("Expecting value", text, at)
        return found

    found: list[Any] = _checked(text, where, values)
    return found


def _checked(text: str, where: str, decode: Callable[[], Any]) -> Any:
    """Return what a decoder reads from text whose depth is bounded, in well-formed characters."""
    _require_depth(text, where)
    try:
        value = decode()
    except json.JSONDecodeError as error:
        message = _FAULTS.get(error.msg, error.msg.lower())
        raise MalformedError(message, where=f"{where}[{error.pos}]") from error
    except (ValueError, RecursionError) as error:
        raise MalformedError(str(error), where=where) from error
    if "\\u" in text:  # only an escape can spell what UTF-8 cannot
        require_text(value, where)
    return value


def read_calls(text: str) -> list[tuple[str, dict[str, Any], str]]:
    """Return the calls in `name(field=literal, ...)` text, one after the other.

    Calls may be separated by white space, `;` or `,`. A literal is a quoted string, a number, a
    truth value or `null`; nothing else is a literal, and nothing is evaluated.

    Raises:
        MalformedError: with the offset of the first thing that is no such call.
    """
    calls: list[tuple[str, dict[str, Any], str]] = []
    at = _skip(text, 0)
    while at < len(text):
        place = f"input[{at}]"
        name = _NAME.match(text, at)
        if name is None or text[name.end() : name.end() + 1] != "(":
            raise MalformedError("expected a call such as `go(destination='...')`", where=place)
        arguments, at = _arguments(text, name.end() + 1)
        calls.append((name.group(), arguments, place))
        at = _skip(text, at)
        if text[at : at + 1] in {";", ","}:
            at = _skip(text, at + 1)
    return calls


def _arguments(text: str, at: int) -> tuple[dict[str, Any], int]:
    found: dict[str, Any] = {}
    at = _skip(text, at)
    if text[at : at + 1] == ")":
        return found, at + 1
    while True:
        name = _NAME.match(text, at)
        if name is None or text[name.end() : name.end() + 1] != "=":
            raise MalformedError("expected `field=literal`", where=f"input[{at}]")
        if name.group() in found:
            raise MalformedError(f"duplicate field `{name.group()}`", where=f"input[{at}]")
        found[name.group()], at = _literal(text, name.end() + 1)
        at = _skip(text, at)
        mark = text[at : at + 1]
        if mark == ")":
            return found, at + 1
        if mark != ",":
            raise MalformedError("expected `,` or `)`", where=f"input[{at}]")
        at = _skip(text, at + 1)


def _literal(text: str, at: int) -> tuple[Any, int]:
    mark = text[at : at + 1]
    if mark in {"'", '"'}:
        end = text.find(mark, at + 1)
        body = text[at + 1 : end] if end > at else ""
        if end < 0 or "\\" in body or "\n" in body:
            raise MalformedError("expected a quoted string without escapes", where=f"input[{at}]")
        return body, end + 1
    number = NUMBER.match(text, at)
    if number is not None:
        try:
            return read_number(number.group()), number.end()
        except ValueError as error:
            raise MalformedError(str(error), where=f"input[{at}]") from error
    word = _NAME.match(text, at)
    if word is not None and word.group() in _WORDS:
        return _WORDS[word.group()], word.end()
    raise MalformedError("expected a string, a number or a truth value", where=f"input[{at}]")


def read_number(text: str) -> int | Decimal:
    """Return the exact number that a literal spells.

    Raises:
        ValueError: longer than any quantity, or no number.
    """
    return _integer(text) if text.lstrip("-").isdigit() else _decimal(text)


def require_text(value: Any, where: str) -> None:
    """Refuse lone surrogates, which escapes can smuggle in.

    Args:
        value: plain data; text in it is looked at, keys included.
        where: its place, for messages.

    Raises:
        MalformedError: with the place of the text that holds half a character.
    """
    if isinstance(value, str):
        try:
            value.encode("utf-8")
        except UnicodeEncodeError as error:
            raise MalformedError("expected well-formed text", where=where) from error
    elif isinstance(value, dict):
        for key, item in value.items():
            require_text(key, where)
            require_text(item, f"{where}.{key}")
    elif isinstance(value, list):
        for number, item in enumerate(value):
            require_text(item, f"{where}[{number}]")


def _skip(text: str, at: int) -> int:
    space = _SPACE.match(text, at)
    return at if space is None else space.end()


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in pairs:
        if name in found:
            raise ValueError(f"duplicate key `{name}`")
        found[name] = value
    return found


def _integer(text: str) -> int:
    if len(text) > MAX_NUMBER:
        raise ValueError(f"expected a number of at most {MAX_NUMBER} characters")
    return int(text)


def _decimal(text: str) -> Decimal:
    if len(text) > MAX_NUMBER:
        raise ValueError(f"expected a number of at most {MAX_NUMBER} characters")
    try:
        value = Decimal(text)
    except InvalidOperation as error:
        raise ValueError("expected a number") from error
    if not value.is_finite() or abs(value.adjusted()) > MAX_NUMBER:
        raise ValueError("expected a finite number of sensible size")
    return value


def _constant(text: str) -> Any:
    raise ValueError(f"`{text}` is no number")


def _require_depth(text: str, where: str) -> None:
    """Refuse nesting before the parser recurses: strings are skipped, brackets counted."""
    if text.count("[") + text.count("{") <= MAX_DEPTH:
        return
    depth = 0
    for token in _STRING_OR_BRACKET.finditer(text):
        if token.group() in {"[", "{"}:
            depth += 1
        elif token.group() in {"]", "}"}:
            depth -= 1
        if depth > MAX_DEPTH:
            place = f"{where}[{token.start()}]"
            raise MalformedError(f"expected at most {MAX_DEPTH} levels", where=place)


_STRICT = json.JSONDecoder(
    object_pairs_hook=_object,
    parse_float=_decimal,
    parse_int=_integer,
    parse_constant=_constant,
)
