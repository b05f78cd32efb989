# SPDX-License-Identifier: Apache-2.0
"""Signed updates beside unsigned twins: a defense that refuses every change fails here."""

from __future__ import annotations

from missionpair.pair import Suite
from missionpair.suites._making import Cell, Makers, PairMaker, suite_of
from missionpair.words import Channel

VERSION = 2


def make() -> Suite:
    """Return the suite: one pair for each domain, category and family, on channels in turn."""
    makers = Makers()
    maker = PairMaker(makers, "updates")
    channels = tuple(Channel)
    found = dict.fromkeys((c.domain, c.category, c.family) for c in makers.cells())
    pairs = [
        maker.pair(Cell(*cell, channels[number % len(channels)]), 1)
        for number, cell in enumerate(found)
    ]
    return suite_of("updates", VERSION, makers, pairs)
