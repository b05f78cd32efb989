# SPDX-License-Identifier: Apache-2.0
"""Every domain, category, family and channel: more than 6,000 pairs over 240 sites."""

from __future__ import annotations

import re

from missionpair.pair import Suite
from missionpair.registry import UnknownNameError
from missionpair.suites._making import Makers, PairMaker, suite_of

VERSION = 1
#: Pairs of each cell that applies; the last one of each comes on two channels.
EACH = 5


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
        maker.pair(cell, number, second=number == EACH)
        for cell in makers.cells()
        for number in range(1, count + 1)
    ]
    return suite_of("full", VERSION, makers, pairs)
