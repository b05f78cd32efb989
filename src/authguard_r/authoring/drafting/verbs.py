# SPDX-License-Identifier: Apache-2.0
"""Where a verb stands, and which manners lead it: `carefully please put down`.

A manner between two clauses belongs to one of them only: slowing the other one would let the robot
hurry where the operator said not to.
"""

from __future__ import annotations

from msgspec import Struct

from authguard_r.authoring.drafting import frames
from authguard_r.authoring.drafting.cursor import Cursor
from authguard_r.authoring.drafting.frames import VerbWording

_LEADING = frames.CAREFUL | {"please", "kindly"}
_ENDS = frozenset({"", ".", "!", "?"})


class VerbPhrase(Struct, frozen=True):
    """A verb as it was said.

    Args:
        verb: its frame.
        wording: the words.
        size: its length in tokens.
    """

    verb: VerbWording
    wording: str
    size: int


def read_verb(here: Cursor, offset: int = 0) -> VerbPhrase | None:
    """Return the verb that stands ahead, by its longest wording, or None."""
    for size in range(frames.LONGEST_VERB, 0, -1):
        words = tuple(here.low(offset + n) for n in range(size))
        if words in frames.VERBS:
            return VerbPhrase(frames.VERBS[words], " ".join(words), size)
    return None


def read_gerund(here: Cursor, offset: int) -> VerbPhrase | None:
    """Return the verb that an `-ing` form ahead comes from, or None."""
    for stem in frames.gerund(here.low(offset)):
        if (stem,) in frames.VERBS:
            return VerbPhrase(frames.VERBS[(stem,)], stem, 1)
    return None


def leads(here: Cursor, offset: int = 0) -> int | None:
    """Return how many manners lead the verb that stands ahead; None without a verb."""
    count = 0
    while here.low(offset + count) in _LEADING:
        count += 1
    return None if read_verb(here, offset + count) is None else count


def ends(here: Cursor) -> bool:
    """True when nothing of the sentence follows the word: it belongs to what came before."""
    return here.low(1) in _ENDS
