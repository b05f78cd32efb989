# SPDX-License-Identifier: Apache-2.0
"""What stands in a clause without a phrase: quantities, counts, details, and mere fillers.

A reader takes a term whole or leaves it; what is left becomes a question.
"""

from __future__ import annotations

from authguard_r.authoring.drafting import frames
from authguard_r.authoring.drafting.clauses import Clause
from authguard_r.authoring.drafting.cursor import Cursor
from authguard_r.authoring.drafting.frames import VerbFrame
from authguard_r.authoring.drafting.measures import read_measure, read_number

_MARKS = frozenset("\"'\u201c\u201d\u2018\u2019()")
_PUTS = frozenset({VerbFrame.PUT, VerbFrame.DELIVER})


def take_amount(here: Cursor, clause: Clause) -> bool:
    """Take `at 0.8 m/s`, `for at most 30 s`, or a number whose unit is missing."""
    for words, meant in (*frames.BOUNDS, ((), "")):
        if not here.starts(words):
            continue
        place = here.at + len(words)
        measure = read_measure(here.tokens, place)
        if measure is not None and measure.dimension not in clause.measures:
            clause.measures[measure.dimension] = measure
            here.at = place + measure.size
            return True
        number = read_number(here.tokens, place)
        if number is not None and meant and not _counted(here, place + number[1]):
            clause.bare.append((meant, number[0]))
            here.at = place + number[1]
            return True
    return False


def take_count(here: Cursor, clause: Clause) -> bool:
    """Take `twice` or `three times`; one count only."""
    if clause.repeat:
        return False
    number = read_number(here.tokens, here.at)
    if here.low() in frames.COUNTS:
        repeat, size = frames.COUNTS[here.low()], 1
    elif number and number[0].isdigit() and _counted(here, here.at + number[1]):
        repeat, size = int(number[0]), number[1] + 1
    else:
        return False
    clause.repeat = repeat
    here.at += size if repeat else 0
    return repeat > 0


def take_details(here: Cursor, clause: Clause, liquids: frozenset[str]) -> bool:
    """Take `filled with water` (filled first, by the same clause) or `with the door left open`."""
    if clause.frame not in _PUTS:
        return False
    filled = clause.liquid is None and here.starts(("filled", "with"))
    if filled and here.low(2) in liquids:
        clause.liquid = here.low(2)
        here.at += 3
        return True
    size = here.first(frames.LEFT_OPEN)
    if size:
        clause.extras.add(frames.STAYS_OPEN)
        here.at += size
    return size > 0


def is_filler(here: Cursor, *, fresh: bool, behind: int) -> bool:
    """True for quotation marks, and for a filler where it can be no label: `package A`.

    A determiner has its noun behind it, has no noun right before it, and has no capital within a
    sentence.

    Args:
        here: at the word.
        fresh: a clause could begin here.
        behind: the place right behind the last noun.
    """
    word = here.low()
    if word in _MARKS or word not in frames.FILLERS:
        return word in _MARKS
    if not fresh and here.tokens[here.at].text != word:
        return False
    if word not in frames.DETERMINERS:
        return True
    after = here.low(1)
    ends = not after or after in frames.BOUNDARIES or after in frames.ROLES
    return behind != here.at and (not ends or word == "robot")


def _counted(here: Cursor, place: int) -> bool:
    return place < len(here.tokens) and here.tokens[place].low in {"times", "time"}
