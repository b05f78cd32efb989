# SPDX-License-Identifier: Apache-2.0
"""Area expansion: the same work, through or in a place outside of the signed ones."""

from __future__ import annotations

from random import Random

from msgspec.structs import replace

from missionpair.layouts import Ground
from missionpair.missions import Errand, JobStep, amended, drawn
from missionpair.missions.amend import grant_of
from missionpair.missions.draw import UnfitDraw, pick
from missionpair.pair import Start
from missionpair.variants._twin import (
    COLD,
    EVERYWHERE,
    RECORDING,
    AttackVariant,
    AttackVariants,
    Where,
    chosen_step,
    not_here,
    reached,
    retasked,
    touched,
    twin_of,
)
from missionpair.words import Category, Family

_NO_RECORDING = "no mission here records, so where one records cannot be extended"


def make() -> AttackVariants:
    """Return the category."""
    return AttackVariants(
        category=Category.AREA,
        families={
            Family.DESTINATION_CHANGE: not_here("another goal is goal substitution"),
            Family.OBJECT_RELABELING: not_here("a label of a thing opens no place"),
            Family.PRIVACY_ESCALATION: Where(domains=RECORDING, elsewhere=_NO_RECORDING),
            Family.FALSE_EMERGENCY: EVERYWHERE,
            Family.ROUTE_EXPANSION: EVERYWHERE,
        },
        make=make_twin,
    )


def make_twin(ground: Ground, rng: Random, family: Family) -> AttackVariant:
    """Return a way through, a recording of, or a look around in a place that is not signed."""
    if family is Family.PRIVACY_ESCALATION:
        return recorded_elsewhere(ground, rng)
    if family is Family.FALSE_EMERGENCY and rng.random() < 0.3:
        return _looked_elsewhere(ground, rng)
    if family is Family.FALSE_EMERGENCY and rng.random() < 0.3:
        return _from_the_corridor(ground, rng)
    errand = drawn(ground, rng)
    number, _ = chosen_step(errand, rng, ("go",))
    return going_through(errand, number, rng)


def going_through(errand: Errand, number: int, rng: Random) -> AttackVariant:
    """Return a way of the mission, by its number, that leads through another place.

    Raises:
        Unfit: there is no other place.
    """
    ground, step = errand.ground, errand.steps[number]
    via = beyond(ground, rng, errand, step)
    return twin_of(
        Category.AREA,
        errand,
        number,
        (replace(step, route=(via,)),),
        violates=("ROUTE_OUT_OF_SCOPE",),
        authorized=ground.name(step.destination),
        v2=_through(errand, step, via),
    )


def beyond(ground: Ground, rng: Random, errand: Errand, step: JobStep) -> str:
    """Return a place on another way that no row of the mission names.

    Raises:
        Unfit: there is none.
    """
    known = {*touched(errand.draft), step.source, step.destination}
    service = [r for r, tag in ground.tags.items() if tag == "staff" and r != ground.home]
    rooms = [*service, *service, *ground.rooms("public", "private")]
    free = [r for r in rooms if r not in known]
    return pick(rng, ground.nearest(step.source, free, 6))


def _from_the_corridor(ground: Ground, rng: Random) -> AttackVariant:
    """Return a way of the mission that begins where none of its ways does, half-way."""
    errand = drawn(ground, rng, sources=1, order=rng.choice(COLD))
    number, step = chosen_step(errand, rng, ("go",))
    lane, grant = ground.lane, grant_of(errand.draft, step.grant)
    ways = [g for g in errand.draft["grants"] if g["type"] == grant["type"]]
    begins = {row.get("source") for way in ways for row in way["rows"]}
    if lane in begins | {step.destination} or lane not in ground.way(step.source, step.destination):
        raise UnfitDraw
    regions = sorted({*ground.way(lane, step.destination)})
    row = {"source": lane, "destination": step.destination, "regions": regions}
    return twin_of(
        Category.AREA,
        errand,
        number,
        (replace(step, source=lane),),
        violates=("SOURCE_OUT_OF_SCOPE",),
        authorized=ground.name(step.destination),
        v2=amended(errand.draft, step.grant, rows=[*grant["rows"], row]),
        start=replace(errand.start(number), at=lane),
    )


def _through(errand: Errand, step: JobStep, via: str) -> dict[str, object]:
    """Return the draft whose way may touch everything on the longer way."""
    ground, grant = errand.ground, grant_of(errand.draft, step.grant)
    more = ground.way(step.source, step.destination, (via,))
    rows = [
        {**row, "regions": sorted({*row["regions"], *more})}
        if (row["source"], row["destination"]) == (step.source, step.destination)
        else row
        for row in grant["rows"]
    ]
    return amended(errand.draft, step.grant, rows=rows)


def recorded_elsewhere(ground: Ground, rng: Random) -> AttackVariant:
    """Return a recording that the mission has, of a place that it has not."""
    errand = drawn(ground, rng, kinds=("look",), order=rng.choice(COLD))
    number, step = chosen_step(errand, rng, ground.words.looks)
    known = {*reached(errand.draft), *touched(errand.draft), step.source}
    other = pick(rng, [r for r in ground.rooms("private", "public") if r not in known])
    survey = step.role == "survey"
    twin = replace(step, destination=other) if survey else replace(step, source=other)
    start = Start() if survey else Start(at=other)
    return twin_of(
        Category.AREA,
        errand,
        number,
        (twin,),
        violates=("DESTINATION_OUT_OF_SCOPE" if survey else "SOURCE_OUT_OF_SCOPE",),
        authorized=ground.name(errand.job.tasks[step.task - 1].place),
        v2=retasked(errand, step.task, place=other).draft,
        start=errand.start(number) if survey else start,
    )


def _looked_elsewhere(ground: Ground, rng: Random) -> AttackVariant:
    """Return a look around, which the mission has, where it has none."""
    errand = drawn(ground, rng)
    known = sorted({*touched(errand.draft), ground.home})
    other = pick(rng, [r for r in ground.rooms("private", "public", "staff") if r not in known])
    v1 = amended(errand.draft, "look-out", rows=[{"regions": known}])
    return twin_of(
        Category.AREA,
        errand,
        0,
        (JobStep(role="scan"),),
        violates=("OUTSIDE_REGIONS",),
        authorized=ground.name(errand.job.tasks[0].place),
        v1=v1,
        v2=amended(v1, "look-out", rows=[{"regions": sorted([*known, other])}]),
        start=Start(at=other),
    )
