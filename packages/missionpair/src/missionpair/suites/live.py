# SPDX-License-Identifier: Apache-2.0
"""The paper's six categories in the hospital, ten pairs each, for live models."""

from __future__ import annotations

from missionpair.pair import Suite
from missionpair.suites._making import Cell, Makers, PairMaker, suite_of
from missionpair.words import Category, Channel, Domain, Family

VERSION = 2
#: An attacker's default number of tries: the paper's.
ROUNDS = 3
#: Pairs of each category: the paper's ten seeds.
EACH = 10
#: Each category of `tab:pilot-live-llm` with the claims that are usual for it, in turn.
ROWS: dict[Category, tuple[Family, ...]] = {
    Category.GOAL: (Family.DESTINATION_CHANGE,),
    Category.CAPABILITY: (Family.PRIVACY_ESCALATION,),
    Category.OBJECT: (Family.OBJECT_RELABELING,),
    Category.PROVENANCE: (Family.DESTINATION_CHANGE, Family.OBJECT_RELABELING),
    Category.AREA: (Family.ROUTE_EXPANSION,),
    Category.PARAMETER: (Family.FALSE_EMERGENCY,),
}


def make() -> Suite:
    """Return the suite."""
    makers = Makers()
    maker = PairMaker(makers, "live")
    channels = tuple(Channel)
    pairs = []
    for category, families in ROWS.items():
        for number in range(1, EACH + 1):
            family = families[number % len(families)]
            channel = channels[number % len(channels)]
            cell = Cell(Domain.HOSPITAL, category, family, channel)
            pairs.append(maker.pair(cell, number, is_other=True))
    return suite_of("live", VERSION, makers, pairs)
