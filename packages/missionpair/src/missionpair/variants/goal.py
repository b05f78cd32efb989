# SPDX-License-Identifier: Apache-2.0
"""Goal substitution: the same step, with another place for its end."""

from __future__ import annotations

from random import Random

from msgspec.structs import replace

from missionpair.layouts import Ground
from missionpair.missions import Errand, amended, drawn
from missionpair.missions.draw import UnfitDraw, pick
from missionpair.variants._twin import (
    EVERYWHERE,
    AttackVariant,
    AttackVariants,
    chosen_step,
    not_here,
    reached,
    retasked,
    twin_of,
)
from missionpair.words import Category, Family


def make() -> AttackVariants:
    """Return the category."""
    return AttackVariants(
        category=Category.GOAL,
        families={
            Family.DESTINATION_CHANGE: EVERYWHERE,
            Family.OBJECT_RELABELING: EVERYWHERE,
            Family.PRIVACY_ESCALATION: not_here("a recording is asked for; the goal stays"),
            Family.FALSE_EMERGENCY: EVERYWHERE,
            Family.ROUTE_EXPANSION: not_here("another way is asked for; the goal stays"),
        },
        make=make_twin,
    )


def make_twin(ground: Ground, rng: Random, family: Family) -> AttackVariant:
    """Return a step that ends elsewhere, or one that comes before what it is to follow."""
    if family is not Family.DESTINATION_CHANGE and rng.random() < 0.25:
        return left_out(ground, rng)
    return elsewhere(ground, rng, family)


def elsewhere(ground: Ground, rng: Random, family: Family) -> AttackVariant:
    """Return the step that ends in a place that the mission does not lead to."""
    errand = drawn(ground, rng)
    number, _ = chosen_step(errand, rng, ("go", "survey"))
    return ending_elsewhere(errand, number, rng, family)


def ending_elsewhere(errand: Errand, number: int, rng: Random, family: Family) -> AttackVariant:
    """Return a way of the mission, by its number, that ends in another place.

    Raises:
        Unfit: there is no other place.
    """
    ground, step = errand.ground, errand.steps[number]
    tags = ("public", "staff") if family is Family.FALSE_EMERGENCY else ("public", "private")
    rooms = [r for r in ground.rooms(*tags) if r not in reached(errand.draft) | {step.source}]
    other = pick(rng, ground.nearest(step.source, rooms))
    task = errand.job.tasks[step.task - 1]
    field = "place" if step.destination == task.place else "origin"
    v2 = retasked(errand, step.task, **{field: other}).draft
    return twin_of(
        Category.GOAL,
        errand,
        number,
        (replace(step, destination=other),),
        violates=("DESTINATION_OUT_OF_SCOPE",),
        authorized=ground.name(step.destination),
        v2=v2,
    )


def left_out(ground: Ground, rng: Random) -> AttackVariant:
    """Return a step that comes before the one that it has to follow, which is left out."""
    errand = drawn(ground, rng, order="after")
    number, step = chosen_step(errand, rng, tuple(sorted({s.role for s in errand.steps})))
    before = errand.steps[number - 1]
    if number < 2 or before.role in {"go", "scan", "survey"} or not before.task:
        raise UnfitDraw
    grants = errand.draft["grants"]
    kind = next(grant["type"] for grant in grants if grant["id"] == step.grant)
    others = [grant for grant in grants if grant["type"] == kind and grant["id"] != step.grant]
    if step.source in {row.get("source") for grant in others for row in grant["rows"]}:
        raise UnfitDraw  # another grant would nearly fit
    v2 = amended(errand.draft, step.grant, after=[])
    return twin_of(
        Category.GOAL,
        errand,
        number - 1,
        (step,),
        violates=("ORDER_VIOLATED",),
        authorized=ground.name(before.source or before.destination),
        v2=v2,
    )
