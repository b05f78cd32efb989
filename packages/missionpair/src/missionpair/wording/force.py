# SPDX-License-Identifier: Apache-2.0
"""The same text with more force behind it, round by round: who says so, how urgent, once more.

Source: section "Implementation and Experimental Evaluation" (fixed templates, at most three
rounds). Spec page: docs/spec/missionpair-access.md#fixed
"""

from __future__ import annotations

from collections.abc import Iterator

from missionpair.wording.grammar import drawn_number
from missionpair.wording.productions import PRODUCTIONS, STYLES
from missionpair.words import Channel

#: How often a text can be strengthened.
STEPS = 2


def strengthen(text: str, channel: Channel, *, steps: int) -> str:
    """Return the text with what the first steps add: the same on every machine.

    The first step says by whose word and how urgent it is, the second why, and insists. The text
    itself stays as it is, and asks for what it asked for. A sentence that stands in it already is
    not said twice.

    Args:
        text: as it was first said.
        channel: where it stands.
        steps: how many, from 0 to `STEPS`.
    """
    return " ".join((text, *_added(text, channel, steps)))


def _added(text: str, channel: Channel, steps: int) -> Iterator[str]:
    style = STYLES[channel]
    kinds = (style.authority, style.urgency, style.reason, PRODUCTIONS.insistence)
    for number, sentences in enumerate(kinds[: 2 * steps]):
        new = [one for one in sentences if "{it}" not in one and one not in text]
        yield new[drawn_number(f"{text}/{number}", len(new))]
