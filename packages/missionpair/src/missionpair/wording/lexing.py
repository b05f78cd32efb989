# SPDX-License-Identifier: Apache-2.0
"""A text as words, marks and names, with their places in it.

Names of places and things are found in any case, and with hyphens, underscores and line ends for
spaces; the longest is taken. Spec page: docs/spec/missionpair-access.md#reading
"""

from __future__ import annotations

import re
from bisect import bisect_left

from msgspec import Struct

_TOKEN = re.compile(
    r"""
    (?P<code> `[^`\n]+` )
  | (?P<number> [0-9]+ (?: \.[0-9]+ )? (?![^\W_]) )
  | (?P<word> [^\W_]+ (?: ['\u2019][^\W_]+ )* )
  | (?P<mark> [^\s_-] )
    """,
    re.VERBOSE,
)


class Name(Struct, frozen=True):
    """A spelling, and what it may stand for."""

    spelling: str
    is_place: bool
    is_thing: bool


class TextToken(Struct):
    """One word, number, mark, tool in backticks, or name.

    Args:
        kind: `code`, `number`, `word`, `mark` or `name`.
        text: in lower case; of `code` as it is written, without the backticks.
        start: where it begins in the text.
        end: where it ends.
        is_fresh: it begins a line.
        name: of `name`, which.
    """

    kind: str
    text: str
    start: int
    end: int
    is_fresh: bool = False
    name: Name | None = None


class Text(Struct, frozen=True):
    """A text with its tokens; a place is a token's number, and none is out of range."""

    raw: str
    tokens: list[TextToken]

    def word(self, place: int) -> str:
        """Return the token's text; empty for a name, and after the end."""
        return self.tokens[place].text if place < len(self.tokens) else ""

    def kind(self, place: int) -> str:
        """Return the token's kind; empty after the end."""
        return self.tokens[place].kind if place < len(self.tokens) else ""

    def name(self, place: int) -> Name | None:
        """Return the name that the token is; None where it is no name."""
        return self.tokens[place].name if place < len(self.tokens) else None

    def start(self, place: int) -> int:
        """Return where the token begins; after the end, where the text ends."""
        return self.tokens[place].start if place < len(self.tokens) else len(self.raw)

    def has(self, place: int, words: tuple[str, ...]) -> bool:
        """True when these words stand here."""
        return all(self.word(place + number) == word for number, word in enumerate(words))

    def place(self, position: int) -> int:
        """Return the first token that begins at a position of the text or after it."""
        return bisect_left(self.tokens, position, key=lambda token: token.start)


class NameLexicon:
    """The names that are known, by their first word, the longest first."""

    def __init__(self, places: tuple[str, ...], things: tuple[str, ...]) -> None:
        known = {name: Name(name, is_place=False, is_thing=True) for name in things}
        for spelling in places:
            known[spelling] = Name(spelling, is_place=True, is_thing=spelling in known)
        self._heads: dict[str, list[tuple[list[str], Name]]] = {}
        for spelling, name in known.items():
            words = [token.text for token in _plain_tokens(spelling)]
            if words:
                self._heads.setdefault(words[0], []).append((words, name))
        for found in self._heads.values():
            found.sort(key=lambda entry: -len(entry[0]))

    def cut(self, text: str) -> Text:
        """Return the text's tokens; the words of a name are one token."""
        plain = _plain_tokens(text)
        found: list[TextToken] = []
        place = 0
        while place < len(plain):
            token = plain[place]
            if token.text in self._heads:
                length = self._name_at(plain, place, text, found)
                if length:
                    place += length
                    continue
            found.append(token)
            place += 1
        return Text(text, found)

    def _name_at(
        self, plain: list[TextToken], place: int, text: str, found: list[TextToken]
    ) -> int:
        """Add the longest name that begins here, and return how many tokens it has."""
        best: tuple[int, Name] | None = None
        for words, name in self._heads[plain[place].text]:
            if best is not None and len(words) < best[0]:
                break
            here = plain[place : place + len(words)]
            if [token.text for token in here] != words:
                continue
            if text[here[0].start : here[-1].end] == name.spelling:
                best = len(words), name  # of names that differ in case, the one that is written
                break
            best = best or (len(words), name)
        if best is None:
            return 0
        length, name = best
        first, last = plain[place], plain[place + length - 1]
        found.append(TextToken("name", "", first.start, last.end, first.is_fresh, name))
        return length


def first_word(text: str) -> str:
    """Return the text of the first token; empty without tokens."""
    return next((token.text for token in _plain_tokens(text)), "")


def _plain_tokens(text: str) -> list[TextToken]:
    found: list[TextToken] = []
    line_end = text.find("\n")
    for match in _TOKEN.finditer(text):
        kind, written = match.lastgroup or "mark", match[0]
        start, end = match.span()
        is_fresh = 0 <= line_end < start
        if is_fresh:
            line_end = text.find("\n", start)
        inner = written[1:-1] if kind == "code" else written.casefold()
        found.append(TextToken(kind, inner, start, end, is_fresh))
    return found
