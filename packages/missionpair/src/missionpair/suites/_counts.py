# SPDX-License-Identifier: Apache-2.0
"""How varied a suite is: its texts, its different sentences, and how long its plans are."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from functools import lru_cache
from typing import Any

from missionpair.pair import Layout, Pair, Suite

_ENDS = re.compile(r"(?<=[.!?])\s+|\n")
_NUMBER = re.compile(r"\d+(?:\.\d+)?")


def variety_of(suite: Suite) -> dict[str, Any]:
    """Return counts: texts, different sentences without names and numbers, plans by their steps."""
    sentences = sentences_of(suite)
    plans = Counter(len(pair.attack.plan) for pair in suite.pairs)
    return {
        "texts": sum(len(pair.inputs) for pair in suite.pairs),
        "sentences": len(sentences),
        "plans": {str(length): plans[length] for length in sorted(plans)},
    }


def perceived_of(suite: Suite) -> dict[str, dict[str, list[int]]]:
    """Return texts, their words and the wrong ones, by channel and by how a text was perceived."""
    counts: dict[str, dict[str, list[int]]] = {}
    for pair in suite.pairs:
        for record in pair.perceived:
            mine = counts.setdefault(str(pair.channels[record.input]), {})
            for how in ("all", *record.how):
                held = mine.setdefault(how, [0, 0, 0])
                for place, more in enumerate((1, record.words, record.wrong)):
                    held[place] += more
    return {channel: dict(sorted(counts[channel].items())) for channel in sorted(counts)}


def sentences_of(suite: Suite) -> Counter[str]:
    """Return how often each sentence comes in a suite, without its names and numbers."""
    counts: Counter[str] = Counter()
    for pair in suite.pairs:
        counts.update(_sentences(pair, _names(suite.layouts[pair.layout])))
    return counts


def _sentences(pair: Pair, names: re.Pattern[str]) -> Iterator[str]:
    for item in pair.inputs:
        bare = _NUMBER.sub("#", names.sub("NAME", item.text))
        yield from filter(None, _ENDS.split(bare))


@lru_cache(maxsize=512)
def _pattern(names: tuple[str, ...]) -> re.Pattern[str]:
    longest = sorted(names, key=lambda name: (-len(name), name))
    return re.compile("|".join(map(re.escape, longest)), re.IGNORECASE)


def _names(layout: Layout) -> re.Pattern[str]:
    site = layout.site
    models = (*site["regions"].values(), *site["objects"].values())
    return _pattern((*site["robots"], *(name for model in models for name in model["names"])))
