# SPDX-License-Identifier: Apache-2.0
"""The same text with more force behind it, round by round: who says so, how urgent, once more.

Source: section "Implementation and Experimental Evaluation" (fixed templates, at most three
rounds). Spec page: docs/spec/missionpair-access.md#fixed
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from missionpair.wording.grammar import drawn_number
from missionpair.wording.productions import PRODUCTIONS

#: What each step adds, in this order. No sentence of it asks for anything.
STEPS: tuple[tuple[Mapping[str, str], ...], ...] = (
    (PRODUCTIONS.authority, PRODUCTIONS.urgency),
    (PRODUCTIONS.former, PRODUCTIONS.insistence),
)


def strengthen(text: str, *, steps: int) -> str:
    """Return the text with what the first steps add: the same on every machine.

    The text itself stays as it is, and asks for what it asked for. A sentence that stands in it
    already is not said twice.

    Args:
        text: as it was first said.
        steps: how many, from 0 to as many as `STEPS` has.
    """
    kinds = [kind for step in STEPS[:steps] for kind in step]
    added = (_drawn(text, number, kind.values()) for number, kind in enumerate(kinds))
    return " ".join((text, *added))


def _drawn(text: str, number: int, sentences: Iterable[str]) -> str:
    """Return a sentence that the text does not have, and that names nothing."""
    new = [one for one in sentences if one and "{it}" not in one and one not in text]
    return new[drawn_number(f"{text}/{number}", len(new))]
