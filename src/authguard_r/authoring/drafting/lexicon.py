# SPDX-License-Identifier: Apache-2.0
"""The site's names as the grammar's nouns: what a phrase can mean here, and nothing else.

A full name means its owner. The last words of a name without its number (`package` of `Package
P1`) mean every owner of such a name, so that `the package` is one thing or a question.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from enum import StrEnum
from itertools import pairwise

from msgspec import Struct

from authguard_r.authoring.drafting.tokens import SentenceToken, TokenKind, runs
from authguard_r.site.model import Site

#: Longest name, in tokens.
_LONGEST = 8
_WORD = re.compile(r"[0-9]+|[A-Z]+(?![a-z])|[^\W\d_][^\W\d_A-Z]*")
_PLURAL = re.compile(r"(?<=\w)s(?= [0-9]+$)", re.IGNORECASE)
_NAMING = frozenset({TokenKind.WORD, TokenKind.NUMBER})


class Sort(StrEnum):
    """What a name belongs to."""

    OBJECT = "object"
    REGION = "region"
    ROBOT = "robot"


class Ref(Struct, frozen=True, order=True):
    """One thing of the site."""

    sort: Sort
    id: str


class PhraseMatch(Struct, frozen=True):
    """A phrase of the sentence that the site knows.

    Args:
        text: the phrase as it was said.
        size: its length in tokens.
        refs: everything that it can mean, sorted; at least one.
        exact: it is a whole name, not the general word in one.
    """

    text: str
    size: int
    refs: tuple[Ref, ...]
    exact: bool


Key = tuple[str, ...]


class Lexicon(Struct, frozen=True):
    """Whole names and general words, each with everything that it can mean."""

    names: dict[Key, tuple[Ref, ...]]
    heads: dict[Key, tuple[Ref, ...]]

    def match(self, tokens: tuple[SentenceToken, ...], at: int) -> PhraseMatch | None:
        """Return the longest phrase from a token on that the site knows, or None."""
        for size in range(min(_LONGEST, len(tokens) - at), 0, -1):
            span = tokens[at : at + size]
            if not all(token.kind in _NAMING for token in span):
                continue
            text = _said(span)
            for key in _spellings(text):
                for table, exact in ((self.names, True), (self.heads, False)):
                    if key in table:
                        return PhraseMatch(text, size, table[key], exact)
        return None

    def numbered(self, token: SentenceToken, last: str) -> PhraseMatch | None:
        """Return what a number means that goes on with the last name: `stations 101, 102`."""
        stem = last.rpartition(" ")[0] if token.kind is TokenKind.NUMBER else ""
        for said in (stem, stem.removesuffix("s")):
            refs = self.names.get(runs(f"{said} {token.low}"), ()) if stem else ()
            if refs:
                return PhraseMatch(f"{said} {token.low}", 1, refs, exact=True)
        return None


def read_lexicon(site: Site, *, reserved: Iterable[str]) -> Lexicon:
    """Return the names of a site.

    Args:
        site: the model.
        reserved: words of the grammar; a name that is nothing else is not looked up.
    """
    names: dict[Key, set[Ref]] = {}
    heads: dict[Key, set[Ref]] = {}
    taken = {runs(word) for word in reserved}
    for ref, spellings in _owners(site):
        for spelling in spellings:
            if runs(spelling) not in taken:
                names.setdefault(runs(spelling), set()).add(ref)
            for head in _heads(spelling):
                heads.setdefault(head, set()).add(ref)
    for item, model in site.objects.items():
        heads.setdefault(runs(model.kind), set()).add(Ref(Sort.OBJECT, item))
    return Lexicon(
        {key: tuple(sorted(refs)) for key, refs in names.items() if key},
        {key: tuple(sorted(refs)) for key, refs in heads.items() if key and key not in taken},
    )


def _said(span: tuple[SentenceToken, ...]) -> str:
    """Return tokens as they were said: with a space where one, or a joint, was."""
    parts = [span[0].text]
    for before, token in pairwise(span):
        glued = before.at + len(before.text) == token.at
        parts.append(token.text if glued else f" {token.text}")
    return "".join(parts)


def _owners(site: Site) -> Iterator[tuple[Ref, tuple[str, ...]]]:
    for item, thing in site.objects.items():
        yield Ref(Sort.OBJECT, item), (item, *thing.names)
    for region, place in site.regions.items():
        yield Ref(Sort.REGION, region), (region, *place.names)
    for robot in site.robots:
        yield Ref(Sort.ROBOT, robot), (robot,)


def _heads(spelling: str) -> Iterator[Key]:
    """Yield the general words in a name: its ending, without the number or letter after it."""
    words = _WORD.findall(spelling)
    kept = list(words)
    while kept and (kept[-1].isdigit() or len(kept[-1]) == 1):
        kept.pop()
    first = 0 if len(kept) < len(words) else 1
    for start in range(first, len(kept)):
        yield runs(" ".join(kept[start:]))


def _spellings(text: str) -> Iterator[Key]:
    """Yield the key of a phrase as it is, then in the singular."""
    yield runs(text)
    last = text.rsplit(maxsplit=1)[-1]  # a label `S` behind a name is no plural
    for ending, instead in (("s", ""), ("es", ""), ("ies", "y")):
        if text.lower().endswith(ending) and len(last) > len(ending):
            yield runs(text[: -len(ending)] + instead)
    if _PLURAL.search(text):
        yield runs(_PLURAL.sub("", text))
