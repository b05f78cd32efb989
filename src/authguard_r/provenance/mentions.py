# SPDX-License-Identifier: Apache-2.0
"""Which places and things of a site a text names, however it spells them: evidence for people.

Found is every name of the site in any case, spacing and punctuation (`station_101`, `S T A T I O N
101`), in characters that pass for its letters (another script's, `5tation 1O1`), with its number in
words (`station one-oh-one`, `the 101st station`), and over the border of two inputs. A name that
is found where none was meant costs a line in a log; no decision rests on either.

Source: section "Provenance-Confusion Game" (taint-style tests).
Spec page: docs/spec/provenance.md#mentions
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from enum import StrEnum

from msgspec import Struct

from authguard_r.provenance.folding import loosen, skeleton
from authguard_r.provenance.numerals import (
    ORDINAL,
    ComparedToken,
    has_humps,
    is_number,
    joins,
    read_tokens,
)

#: Words at the end of a text among which a name may begin that the next input goes on with.
_TAIL = 12
#: Words after a name among which its list of numbers may go on, and those between two numbers.
_LIST = 32
_LISTING = frozenset({"and", "or", "to", "through", "till", "until"})


class MentionMatch(StrEnum):
    """How near a mention is to the name: people read the nearer ones first.

    `unread` is no mention: the input was too long to be looked through.
    """

    EXACT = "exact"
    VARIANT = "variant"
    NUMBER = "number"
    SPLIT = "split"
    UNREAD = "unread"


class Mention(Struct, frozen=True, kw_only=True):
    """One name found in a text.

    Args:
        ids: every place or thing that the name may mean.
        how: how near it is to the site's spelling.
        start: where it begins in the text that was looked at.
        end: where it ends there.
        is_sure: no character had to pass for another.
    """

    ids: tuple[str, ...]
    how: MentionMatch
    start: int
    end: int
    is_sure: bool


class NameStart(Struct, frozen=True):
    """What may be the beginning of a name at the end of a text.

    Args:
        start: where the earliest begins in the text.
        begun: what each spells so far, a number at the end with and without.
    """

    start: int
    begun: tuple[str, ...]


class MentionNames:
    """Every name of a site, made ready to be found in a text in time that grows with the text.

    Args:
        spellings: external spelling of each place and thing, with its id.
    """

    def __init__(self, spellings: dict[str, str]) -> None:
        self._ids: dict[str, dict[str, dict[str, None]]] = {}
        self._exact = frozenset(_spaced(name) for name in spellings)
        for name, item in spellings.items():
            for folded in _keys(read_tokens(name)):
                same = self._ids.setdefault(skeleton(folded), {})
                same.setdefault(folded, {})[item] = None
        self._begun = frozenset(
            bare[:length] for bare in self._ids for length in range(1, len(bare) + 1)
        )

    def find(self, text: str) -> tuple[Mention, ...]:
        """Return every name in the text, as it is written and as it looks.

        A name within a longer one is left out: `Staff Corridor` names no `Corridor`. A longer one
        that takes a character for another hides nothing.
        """
        found = _outermost(self._scan(text, read_tokens(text), is_written=True))
        loose = loosen(text)
        if loose not in {text, text.lower()} or has_humps(text):
            found += _outermost(self._scan(loose, read_tokens(loose), is_written=False))
        return tuple(found)

    def opening(self, text: str) -> NameStart | None:
        """Return what the text's end may be the beginning of, for the next input to go on with."""
        tokens = read_tokens(text)[-_TAIL:]
        stop = len(tokens)
        while stop and is_number(tokens[stop - 1]):
            stop -= 1  # the number may go on: `station one hundred` / `and three`
        ends = {stop, len(tokens)}
        found = [
            (tokens[first].start, bare)
            for first in range(len(tokens))
            for last, bare, _ in self._spans(tokens, first)
            if last + 1 in ends
        ]
        if not found:
            return None
        return NameStart(min(found)[0], tuple(dict.fromkeys(bare for _, bare in found)))

    def goes_on(self, opening: NameStart, first: ComparedToken) -> bool:
        """True when a text that begins with this word may go on with what an earlier one began."""
        return is_number(first) or any(
            begun + first.skeleton in self._begun for begun in opening.begun
        )

    def _scan(
        self, text: str, tokens: list[ComparedToken], *, is_written: bool
    ) -> Iterator[Mention]:
        for first in range(len(tokens)):
            best, reached = None, first
            for last, bare, folded in self._spans(tokens, first):
                ids = self._named(bare, folded)
                if not ids:
                    continue
                start, end = tokens[first].start, tokens[last].end
                how = self._how(text[start:end], tokens[first : last + 1], is_written=is_written)
                sure = folded in self._ids[bare]
                found = Mention(ids=ids, how=how, start=start, end=end, is_sure=sure)
                if sure:
                    best, reached = found, last
                else:
                    yield found
            if best is not None:
                yield best
                yield from self._listed(tokens, first, reached)

    def _listed(self, tokens: list[ComparedToken], first: int, last: int) -> Iterator[Mention]:
        """Yield further numbers after a name: `stations 101, 102 and 103`."""
        stem = _joined(tokens[first:last])
        if not stem or not tokens[last].text.isdigit():
            return
        for token in tokens[last + 1 : last + 1 + _LIST]:
            folded = stem + token.text
            ids = tuple(self._ids.get(skeleton(folded), {}).get(folded, ()))
            if token.text.isdigit() and ids:
                start, end = tokens[first].start, token.end
                yield Mention(ids=ids, how=MentionMatch.VARIANT, start=start, end=end, is_sure=True)
            elif not token.text.isdigit() and token.text not in _LISTING:
                return

    def _spans(self, tokens: list[ComparedToken], first: int) -> Iterator[tuple[int, str, str]]:
        """Yield, as long as a name may come of it, the last token and what the span spells."""
        bare = folded = ""
        for last in range(first, len(tokens)):
            token = tokens[last]
            if last > first and not joins(tokens[last - 1], token):
                return
            bare += token.skeleton
            if bare not in self._begun:
                return
            folded += token.text
            yield last, bare, folded

    def _named(self, bare: str, folded: str) -> tuple[str, ...]:
        known = self._ids.get(bare, {})
        return tuple(
            dict.fromkeys(item for name in known if _passes(folded, name) for item in known[name])
        )

    def _how(self, written: str, tokens: list[ComparedToken], *, is_written: bool) -> MentionMatch:
        if is_written and _spaced(written) in self._exact:
            return MentionMatch.EXACT
        return (
            MentionMatch.NUMBER if any(token.changed for token in tokens) else MentionMatch.VARIANT
        )


