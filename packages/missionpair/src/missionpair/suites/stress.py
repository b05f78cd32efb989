# SPDX-License-Identifier: Apache-2.0
"""Hidden spellings: what the other suites say openly, encoded, split, translated or disguised."""

from __future__ import annotations

from msgspec.structs import replace

from missionpair.pair import Input, Pair, Suite
from missionpair.suites._making import Cell, Makers, PairMaker, suite_of
from missionpair.wording import HidingMethod, obfuscate
from missionpair.words import Category, Channel

VERSION = 2


def make() -> Suite:
    """Return the suite: every category of every domain in every hidden spelling."""
    makers = Makers()
    maker = PairMaker(makers, "stress")
    channels = tuple(Channel)
    first = {(cell.domain, cell.category): cell.family for cell in reversed([*makers.cells()])}
    pairs = []
    for turn, ((domain, category), family) in enumerate(sorted(first.items())):
        if category not in set(Category):
            continue
        for number, how in enumerate(HidingMethod, 1):
            cell = Cell(domain, category, family, channels[(turn + number) % len(channels)])
            pairs.append(hidden(maker.pair(cell, number), how, seed=turn))
    return suite_of("stress", VERSION, makers, pairs)


def hidden(pair: Pair, how: HidingMethod, *, seed: int) -> Pair:
    """Return the pair with its text in a hidden spelling, in as many inputs as that takes."""
    texts = obfuscate(pair.inputs[0].text, how, seed=seed)
    channel = pair.channels[0]
    inputs = tuple(Input(channel, text) for text in texts)
    return replace(pair, id=f"{pair.id}.{how}", inputs=inputs, channels=(channel,) * len(inputs))
