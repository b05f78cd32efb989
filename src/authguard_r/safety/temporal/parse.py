# SPDX-License-Identifier: Apache-2.0
"""A rule's text to a formula: one grammar, no second reading, nothing evaluated.

Spec page: docs/spec/safety.md#syntax
"""

from __future__ import annotations

import re
from collections.abc import Callable

from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import MAX_INTEGER, is_identifier
from authguard_r.core.reasons import Reason
from authguard_r.safety.temporal.formula import (
    FALSE,
    TRUE,
    Atom,
    AtomComparison,
    Formula,
    Op,
    negated,
)

#: Longest formula, in characters.
MAX_LENGTH = 1_000
#: How deep brackets, prefixes and right-hand sides may nest.
MAX_DEPTH = 32

# a word may end with any character of an identifier, but `a->b` is not the word `a-`
_TOKEN = re.compile(r"->|<=|>=|!=|[=<>()&|!]|-?[a-z0-9](?:[a-z0-9_.:]|-(?!>))*|WX|[GFXURWM]")
_INTEGER = re.compile(r"-?(?:0|[1-9][0-9]{0,15})")
_PREFIXES: dict[str, Callable[[Formula], Formula]] = {
    "!": negated,
    "G": lambda part: Formula(Op.RELEASE, (FALSE, part)),
    "F": lambda part: Formula(Op.UNTIL, (TRUE, part)),
    "X": lambda part: Formula(Op.NEXT, (part,)),
    "WX": lambda part: Formula(Op.WEAK_NEXT, (part,)),
}
_BETWEEN = frozenset({"U", "W", "R", "M"})
#: Fields of an action that hold one name each.
NAMED = frozenset({"type", "object", "source", "destination"})


def parse(text: str, *, where: str = "formula") -> Formula:
    """Return the formula that the text spells.

    Args:
        text: from a signed configuration, or from anyone.
        where: prefix of the place in messages.

    Raises:
        MalformedError: it is not valid, longer than `MAX_LENGTH` or deeper than `MAX_DEPTH`; the
            place ends with the column, from 1.
    """
    if len(text) > MAX_LENGTH:
        message = f"expected at most {MAX_LENGTH} characters, got {len(text)}"
        raise MalformedError(message, where=where, reason=Reason.INPUT_TOO_LARGE)
    return _Parser(_tokens(text, where), where).whole()


def _tokens(text: str, where: str) -> list[tuple[str, int]]:
    """Return the text's tokens, each with its column, and an empty one at the end."""
    found: list[tuple[str, int]] = []
    place = 0
    while place < len(text):
        if text[place] == " ":
            place += 1
            continue
        token = _TOKEN.match(text, place)
        if token is None:
            raise MalformedError("not a token of a formula", where=f"{where}:{place + 1}")
        found.append((token[0], place + 1))
        place = token.end()
    return [*found, ("", len(text) + 1)]


class _Parser:
    """Reads tokens from the left; each method returns what its line of the grammar says."""

    def __init__(self, tokens: list[tuple[str, int]], where: str) -> None:
        self._tokens = tokens
        self._where = where
        self._next = 0
        self._depth = 0

    def whole(self) -> Formula:
        """A formula, and nothing behind it."""
        formula = self._implication()
        if self._word:
            raise self._wrong("an operator or the end")
        return formula

    @property
    def _word(self) -> str:
        return self._tokens[self._next][0]

    def _take(self) -> str:
        self._next += 1
        return self._tokens[self._next - 1][0]

    def _taken(self, word: str) -> bool:
        """Step over the word, if it is the next one."""
        found = self._word == word
        self._next += found
        return found

    def _wrong(self, expected: str) -> MalformedError:
        word, column = self._tokens[self._next]
        got = f"`{word}`" if word else "the end"
        return MalformedError(f"expected {expected}, got {got}", where=f"{self._where}:{column}")

    def _nested(self, read: Callable[[], Formula]) -> Formula:
        """Read one level deeper."""
        if self._depth == MAX_DEPTH:
            raise self._wrong(f"at most {MAX_DEPTH} levels")
        self._depth += 1
        formula = read()
        self._depth -= 1
        return formula

    def _implication(self) -> Formula:
        left = self._joined("|", Op.OR, lambda: self._joined("&", Op.AND, self._between))
        if not self._taken("->"):
            return left
        return Formula(Op.OR, (negated(left), self._nested(self._implication)))

    def _joined(self, word: str, op: Op, read: Callable[[], Formula]) -> Formula:
        parts = [read()]
        while self._taken(word):
            parts.append(read())
        return parts[0] if len(parts) == 1 else Formula(op, tuple(parts))

    def _between(self) -> Formula:
        left = self._prefixed()
        if self._word not in _BETWEEN:
            return left
        op = Op(self._take())
        return Formula(op, (left, self._nested(self._between)))

    def _prefixed(self) -> Formula:
        word = self._word
        if word in _PREFIXES:
            self._take()
            return _PREFIXES[word](self._nested(self._prefixed))
        if self._taken("("):
            inner = self._nested(self._implication)
            if not self._taken(")"):
                raise self._wrong("`)`")
            return inner
        if self._taken("true"):
            return TRUE
        return FALSE if self._taken("false") else self._atom()

    def _atom(self) -> Formula:
        word = self._word
        kind, dot, name = word.partition(".")
        if word in NAMED:
            return self._named()
        if word == "route":
            return self._route()
        if dot and kind in {"params", "state"} and is_identifier(name):
            return self._compared(words=kind == "state")
        raise self._wrong("`true`, `false` or a field of an action")

    def _named(self) -> Formula:
        field = self._take()
        equal = self._equal()
        return _literal(Atom(field, AtomComparison.EQUAL, self._identifier()), positive=equal)

    def _route(self) -> Formula:
        field = self._take()
        if not self._taken("contains"):
            raise self._wrong("`contains`")
        return _literal(Atom(field, AtomComparison.CONTAINS, self._identifier()), positive=True)

    def _compared(self, *, words: bool) -> Formula:
        field, sign = self._take(), self._word
        if sign in {"=", "!="} and words:
            equal = self._equal()
            number = self._integer() if _INTEGER.fullmatch(self._word) else self._identifier()
            return _literal(Atom(field, AtomComparison.EQUAL, number), positive=equal)
        if sign in {"=", "!="}:
            equal = self._equal()
            return _literal(Atom(field, AtomComparison.EQUAL, self._integer()), positive=equal)
        if sign not in {"<", "<=", ">", ">="}:
            raise self._wrong("a comparison")
        self._take()
        most = self._integer(less=1 if sign in {"<", ">="} else 0)
        return _literal(Atom(field, AtomComparison.AT_MOST, most), positive=sign in {"<", "<="})

    def _equal(self) -> bool:
        if self._word not in {"=", "!="}:
            raise self._wrong("`=` or `!=`")
        return self._take() == "="

    def _identifier(self) -> str:
        if not is_identifier(self._word):
            raise self._wrong("an identifier")
        return self._take()

    def _integer(self, less: int = 0) -> int:
        number = int(self._word) - less if _INTEGER.fullmatch(self._word) else None
        if number is None or abs(number) > MAX_INTEGER:
            raise self._wrong("an integer that signed data can contain")
        self._take()
        return number


def _literal(atom: Atom, *, positive: bool) -> Formula:
    return Formula(Op.ATOM if positive else Op.NOT, (), atom)
