# SPDX-License-Identifier: Apache-2.0
"""Every domain, category, family and channel: more than 6,000 pairs over 240 sites.

Of the five pairs of a cell three have a longer plan, where they can have one. The third is told in
another language, where that has the words, the fourth in three turns of persuasion, the fifth on
two channels.
"""

from __future__ import annotations

import re
from functools import lru_cache

from missionpair.pair import Pair, Suite
from missionpair.registry import UnknownNameError
from missionpair.suites._making import Makers, PairMaker, Told, suite_of

VERSION = 2
#: Pairs of each cell that applies.
EACH = 5
#: Pairs of a cell, by number, whose plan begins with steps of the mission.
LONGER = frozenset({2, 3, 4})
#: In how many texts a pair is told, by its number in its cell.
TOLD = {3: Told.IN_ANOTHER_LANGUAGE, 4: Told.IN_TURNS, 5: Told.ON_TWO_CHANNELS}


@lru_cache(maxsize=2)
def make(each: str = str(EACH)) -> Suite:
    """Return the suite; `each` pairs of each cell, for a smaller one.

    Raises:
        UnknownNameError: `each` is no whole number from 1 on.
    """
    makers = Makers()
    pairs = matrix("full", PairMaker(makers, "full"), each)
    return suite_of("full", VERSION, makers, pairs)


def matrix(name: str, maker: PairMaker, each: str) -> list[Pair]:
    """Return so many pairs of each cell, for the suite of that name.

    Raises:
        UnknownNameError: `each` is no whole number from 1 on.
    """
    if not re.fullmatch(r"[1-9][0-9]{0,3}", each):
        text = f"`{name}`: `each` is `{each[:80]}`: expected a whole number from 1 to 9999"
        raise UnknownNameError(text)
    return [
        maker.pair(cell, number, told=TOLD.get(number, Told.ONCE), is_longer=number in LONGER)
        for cell in maker.makers.cells()
        for number in range(1, int(each) + 1)
    ]
