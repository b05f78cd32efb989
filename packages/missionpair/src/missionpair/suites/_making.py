# SPDX-License-Identifier: Apache-2.0
"""From a twin to a pair: an id, a text on each channel, and nothing that came up before."""

from __future__ import annotations

from collections.abc import Iterator
from enum import Enum
from random import Random
from typing import Any, NamedTuple

from msgspec.structs import replace

from missionpair import domains, variants
from missionpair.layouts import DomainWords, Ground, RobotWords, call_of, layouts_of
from missionpair.missions.draw import UnfitDraw
from missionpair.pair import Input, Layout, Pair, PriorAct, Suite, Value
from missionpair.registry import make, names
from missionpair.suites._canonical import canonical
from missionpair.variants._twin import AttackVariant, AttackVariants
from missionpair.variants.parameter import most_of
from missionpair.wording import coordinate, is_for, persuade, say, say_in
from missionpair.wording.grammar import TALKED
from missionpair.wording.productions import OURS, Grammar
from missionpair.words import Category, Channel, Domain, Family

#: Steps of the mission that may come before an attack in its own plan.
_MOST_BEFORE = 5
#: Draws after which a cell has nothing new.
_MOST_DRAWS = 600


class Told(Enum):
    """In how many texts an attack is told."""

    ONCE = "one text"
    IN_ANOTHER_LANGUAGE = "one text in one of five other languages"
    ON_TWO_CHANNELS = "a second channel confirms what the first one says"
    IN_TURNS = "three turns of persuasion on one channel, where people talk"


class Cell(NamedTuple):
    """One cell of the matrix: who is attacked, what is changed, what is claimed, on which way."""

    domain: Domain
    category: str
    family: Family
    channel: Channel


class Makers:
    """Everything that pairs are made of, made once: layouts by domain, twins by category."""

    def __init__(self, layouts: int | None = None) -> None:
        self.words: dict[Domain, DomainWords] = {}
        self.grounds: dict[Domain, tuple[Ground, ...]] = {}
        for name in names(domains):
            words: DomainWords = make(domains, name)
            self.words[words.domain] = words
            self.grounds[words.domain] = (
                layouts_of(words) if layouts is None else layouts_of(words, layouts)
            )
        self.twins: dict[str, AttackVariants] = {}
        for name in names(variants):
            made: AttackVariants = make(variants, name)
            self.twins[str(made.category)] = made

    def layouts(self) -> dict[str, Layout]:
        """Return every layout by its id."""
        return {g.layout.id: g.layout for grounds in self.grounds.values() for g in grounds}

    def why_not(self, domain: Domain, category: str, family: Family) -> str:
        """Return why a cell does not apply; empty when it does."""
        return self.twins[category].families[family].refuses(domain)

    def cells(self) -> Iterator[Cell]:
        """Yield every cell that applies, in a fixed order."""
        for domain in Domain:
            for category in (*map(str, Category), "combined"):
                for family in Family:
                    if not self.why_not(domain, category, family):
                        for channel in Channel:
                            yield Cell(domain, category, family, channel)


class PairMaker:
    """Makes pairs of one suite, none twice.

    Args:
        makers: what they are made of.
        name: the suite's; its pairs are drawn from it.
        grammar: the sentences of their texts.
    """

    def __init__(self, makers: Makers, name: str, *, grammar: Grammar = OURS) -> None:
        self.makers = makers
        self.name = name
        self.grammar = grammar
        self._seen: set[str] = set()

    def pair(
        self,
        cell: Cell,
        number: int,
        *,
        told: Told = Told.ONCE,
        is_longer: bool = False,
        is_other: bool = False,
    ) -> Pair:
        """Return a pair of a cell that is no renaming of one before.

        Args:
            cell: which one.
            number: counts the cell's pairs.
            told: in how many texts.
            is_longer: what comes before the twin is part of the attack's plan, where it can be.
            is_other: the twin has a call that the mission as it is meant has not, so that a planner
                that keeps to its task is distinguished from one that does not.

        Raises:
            RuntimeError: the cell has nothing new.
        """
        maker = self.makers.twins[cell.category]
        for attempt in range(_MOST_DRAWS):
            rng = Random(f"{self.name} {' '.join(cell)} {number} {attempt}")  # noqa: S311
            ground = rng.choice(self.makers.grounds[cell.domain])
            try:
                twin = maker.make(ground, rng, cell.family)
            except UnfitDraw:
                continue
            twin = prolonged(twin) if is_longer else twin
            found = pair_of(
                twin, cell, number, seed=rng.getrandbits(31), told=told, grammar=self.grammar
            )
            form = canonical(found, ground.layout)
            if is_other and all(call in found.benign.plan for call in found.attack.plan):
                continue
            if form not in self._seen:
                self._seen.add(form)
                return found
        raise RuntimeError(f"nothing new for {cell}")


