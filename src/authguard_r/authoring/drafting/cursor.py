# SPDX-License-Identifier: Apache-2.0
"""Where the reader stands in the sentence, and what lies ahead of it."""

from __future__ import annotations

from authguard_r.authoring.drafting.tokens import SentenceToken


class Cursor:
    """A place in the tokens; only its holder moves it.

    Args:
        tokens: the sentence.
    """

    def __init__(self, tokens: tuple[SentenceToken, ...]) -> None:
        self.tokens = tokens
        self.at = 0

    def low(self, offset: int = 0) -> str:
        """Return a token ahead in lower case; empty behind the end."""
        place = self.at + offset
        return self.tokens[place].low if place < len(self.tokens) else ""

    def starts(self, words: tuple[str, ...], offset: int = 0) -> bool:
        """True when these words stand ahead."""
        return all(self.low(offset + n) == word for n, word in enumerate(words))

    def first(self, phrases: tuple[tuple[str, ...], ...], offset: int = 0) -> int:
        """Return the length of the first phrase that stands ahead, or 0."""
        return next((len(words) for words in phrases if self.starts(words, offset)), 0)

    def span(self, size: int) -> tuple[int, int]:
        """Return where the next tokens begin and end in the sentence."""
        last = self.tokens[self.at + size - 1]
        return self.tokens[self.at].at, last.at + len(last.text)
