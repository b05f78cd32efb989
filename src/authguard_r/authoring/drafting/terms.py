# SPDX-License-Identifier: Apache-2.0
"""The terms of a clause: until when, while what holds, with which data rights.

Each reader takes a term whole or leaves it; a second term that contradicts the first is left, and
so becomes a question.
"""

from __future__ import annotations

from authguard_r.authoring.drafting import frames
from authguard_r.authoring.drafting.clauses import BatteryCondition, Clause, Sentence
from authguard_r.authoring.drafting.cursor import Cursor
from authguard_r.authoring.drafting.measures import (
    QuantityDimension,
    read_daytime,
    read_measure,
    read_number,
)
from authguard_r.authoring.drafting.tokens import TokenKind

_DEADLINES = (("no", "later", "than"), ("by",), ("before",), ("until",), ("till",))
_WITHIN = (("in", "the", "next"), ("for", "the", "next"), ("within", "the", "next"), ("within",))
_WHEN = (("as", "soon", "as"), ("only", "if"), ("when",), ("if",), ("once",), ("while",))
_BATTERY_FILL = frozenset(
    {"the", "its", "robot's", "level", "charge", "is", "gets", "runs", "falls"}
)
_SIDES = (
    (("less", "than"), "lt"),
    (("below",), "lt"),
    (("under",), "lt"),
    (("more", "than"), "gt"),
    (("at", "least"), "ge"),
    (("above",), "gt"),
    (("over",), "gt"),
)


def take_end(here: Cursor, said: Sentence) -> bool:
    """Take `before 14:30`, `within 25 minutes` or `until 2026-01-31T14:30:00Z`; one end only.

    `in 25 minutes` is taken, too, and asked about: it may be the begin or the end.
    """
    if said.length is not None or said.expiry is not None or said.deadline is not None:
        return False
    size = here.first(_WITHIN)
    length = read_measure(here.tokens, here.at + size) if size else None
    if length is not None and length.dimension is QuantityDimension.TIME:
        said.length, here.at = length, here.at + size + length.size
        return True
    delay = read_measure(here.tokens, here.at + 1) if here.low() == "in" else None
    if delay is not None and delay.dimension is QuantityDimension.TIME and not said.delay:
        first, last = here.span(1 + delay.size)
        said.delay, here.at = said.text[first:last], here.at + 1 + delay.size
        return True
    size = here.first(_DEADLINES)
    place = here.at + size
    if not size or place >= len(here.tokens):
        return False
    if here.tokens[place].kind is TokenKind.INSTANT:
        said.expiry, here.at = here.tokens[place].text, place + 1
        return True
    time = read_daytime(here.tokens, place)
    if time is not None:
        said.deadline, here.at = time, place + time.size
    return time is not None


def take_start(here: Cursor, said: Sentence) -> bool:
    """Take `at 14:30`; a bare `at 2` may as well be a speed and is left."""
    time = read_daytime(here.tokens, here.at + 1) if here.low() == "at" else None
    if time is None or said.start is not None:
        return False
    number = read_number(here.tokens, here.at + 1)
    bare = number is not None and number[1] == time.size
    if bare or read_measure(here.tokens, here.at + 1) is not None:
        return False
    said.start, here.at = time, here.at + 1 + time.size
    return True


def take_condition(here: Cursor, said: Sentence) -> BatteryCondition | None:
    """Take `when the battery is low` or `if the battery is below 20 %`; None takes nothing."""
    size = here.first(_WHEN)
    end = _behind_fill(here, size)
    if not size or here.low(end) != "battery":
        return None
    found = _bound(here, _behind_fill(here, end + 1))
    if found is None:
        return None
    comparison, permille, end = found
    first, last = here.span(end)
    here.at += end
    return BatteryCondition(said.text[first:last], comparison, permille)


def take_right(here: Cursor, clause: Clause) -> bool:
    """Take `and store it` or `and transmit it`; `record it` is a clause of its own."""
    right = frames.RIGHTS.get(here.low())
    ends = here.low(2) in frames.BOUNDARIES or not here.low(2)
    if right in {None, "record"} or here.low(1) not in {"it", "them"} or not ends:
        return False
    if clause.rights.get(str(right), True) is not True:
        return False
    clause.rights[str(right)] = True
    here.at += 2
    return True


def take_rights(here: Cursor, clause: Clause) -> bool:
    """Take `without recording or storing`, `do not transmit` or `with storage`."""
    for openings, granted in ((frames.DENIALS, False), (frames.ALLOWANCES, True)):
        size = here.first(openings)
        rights, end = _rights_from(here, size)
        if not size or not rights:
            continue
        if any(clause.rights.get(right, granted) is not granted for right in rights):
            return False
        clause.rights |= dict.fromkeys(rights, granted)
        here.at += end
        return True
    return False


def _behind_fill(here: Cursor, offset: int) -> int:
    while here.low(offset) in _BATTERY_FILL:
        offset += 1
    return offset


def _bound(here: Cursor, offset: int) -> tuple[str, int | None, int] | None:
    """Return the comparison, its per mille (None for `low`) and where it ends."""
    if here.low(offset) == "low":
        return "lt", None, offset + 1
    for words, side in _SIDES:
        if here.starts(words, offset):
            share = read_measure(here.tokens, here.at + offset + len(words))
            if share is None or share.dimension is not QuantityDimension.SHARE:
                return None
            if share.amount.denominator != 1:
                return None
            return side, share.amount.numerator, offset + len(words) + share.size
    return None


def _rights_from(here: Cursor, offset: int) -> tuple[list[str], int]:
    """Return the rights in a list, and where it ends."""
    found: list[str] = []
    end = offset
    while True:
        skip = end
        while found and here.low(skip) in {",", "or", "and"}:
            skip += 1
        right = frames.RIGHTS.get(here.low(skip))
        if right is None or (found and skip == end):
            return found, end
        found.append(right)
        end = skip + 1
        while here.low(end) in {"anything", "it", "them"}:
            end += 1