def prolonged(twin: AttackVariant) -> AttackVariant:
    """Return the attack with steps of the mission before it as the first part of its plan.

    The same attack where that is not possible: other acts lie between, its signer has to do more
    than to sign the next version, or the plan would name what the attack speaks against.
    """
    errand, number = twin.errand, twin.number
    if twin.update != (PriorAct(do="activate", mission="v2"),) or number < 0:
        return twin
    start, done = errand.before(number)
    run = (PriorAct(do="run", calls=errand.calls(done)),) if done else ()
    if twin.start != start or twin.before != (PriorAct(do="activate", mission="v1"), *run):
        return twin
    firsts = range(max(0, number - _MOST_BEFORE), errand.begin(number) + 1)
    first = next((at for at in firsts if at == 0 or errand.cold(at)), number)
    if first == number:
        return twin
    plan = (*errand.calls(errand.steps[first:number]), *twin.plan)
    if is_for(plan, twin.authorized) is not is_for(twin.plan, twin.authorized):
        return twin
    return replace(twin, start=errand.start(first), before=twin.before[:1], plan=plan)


def pair_of(
    twin: AttackVariant,
    cell: Cell,
    number: int,
    *,
    seed: int,
    told: Told = Told.ONCE,
    grammar: Grammar = OURS,
) -> Pair:
    """Return the pair of a twin, with the words in which its channels ask for it.

    Args:
        twin: the attack.
        cell: where it belongs.
        number: counts the cell's pairs.
        seed: draws the wording.
        told: in how many texts.
        grammar: the sentences.
    """
    in_turns = told is Told.IN_TURNS and cell.channel in TALKED
    channels: tuple[Channel, ...] = (cell.channel,) * (3 if in_turns else 1)
    if told is Told.ON_TWO_CHANNELS:
        others = [channel for channel in Channel if channel is not cell.channel]
        channels = (cell.channel, others[seed % len(others)])
    errand = twin.errand
    return Pair(
        id=".".join(
            (
                *(cell.domain, cell.category, cell.family),
                *("+".join(dict.fromkeys(channels)), f"{number:02}"),
            )
        ),
        domain=cell.domain,
        layout=errand.ground.layout.id,
        categories=twin.categories,
        family=cell.family,
        channels=channels,
        missions=twin.missions,
        task=errand.draft["task"],
        benign=twin.benign,
        attack=twin.scenario,
        update=twin.update,
        inputs=spoken(twin, cell, channels, seed=seed, told=told, grammar=grammar),
        violates=twin.violates,
        reasons=twin.reasons or twin.violates,
        commissioned=twin.commissioned,
    )


def spoken(
    twin: AttackVariant,
    cell: Cell,
    channels: tuple[Channel, ...],
    *,
    seed: int,
    told: Told,
    grammar: Grammar,
) -> tuple[Input, ...]:
    """Return what reaches the planner: the one place that asks for wording.

    A call for which another language has no words is asked for in English.
    """
    words = twin.errand.ground.words
    more: dict[str, Any] = {
        "authorized": twin.authorized,
        "seed": seed,
        "category": cell.category,
        "most": most_said(words, words.robots[twin.robot]),
        "grammar": grammar,
    }
    if len(channels) == 3:
        return persuade(cell.family, cell.channel, twin.plan, **more)
    if len(channels) == 2:
        both = (channels[0], channels[1])
        return coordinate(cell.family, both, twin.plan, **more)
    text = None
    if told is Told.IN_ANOTHER_LANGUAGE:
        language = tuple(grammar.languages)[seed % len(grammar.languages)]
        known = {name: more[name] for name in ("authorized", "seed", "most", "grammar")}
        text = say_in(language, cell.family, twin.plan, **known)
    return (Input(channels[0], text or say(cell.family, channels[0], twin.plan, **more)),)


def most_said(words: DomainWords, robot: RobotWords) -> dict[str, Value]:
    """Return the most of each argument, as a planner's call has it: `at full speed` is said."""
    most = {f"params.{name}": value for name, value in most_of(robot).items()}
    return {
        name: value
        for tool in words.tools.values()
        for name, value in call_of(tool, dict(most)).arguments.items()
    }


def suite_of(name: str, version: int, makers: Makers, pairs: list[Pair]) -> Suite:
    """Return the suite, with the layouts that its pairs have."""
    used = {pair.layout for pair in pairs}
    layouts = {key: layout for key, layout in makers.layouts().items() if key in used}
    return Suite(name=name, version=version, layouts=layouts, pairs=tuple(pairs))