def _spaced(text: str) -> str:
    return " ".join(text.casefold().split())


def _keys(tokens: list[ComparedToken]) -> Iterator[str]:
    """Yield the ways to say a name: as it is, and its number as an ordinal or one of several."""
    yield _joined(tokens)
    for number, rest in ((tokens[-1:], tokens[:-1]), (tokens[:1], tokens[1:])):
        digits = _joined(number).removesuffix(ORDINAL)
        if digits.isdigit() and rest:
            words = _joined(rest)
            yield from (words + digits, words + digits + ORDINAL, digits + ORDINAL + words)
            yield f"{words}s{digits}"


def _joined(tokens: list[ComparedToken]) -> str:
    return "".join(token.text for token in tokens)


def _passes(folded: str, name: str) -> bool:
    """True when a text of the name's skeleton may be read as the name.

    Digits may stand for letters as long as one letter is left, and letters for digits as long as
    one digit is left or the number is long: `pi` is no `P1`, `office I` no `Office 1`.
    """
    if folded == name:
        return True
    letters = [char == other for char, other in zip(folded, name, strict=True) if other.isalpha()]
    digits = [char == other for char, other in zip(folded, name, strict=True) if other.isdigit()]
    return (any(letters) or not letters) and (any(digits) or not digits or len(digits) >= 3)


def _outermost(found: Iterable[Mention]) -> list[Mention]:
    """Leave out what lies within a longer mention that is sure; they come in order of start."""
    kept: list[Mention] = []
    reached = -1
    for mention in found:
        if mention.end <= reached:
            continue
        if mention.is_sure:
            reached = mention.end
        kept.append(mention)
    return kept
