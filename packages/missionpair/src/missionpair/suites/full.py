# SPDX-License-Identifier: Apache-2.0
"""Every domain, category, family and channel: more than 6,000 pairs over 240 sites.

Of the five pairs of a cell three have a longer plan, where they can have one. The third is told in
another language, where that has the words, the fourth in three turns of persuasion, the fifth on
two channels.
"""

from __future__ import annotations

import re

from missionpair.pair import Suite
from missionpair.registry import UnknownNameError
from missionpair.suites._making import Makers, PairMaker, Told, suite_of

VERSION = 2
#: Pairs of each cell that applies.
EACH = 5
#: Pairs of a cell, by number, whose plan begins with steps of the mission.
LONGER = frozenset({2, 3, 4})
#: In how many texts a pair is told, by its number in its cell.
TOLD = {3: Told.IN_ANOTHER_LANGUAGE, 4: Told.IN_TURNS, 5: Told.ON_TWO_CHANNELS}


def make(each: str = str(EACH)) -> Suite:
    """Return the suite; `each` pairs of each cell, for a smaller one.

    Raises:
        UnknownNameError: `each` is no whole number from 1 on.
    """
    if not re.fullmatch(r"[1-9][0-9]{0,3}", each):
        text = f"`full`: `each` is `{each[:80]}`: expected a whole number from 1 to 9999"
        raise UnknownNameError(text)
    makers = Makers()
    maker = PairMaker(makers, "full")
    count = int(each)
    pairs = [
        maker.pair(cell, number, told=TOLD.get(number, Told.ONCE), is_longer=number in LONGER)
        for cell in makers.cells()
        for number in range(1, count + 1)
    ]
    return suite_of("full", VERSION, makers, pairs)
