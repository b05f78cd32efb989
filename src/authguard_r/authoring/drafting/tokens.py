# SPDX-License-Identifier: Apache-2.0
"""A sentence as words, numbers, times and marks; nothing is thrown away but white space.

What the grammar does not use later becomes a question, so a token that vanished here would be a
condition that no person sees.
"""

from __future__ import annotations

import re
import unicodedata
from enum import StrEnum

from msgspec import Struct

from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason

#: The longest sentence, in characters: the mission language's own bound on `task`.
MAX_SENTENCE = 2000


class TokenKind(StrEnum):
    """What a token is."""

    WORD = "word"
    NUMBER = "number"
    CLOCK = "clock"  # 14:30
    INSTANT = "instant"  # RFC 3339, UTC
    MARK = "mark"


class SentenceToken(Struct, frozen=True):
    """One piece of the sentence.

    Args:
        kind: what it is.
        text: as it is written.
        low: in lower case, for comparing.
        at: its place in the sentence, in characters.
    """

    kind: TokenKind
    text: str
    low: str
    at: int


#: A sentence.
Tokens = tuple[SentenceToken, ...]


_TOKEN = re.compile(
    r"""
    (?P<instant>[0-9]{4}-[0-9]{2}-[0-9]{2}T[0-9]{2}:[0-9]{2}:[0-9]{2}Z)
  | (?P<clock>[0-9]{1,2}:[0-9]{2}(?![0-9:]))
  | (?P<number>[0-9]+(?:\.[0-9]+)?)
  | (?P<word>[^\W\d_]+(?:['\u2019][^\W\d_]+)*)
  | (?P<mark>\S)
    """,
    re.VERBOSE,
)
#: Marks inside a name (`package-p1`, `wet_floor`): they join what stands on both sides.
_JOINTS = frozenset("-_")
_RUN = re.compile(r"[0-9]+|[^\W\d_]+")


def tokenize(sentence: str) -> tuple[SentenceToken, ...]:
    """Return the tokens of a sentence.

    Raises:
        MalformedError: empty, too long, or text that a signature could not hold as it is.
    """
    if len(sentence) > MAX_SENTENCE:
        raise MalformedError(
            f"expected at most {MAX_SENTENCE} characters, got {len(sentence)}",
            where="sentence",
            reason=Reason.INPUT_TOO_LARGE,
        )
    if not sentence.strip():
        raise MalformedError("expected a sentence", where="sentence")
    _require_text(sentence)
    found = [
        SentenceToken(
            TokenKind(match.lastgroup or ""), match.group(), match.group().lower(), match.start()
        )
        for match in _TOKEN.finditer(sentence)
    ]
    return tuple(
        token
        for number, token in enumerate(found)
        if not (token.text in _JOINTS and _joins(found, number))
    )


def runs(text: str) -> tuple[str, ...]:
    """Return a name's key: letters that follow each other joined, digits kept apart.

    `Dining Table`, `DiningTable` and `dining-table` have one key; `room 10 1` and `room 101` have
    two.
    """
    key: list[str] = []
    for part in _RUN.findall(text.lower()):
        if key and part.isalpha() and key[-1].isalpha():
            key[-1] += part
        else:
            key.append(part)
    return tuple(key)


def _require_text(sentence: str) -> None:
    """Refuse what could not be signed as `task`, or would be shown other than it is."""
    for at, mark in enumerate(sentence):
        if unicodedata.category(mark) in {"Cc", "Cf", "Co", "Cs"} and mark not in "\t\n\r":
            raise MalformedError(
                f"expected visible text, got U+{ord(mark):04X}", where=f"sentence[{at}]"
            )
    if unicodedata.normalize("NFC", sentence) != sentence:
        raise MalformedError("expected text in normalization form C", where="sentence")


def _joins(found: list[SentenceToken], number: int) -> bool:
    """True when the mark stands between two tokens without a space on either side."""
    if number in {0, len(found) - 1}:
        return False
    before, mark, after = found[number - 1 : number + 2]
    glued = before.at + len(before.text) == mark.at and mark.at + 1 == after.at
    return (
        glued
        and TokenKind.WORD in {before.kind, after.kind}
        and TokenKind.MARK
        not in {
            before.kind,
            after.kind,
        }
    )
