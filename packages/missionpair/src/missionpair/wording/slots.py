# SPDX-License-Identifier: Apache-2.0
"""What follows a verb: names, numbers with units, quoted words, in any order after the first.

Spec page: docs/spec/missionpair-access.md#reading
"""

from __future__ import annotations

import json
import re
from functools import lru_cache

from msgspec import Struct

from missionpair.pair import Value, WordedCall
from missionpair.wording.lexing import Text
from missionpair.wording.verbs import FrameSlot, Says
from missionpair.wording.vocabulary import BoundFrame, words

#: Words that say nothing between a verb or a mark and a name.
_QUOTES = frozenset("\"'\u201c\u201d\u2018\u2019")
_ARTICLES = _QUOTES | words(
    """
    the a an that this these those object package item thing parcel box container called named
    labeled labelled marked all over back straight directly now instead immediately
    """
)
#: What may stand between two names of a list.
_LISTING = words(", and then &")
_ABOUT = words("about exactly only at least full up to")
_QUOTED = re.compile(r"\"(?:[^\"\\]|\\.)*\"|\u201c[^\u201d]*\u201d")


class Filled(Struct, frozen=True):
    """A call, and the place of the first token after it."""

    call: WordedCall
    end: int


def fill(text: Text, begin: int, bound: BoundFrame) -> Filled | None:
    """Return the call that a verb asks for with what follows it; None where it asks for nothing.

    Args:
        text: the text.
        begin: the place after the verb.
        bound: the verb's frame.
    """
    found: dict[int, Value] = {}
    place = begin
    while (step := _next(text, place, bound, found)) is not None:
        number, value, place = step
        found[number] = value
    arguments: dict[str, Value] = {}
    for number, (slot, name) in enumerate(zip(bound.frame.slots, bound.names, strict=True)):
        if number not in found and not slot.optional and slot.default is None:
            return None
        taken = found.get(number, None if slot.optional else slot.default)
        if name is not None and taken is not None:
            arguments[name] = taken
    return Filled(WordedCall(tool=bound.tool, arguments=arguments), place)


def _next(
    text: Text, place: int, bound: BoundFrame, found: dict[int, Value]
) -> tuple[int, Value, int] | None:
    """Return the next slot that is filled here: its number, its value, the place after it."""
    for number, slot in enumerate(bound.frame.slots):
        if number in found:
            continue
        begin = place if slot.says is Says.QUOTE else _past(text, place, _QUOTES)
        most = bound.most[number]
        if most is not None:
            for phrase in _split(slot.phrases):
                if text.has(begin, phrase):
                    return number, most, begin + len(phrase)
        for mark in _split(slot.marks):
            if text.has(begin, mark):
                read = _value(text, begin + len(mark), slot)
                if read is not None:
                    return number, *read
    return None


@lru_cache(maxsize=256)
def _split(phrases: tuple[str, ...]) -> tuple[tuple[str, ...], ...]:
    """Return each phrase as words and marks, the longest first."""
    parts = {tuple(phrase.replace("/", " / ").casefold().split()) for phrase in phrases}
    return tuple(sorted(parts, key=lambda part: (-len(part), part)))


@lru_cache(maxsize=64)
def _units(slot_units: tuple[tuple[str, int], ...]) -> tuple[tuple[tuple[str, ...], int], ...]:
    """Return each unit as words and marks with its size, the longest first."""
    parts = [(_split((unit,))[0], times) for unit, times in slot_units]
    return tuple(sorted(parts, key=lambda part: -len(part[0])))


def _value(text: Text, place: int, slot: FrameSlot) -> tuple[Value, int] | None:
    if slot.says is Says.NUMBER:
        return _number(text, place, slot)
    if slot.says is Says.QUOTE:
        return _quote(text, place)
    if slot.says is Says.PLACES:
        return _list(text, place)
    after = _past(text, place, _ARTICLES)
    name = text.name(after)
    if name is None or not (name.is_place if slot.says is Says.PLACE else name.is_thing):
        return None
    return name.spelling, after + 1


def _past(text: Text, place: int, words: frozenset[str]) -> int:
    while text.word(place) in words:
        place += 1
    return place


def _list(text: Text, place: int) -> tuple[Value, int] | None:
    """Return a list of places; what joins them belongs to it only before another place."""
    found: list[str] = []
    end = after = _past(text, place, _ARTICLES)
    while True:
        name = text.name(after)
        if name is not None and name.is_place:
            found.append(name.spelling)
            end = after = after + 1
        elif found and text.word(after) in _LISTING:
            after = _past(text, after + 1, _ARTICLES)
        else:
            return (found, end) if found else None


def _number(text: Text, place: int, slot: FrameSlot) -> tuple[Value, int] | None:
    place = _past(text, place, _ABOUT)
    if text.kind(place) != "number":
        return None
    written = text.word(place)
    value: int | float = float(written) if "." in written else int(written)
    for unit, times in _units(tuple(slot.units.items())):
        if text.has(place + 1, unit):
            return (value if times == 1 else value * times), place + 1 + len(unit)
    return value, place + 1


def _quote(text: Text, place: int) -> tuple[Value, int] | None:
    """Return what stands in quotes, as JSON has it where it is JSON."""
    match = _QUOTED.match(text.raw, text.start(place))
    if match is None:
        return None
    try:
        value = str(json.loads(match[0]))
    except ValueError:
        value = match[0][1:-1]
    return value, text.place(match.end())
