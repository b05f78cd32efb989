# SPDX-License-Identifier: Apache-2.0
"""A text that asks for nothing, as long as another one: what the control arm puts in its place.

Spec page: docs/spec/measures.md#control
"""

from __future__ import annotations

from functools import lru_cache
from importlib.resources import files
from random import Random

import msgspec

from missionpair.words import Channel

#: Sentences by channel, as `neutral.toml` holds them.
SENTENCES = msgspec.toml.decode(
    files("missionpair.wording").joinpath("neutral.toml").read_bytes(),
    type=dict[Channel, tuple[str, ...]],
)
#: The same by language; there every channel has the same sentences.
FOREIGN = msgspec.toml.decode(
    files("missionpair.wording").joinpath("neutral_foreign.toml").read_bytes(),
    type=dict[str, tuple[str, ...]],
)
#: Characters for which a sum of sentences is looked for exactly; what comes before is drawn.
_EXACT = 400


@lru_cache(maxsize=8192)
def neutral(channel: Channel, length: int, *, seed: int, language: str = "") -> str:
    """Return a text of a channel that asks for nothing and is as long as asked for.

    Where no sentences add up to that, it is the nearest length to which some do.

    Args:
        channel: where it stands.
        length: characters, at least 1.
        seed: draws the sentences.
        language: one of `FOREIGN`; empty for English.
    """
    random = Random(f"{seed}/{channel}/{length}")  # noqa: S311 - a wording, no secret
    sentences = FOREIGN[language] if language else SENTENCES[channel]
    taken: list[str] = []
    left = length + 1  # each sentence brings the space behind it
    drawn = random.sample(sentences, len(sentences))
    while left > _EXACT:
        if not drawn:
            drawn = random.sample(sentences, len(sentences))
        taken.append(drawn.pop())
        left -= len(taken[-1]) + 1
    rest = [one for one in sentences if one not in taken[-3:]]
    return " ".join((*taken, *_summing(random.sample(rest, len(rest)), left)))


def _summing(sentences: list[str], wanted: int) -> list[str]:
    """Return sentences whose lengths, with a space each, come nearest to a sum."""
    ways: dict[int, tuple[int, str]] = {}
    for sentence in sentences:
        for total in sorted({0, *ways}, reverse=True):
            more = total + len(sentence) + 1
            if more not in ways and more <= 2 * wanted:
                ways[more] = (total, sentence)
    found: list[str] = []
    total = min(ways, key=lambda one: (abs(one - wanted), one), default=0)
    while total:
        total, sentence = ways[total]
        found.append(sentence)
    return found
