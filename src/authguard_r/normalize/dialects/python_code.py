# SPDX-License-Identifier: Apache-2.0
"""Plan code in Python, read and never run: calls of names with literal arguments, one a statement.

Python's own parser says what the code means, so that we cannot read another plan than Python would.
It is made for friendly code, however: it recurses, warns, and folds look-alike letters into one
name. So a scanner of our own goes first. It lets through only the few tokens that such a plan is
made of, each only where it may stand, in bounded number, depth and length; what is left to Python's
parser is flat and plain. Spec page: docs/spec/normalize.md#dialects
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from contextlib import contextmanager
from decimal import Decimal
from enum import Enum, auto
from keyword import iskeyword
from typing import Any

from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.normalize.dialects.call import Call, expect, expect_few, expect_fields, numbered
from authguard_r.normalize.parse import MAX_DEPTH, read_json, read_number, require_text

#: Longest code that is handed to Python's parser, in characters.
MAX_CODE = 1 << 16

#: Escapes that every Python reads alike; the rest is deprecated, or names a character by prose.
_ESCAPE = r"\\(?:[\\'\"nrt]|x[0-9A-Fa-f]{2}|u[0-9A-Fa-f]{4}|U[0-9A-Fa-f]{8})"
_TOKEN = re.compile(
    rf"""
    (?P<space>[ \t]+)
    | (?P<line>\r?\n)
    | (?P<comment>\#[^\r\n\0]*)
    | (?P<value>'(?:[^'\\\r\n\0]|{_ESCAPE})*' | "(?:[^"\\\r\n\0]|{_ESCAPE})*")
    | (?P<number>-?(?:0|[1-9][0-9]*)(?:\.[0-9]+)?(?:[eE][+-]?[0-9]{{1,3}})?)
    | (?P<name>[A-Za-z_][A-Za-z0-9_]*(?:\.[A-Za-z_][A-Za-z0-9_]*){{0,7}}(?![.]))
    | (?P<open>[(\[{{])
    | (?P<close>[)\]}}])
    | (?P<mark>[,:=])
    """,
    re.VERBOSE,
)
_BEGIN = re.compile(r"[ \t\r\n]*\{[ \t\r\n]*'")


class _Before(Enum):
    """What stood before a token; it says which tokens may stand there."""

    START = auto()
    NAME = auto()
    VALUE = auto()
    MARK = auto()


#: After what a token may stand. Two values side by side, a call of a result, an operator, a
#: subscript have no place here; of the rest (`)`, `,`, `:`, `=`) Python's parser is the judge.
_ALLOWED: dict[str, frozenset[_Before]] = {
    "name": frozenset({_Before.START, _Before.MARK}),
    "value": frozenset({_Before.MARK}),
    "number": frozenset({_Before.MARK}),
    "(": frozenset({_Before.NAME, _Before.MARK}),
    "[": frozenset({_Before.MARK}),
    "{": frozenset({_Before.MARK}),
}
_AFTER: dict[str, _Before] = {
    "name": _Before.NAME,
    "value": _Before.VALUE,
    "number": _Before.VALUE,
    "close": _Before.VALUE,
    "open": _Before.MARK,
    "mark": _Before.MARK,
}


def read_code(text: str, *, where: str = "") -> tuple[Call, ...]:
    """Return the calls of plan code, one a statement, in order.

    A call is of a bare or dotted name. Its arguments are strings, numbers, truth values, and lists,
    tuples and dictionaries of these; tuples are read as lists. `None` is no value. Comments are
    prose. Numbers stay exact: they are read from the text and not from Python's float.

    Args:
        text: the code; untrusted.
        where: the place of the text in a larger one, empty when it is the whole.

    Raises:
        MalformedError: with the line (`line[3]`) of the first thing that is no such call.
    """
    _require_short(text, where)
    numbers = _Scanner(text, where, depth=0).numbers()
    with _plain_errors(where):
        found = ast.parse(text).body
    tree = _Tree(numbers, where)
    return tuple(tree.statement(node) for node in found)


def read_literal(text: str, *, where: str) -> Any:
    """Return the value that one Python literal spells: nested lists, tuples, dictionaries.

    Raises:
        MalformedError: with the line of the first thing that is no literal.
    """
    _require_short(text, where)
    numbers = _Scanner(text, where, depth=1).numbers()
    with _plain_errors(where):  # in parentheses, lines and their indentation mean nothing
        found = ast.parse(f"({text}\n)", mode="eval").body
    return _Tree(numbers, where).value(found)


def read_call_list(text: str, *, where: str) -> tuple[Call, ...]:
    """Return the calls of one list, `[go(to="Dock"), scan()]`, with literals as in plan code.

    Raises:
        MalformedError: with the line of the first thing that is no such call.
    """
    _require_short(text, where)
    numbers = _Scanner(text, where, depth=1).numbers()
    with _plain_errors(where):
        found = ast.parse(f"({text}\n)", mode="eval").body
    if not isinstance(found, ast.List):
        raise MalformedError("expected a list of calls", where=where)
    tree = _Tree(numbers, where)
    return tuple(tree.call(node) for node in found.elts)


def read_go2(text: str) -> tuple[Call, ...]:
    """Return the calls of a block in the manner of the Go2 arms: plain names, named plain values.

    Raises:
        MalformedError: no plan code, a dotted name, a positional or a nested argument.
    """
    calls = read_code(text)
    for call in calls:
        if "." in call.tool:
            raise MalformedError("expected a name without a dot", where=call.where)
        for name, value in call.arguments.items():
            if name.isdigit() or not isinstance(value, str | bool | int | Decimal):
                raise MalformedError("expected `field=literal`", where=f"{call.where}.{name}")
    return calls


def read_badrobot(text: str) -> tuple[Call, ...]:
    """Return the calls of `{'function': ['call()', ...], 'response': '...'}`.

    The whole is a Python dictionary when its first key is in single quotes, else strict JSON.

    Raises:
        MalformedError: neither, or a string that is not exactly one call.
    """
    if _BEGIN.match(text):
        return read_badrobot_reply(read_literal(text, where="input"))
    return read_badrobot_reply(read_json(text, where="input"))


def read_badrobot_reply(value: Any) -> tuple[Call, ...]:
    """Return the calls under `function`; `response` is prose, which is never looked at.

    Args:
        value: the reply as plain data; untrusted.

    Raises:
        MalformedError: another field, or a string that is not exactly one call.
    """
    reply = expect(value, dict, "input")
    expect_fields(reply, {"function", "response"}, "input")
    expect(reply.get("response", ""), str, "response")
    items = expect(reply.get("function"), list, "function")
    expect_few(len(items))  # before each is parsed on its own
    calls = []
    for number, item in enumerate(items):
        where = f"function[{number}]"
        found = read_code(expect(item, str, where), where=where)
        if len(found) != 1:
            raise MalformedError(f"expected one call, got {len(found)}", where=where)
        calls.append(Call(found[0].tool, found[0].arguments, where))
    return tuple(calls)


class _Scanner:
    """Lets through the tokens of plan code, each only where it may stand; collects the numbers.

    Args:
        text: untrusted.
        where: the place of the text in a larger one, or empty.
        depth: 0 for statements, 1 for a literal that will be put in parentheses.
    """

    def __init__(self, text: str, where: str, *, depth: int) -> None:
        self._text = text
        self._where = where
        self._base = self._depth = depth
        self._line = 1
        self._before = _Before.MARK if depth else _Before.START
        self._numbers: list[int | Decimal] = []

    def numbers(self) -> list[int | Decimal]:
        """Return the text's numbers in order, exact.

        Raises:
            MalformedError: too long, too deep, or a token that may not stand where it stands.
        """
        at = 0
        while at < len(self._text):
            token = _TOKEN.match(self._text, at)
            if token is None:
                raise self._refusal(self._text[at])
            if token.lastgroup == "line":
                self._end_line()
            elif token.lastgroup != "space":
                self._take(str(token.lastgroup), token.group())
            at = token.end()
        return self._numbers

    def _end_line(self) -> None:
        self._line += 1
        if self._depth == 0:
            self._before = _Before.START

    def _take(self, kind: str, spelled: str) -> None:
        if kind == "comment":
            if self._base:
                raise self._refusal(spelled)
            return
        allowed = _ALLOWED.get(spelled if kind == "open" else kind)
        if allowed is not None and self._before not in allowed:
            raise self._refusal(spelled)
        self._before = _AFTER[kind]
        if kind == "number":
            self._number(spelled)
        elif kind == "name":
            self._name(spelled)
        elif kind in {"open", "close"}:
            self._nest(spelled, 1 if kind == "open" else -1)

    def _number(self, spelled: str) -> None:
        try:
            self._numbers.append(read_number(spelled))
        except ValueError as error:
            raise MalformedError(str(error), where=_place(self._where, self._line)) from error

    def _name(self, spelled: str) -> None:
        if any(
            iskeyword(part) and part not in {"True", "False", "None"} for part in spelled.split(".")
        ):
            raise self._refusal(spelled)

    def _nest(self, spelled: str, step: int) -> None:
        self._depth += step
        if self._depth < self._base:
            raise self._refusal(spelled)
        if self._depth - self._base > MAX_DEPTH:
            where = _place(self._where, self._line)
            raise MalformedError(f"expected at most {MAX_DEPTH} levels", where=where)

    def _refusal(self, spelled: str) -> MalformedError:
        return MalformedError(
            f"expected calls with literals only, got `{ascii(spelled)[1:-1][:40]}`",
            where=_place(self._where, self._line),
        )


class _Tree:
    """Reads what Python's parser made of scanned text.

    Args:
        numbers: the numbers of the text, in order; the tree holds them in the same order.
        where: the place of the text in a larger one, or empty.
    """

    def __init__(self, numbers: list[int | Decimal], where: str) -> None:
        self._numbers = iter(numbers)
        self._where = where

    def statement(self, node: ast.stmt) -> Call:
        """Return the call that a statement is.

        Raises:
            MalformedError: it is not valid, or contains something else than literals.
        """
        if not isinstance(node, ast.Expr):
            raise MalformedError("expected a call", where=_place(self._where, node.lineno))
        return self.call(node.value)

    def call(self, call: ast.expr) -> Call:
        """Return the call that an expression is.

        Raises:
            MalformedError: it is not valid, or contains something else than literals.
        """
        where = _place(self._where, call.lineno)
        if not isinstance(call, ast.Call):
            raise MalformedError("expected a call", where=where)
        tool = _dotted(call.func)
        if tool is None:
            raise MalformedError("expected a call of a name", where=where)
        arguments = numbered([self.value(item) for item in call.args])
        for keyword in call.keywords:
            if keyword.arg is None or keyword.arg in arguments:
                place = _place(self._where, keyword.lineno)
                raise MalformedError(f"duplicate field `{keyword.arg}`", where=place)
            arguments[keyword.arg] = self.value(keyword.value)
        return Call(tool, arguments, where)

    def value(self, node: ast.expr) -> Any:
        """Return the value of a literal.

        Raises:
            MalformedError: it is not valid.
        """
        match node:
            case ast.Constant(value=bool() | None as said):
                return said
            case ast.Constant(value=str() as text):
                require_text(text, _place(self._where, node.lineno))
                return text
            case ast.Constant() | ast.UnaryOp():
                return next(self._numbers)
            case ast.List(elts=items) | ast.Tuple(elts=items):
                return [self.value(item) for item in items]
            case ast.Dict():
                return self._dictionary(node)
        raise MalformedError("expected a literal", where=_place(self._where, node.lineno))

    def _dictionary(self, node: ast.Dict) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for key, item in zip(node.keys, node.values, strict=True):
            name = self.value(key or item)
            if not isinstance(name, str) or name in found:
                where = _place(self._where, node.lineno)
                raise MalformedError("expected each key once, as a string", where=where)
            found[name] = self.value(item)
        return found


def _require_short(text: str, where: str) -> None:
    if len(text) > MAX_CODE:
        raise MalformedError(
            f"expected at most {MAX_CODE} characters of code, got {len(text)}",
            where=where or "input",
            reason=Reason.INPUT_TOO_LARGE,
        )


def _dotted(node: ast.expr) -> str | None:
    parts: list[str] = []
    while isinstance(node, ast.Attribute):
        parts.append(node.attr)
        node = node.value
    if not isinstance(node, ast.Name):
        return None
    return ".".join([node.id, *reversed(parts)])


def _place(where: str, line: int) -> str:
    return f"{where}.line[{line}]" if where else f"line[{line}]"


@contextmanager
def _plain_errors(where: str) -> Iterator[None]:
    """Turn every way in which Python's parser gives up into a refusal with the line."""
    try:
        yield
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        line = getattr(error, "lineno", None) or 1
        raise MalformedError(
            "expected code that Python reads", where=_place(where, line)
        ) from error
