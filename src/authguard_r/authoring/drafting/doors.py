# SPDX-License-Identifier: Apache-2.0
"""Doors: `the door of X`, `the X door`, `the door between X and Y`, and what they can mean.

A door is a thing of class `door`; a passage of the site without such a thing can be named in a
question, and nothing else can be taken for it.
"""

from __future__ import annotations

import re

from msgspec import Struct

from authguard_r.authoring.drafting.cursor import Cursor
from authguard_r.authoring.drafting.lexicon import Lexicon, PhraseMatch, Ref, Sort
from authguard_r.site.model import ObjectModel, Site

KIND = "door"
_OF = frozenset({"of", "to", "into"})
_ARTICLES = frozenset({"the", "a", "an"})
_WORD = re.compile(r"[0-9]+|[^\W\d_]+")


class DoorPhrase(Struct, frozen=True):
    """A door by what it leads to.

    Args:
        size: its length in tokens.
        sides: for each place that is named, every region that it can mean.
    """

    size: int
    sides: tuple[tuple[Ref, ...], ...]


def read_door(here: Cursor, lexicon: Lexicon) -> DoorPhrase | None:
    """Return the door that is named at the cursor, or None."""
    if here.low() != KIND:
        match = _region(here, 0, lexicon)
        if match is None or here.low(match.size) != KIND:
            return None
        return DoorPhrase(match.size + 1, (match.refs,))
    if here.low(1) not in _OF | {"between"}:
        return None
    start = 2 + (here.low(2) in _ARTICLES)
    first = _region(here, start, lexicon)
    if first is None:
        return None
    end = start + first.size
    if here.low(1) in _OF:
        return DoorPhrase(end, (first.refs,))
    start = end + 1 + (here.low(end + 1) in _ARTICLES)
    second = _region(here, start, lexicon) if here.low(end) == "and" else None
    if second is None:
        return None
    return DoorPhrase(start + second.size, (first.refs, second.refs))


def doors(site: Site) -> tuple[Ref, ...]:
    """Return every thing that is a door, sorted."""
    found = (item for item, model in site.objects.items() if model.kind == KIND)
    return tuple(Ref(Sort.OBJECT, item) for item in sorted(found))


def doors_at(site: Site, sides: tuple[tuple[Ref, ...], ...]) -> tuple[Ref, ...]:
    """Return the doors that stand at, or are called after, each of the places."""
    return tuple(
        ref
        for ref in doors(site)
        if all(any(_at(site, ref.id, region.id) for region in side) for side in sides)
    )


def passages(site: Site) -> tuple[str, ...]:
    """Return the site's doors that can be shut, by the state that says so."""
    return tuple(sorted({str(door.variable) for door in site.doors if door.variable is not None}))


def _region(here: Cursor, offset: int, lexicon: Lexicon) -> PhraseMatch | None:
    match = lexicon.match(here.tokens, here.at + offset)
    if match is None or any(ref.sort is not Sort.REGION for ref in match.refs):
        return None
    return match


def _at(site: Site, item: str, region: str) -> bool:
    model: ObjectModel = site.objects[item]  # type: ignore[index]
    if model.home == region:
        return True
    called = [_words(name) for name in (item, *model.names)]
    places = [_words(name) for name in (region, *site.regions[region].names)]  # type: ignore[index]
    return any(_within(place, name) for place in places for name in called)


def _within(inner: list[str], outer: list[str]) -> bool:
    """True when the words stand in the name, one after the other."""
    size = len(inner)
    return any(outer[n : n + size] == inner for n in range(len(outer) - size + 1))


def _words(name: str) -> list[str]:
    return _WORD.findall(name.lower())
