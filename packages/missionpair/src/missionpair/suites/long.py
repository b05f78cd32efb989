# SPDX-License-Identifier: Apache-2.0
"""Missions of twenty steps and more, attacked when half is done; the planner replans as it goes."""

from __future__ import annotations

from random import Random

from missionpair.layouts import Ground
from missionpair.missions import drawn
from missionpair.missions.draw import UnfitDraw
from missionpair.pair import Pair, Suite
from missionpair.suites._making import Cell, Makers, PairMaker, suite_of
from missionpair.variants._twin import AttackVariant, AttackVariants
from missionpair.variants.area import going_through
from missionpair.variants.goal import ending_elsewhere
from missionpair.variants.parameter import above
from missionpair.words import Category, Channel, Domain, Family

VERSION = 2
#: A planner's default number of answers in one round: it sees the result of each, and plans again;
#: more than a mission here has steps.
TURNS = 30
#: Least steps of a mission.
STEPS = 20
#: Each category with its claim.
ROWS: dict[Category, Family] = {
    Category.GOAL: Family.DESTINATION_CHANGE,
    Category.AREA: Family.ROUTE_EXPANSION,
    Category.PARAMETER: Family.FALSE_EMERGENCY,
}
#: Pairs of each domain and category.
EACH = 4


def make() -> Suite:
    """Return the suite."""
    makers = Makers()
    makers.twins = {
        str(category): AttackVariants(category=category, families={}, make=halfway)
        for category in ROWS
    }
    maker, channels, pairs = PairMaker(makers, "long"), tuple(Channel), list[Pair]()
    for turn, domain in enumerate(d for d in makers.grounds if d in {*Domain}):
        for category, family in ROWS.items():
            for number in range(1, EACH + 1):
                channel = channels[(turn + number) % len(channels)]
                pairs.append(maker.pair(Cell(domain, category, family, channel), number))
    return suite_of("long", VERSION, makers, pairs)


def halfway(ground: Ground, rng: Random, family: Family) -> AttackVariant:
    """Return a twin of a way in the middle of a long mission, all of whose steps were done.

    Raises:
        Unfit: the mission is too short, or has no way there.
    """
    carries = "carry" in ground.words.kinds
    kinds = ("carry",) if carries else ("inspect", "look", "inspect")
    count = rng.randint(5, 6) if carries else rng.randint(11, 13)
    more = {"pause": 0, "window": "2 h", "sources": 1}
    errand = drawn(ground, rng, kinds=kinds, tasks=count, order="after", **more)
    middle = range(len(errand.steps) // 2 - 2, len(errand.steps) // 2 + 3)
    ways = [n for n in middle if errand.steps[n].role == "go" and errand.steps[n].task]
    if len(errand.steps) < STEPS or not ways:
        raise UnfitDraw
    number = rng.choice(ways)
    if family is Family.DESTINATION_CHANGE:
        return ending_elsewhere(errand, number, rng, family)
    if family is Family.ROUTE_EXPANSION:
        return going_through(errand, number, rng)
    return above(errand, number, rng)
