# SPDX-License-Identifier: Apache-2.0
"""Every domain, category, family and channel: more than 6,000 pairs over 240 sites."""

from __future__ import annotations

from missionpair.pair import Suite
from missionpair.suites._making import Maker, Makers, suite_of

VERSION = 1
#: Pairs of each cell that applies; the last one of each comes on two channels.
EACH = 5


def make(each: str = str(EACH)) -> Suite:
    """Return the suite; `each` pairs of each cell, for a smaller one."""
    makers = Makers()
    maker = Maker(makers, "full")
    count = int(each)
    pairs = [
        maker.pair(cell, number, second=number == EACH)
        for cell in makers.cells()
        for number in range(1, count + 1)
    ]
    return suite_of("full", VERSION, makers, pairs)
