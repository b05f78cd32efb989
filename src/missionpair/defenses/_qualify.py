# SPDX-License-Identifier: Apache-2.0
"""What a defense shows before it is scored: nobody's work is stopped, its own kind of attack is.

A defense that cannot do its own job says nothing about others when it fails at theirs. What is
tried is the same that a campaign tries: the pair's own plans, in the pair's own situations.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from msgspec import Struct

from missionpair.carrying import Carried
from missionpair.defenses import Defense
from missionpair.defenses._outside import outside
from missionpair.pair import Layout, Pair, Scenario, Suite, plan_bytes
from missionpair.stage import Stage, Yard

#: Who refuses when a defense has not: nobody, whoever reads a plan, and physics.
_NOT_A_DEFENSE = frozenset({"", "normalizer", "world"})


class Unfit(Struct, frozen=True, kw_only=True):
    """Something that a defense failed.

    Args:
        defense: its name.
        pair: where; empty where it is about the suite.
        what: `benign`, `attack` or `proof`.
        why: what happened, for people.
    """

    defense: str
    pair: str
    what: str
    why: str

    def __str__(self) -> str:
        return f"{self.defense} failed ({self.what}) {self.pair}: {self.why}".replace(" :", ":")


def qualify(defense: Defense, suite: Suite, yard: Yard) -> tuple[Unfit, ...]:
    """Return what a defense failed; nothing when it may be scored.

    Args:
        defense: it is tried as it is, or as its claim's `fit` makes it.
        suite: what it is tried with; `slice_of` makes a small one of a large one.
        yard: where situations are made.

    Raises:
        StageError: a pair cannot be made real.
        DefenseError: the defense cannot do anything with a pair at all.
    """
    tried = defense if defense.claim.fit is None else defense.claim.fit()
    return tuple(_failures(tried, suite, yard))


def slice_of(suite: Suite, defenses: Iterable[Defense], *, most: int = 24) -> Suite:
    """Return a few pairs of a suite: for each defense of its own kind, from every domain.

    Args:
        suite: the whole.
        defenses: whose kinds are needed.
        most: pairs for each defense.
    """
    chosen: dict[str, Pair] = {}
    for defense in defenses:
        cells: dict[tuple[str, str], Pair] = {}
        for pair in suite.pairs:
            if defense.claim.covers(pair) or not defense.claim.blocks:
                cells.setdefault((pair.domain, pair.categories[0]), pair)
        chosen |= {pair.id: pair for pair in tuple(cells.values())[:most]}
    pairs = tuple(pair for pair in suite.pairs if pair.id in chosen)
    layouts = {pair.layout: suite.layouts[pair.layout] for pair in pairs}
    return Suite(name=suite.name, version=suite.version, layouts=layouts, pairs=pairs)


def _failures(defense: Defense, suite: Suite, yard: Yard) -> Iterator[Unfit]:
    own = 0
    for pair in suite.pairs:
        layout = suite.layouts[pair.layout]
        yield from _benign(defense, pair, layout, yard)
        if _is_own(defense, pair, layout, yard):
            own += 1
            yield from _attack(defense, pair, layout, yard)
        if defense.claim.proof is not None:
            defense.begin(seed=0)
            why = defense.claim.proof(defense, _stage(defense, pair, layout, pair.attack, yard))
            own += why is not None
            if why:
                yield Unfit(defense=defense.name, pair=pair.id, what="proof", why=why)
    if (defense.claim.blocks or defense.claim.proof is not None) and not own:
        why = "nothing of its own kind is here to be shown: give it a larger slice"
        yield Unfit(defense=defense.name, pair="", what="attack", why=why)


def _is_own(defense: Defense, pair: Pair, layout: Layout, yard: Yard) -> bool:
    """True when the pair's attack is what the defense says that it stops."""
    claim = defense.claim
    if not claim.covers(pair) or not claim.fields:
        return claim.covers(pair)
    return not claim.fields.isdisjoint(outside(_stage(defense, pair, layout, pair.attack, yard)))


def _benign(defense: Defense, pair: Pair, layout: Layout, yard: Yard) -> Iterator[Unfit]:
    carried = _carried(defense, pair, layout, pair.benign, yard)
    if not carried.completed:
        why = f"a benign run was stopped by {carried.by or 'nobody'}: {', '.join(carried.reasons)}"
        yield Unfit(defense=defense.name, pair=pair.id, what="benign", why=why)


def _attack(defense: Defense, pair: Pair, layout: Layout, yard: Yard) -> Iterator[Unfit]:
    carried = _carried(defense, pair, layout, pair.attack, yard)
    why = ""
    if not all(effect.authorized for effect in carried.effects):
        why = "an attack of its own kind was carried out"
    elif carried.by in _NOT_A_DEFENSE:
        why = f"it was not the defense that stopped an attack of its own kind, but `{carried.by}`"
    if why:
        yield Unfit(defense=defense.name, pair=pair.id, what="attack", why=why)


def _carried(
    defense: Defense, pair: Pair, layout: Layout, scenario: Scenario, yard: Yard
) -> Carried:
    stage = _stage(defense, pair, layout, scenario, yard)
    defense.begin(seed=0)
    return defense.carry_out(stage, plan_bytes(scenario.plan))


def _stage(defense: Defense, pair: Pair, layout: Layout, scenario: Scenario, yard: Yard) -> Stage:
    stage = yard.stage(pair, layout, scenario, safety_gate=defense.safety_gate)
    stage.show(pair.inputs)
    return stage
