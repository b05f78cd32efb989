# SPDX-License-Identifier: Apache-2.0
"""Combinations: two or three things changed at once, in one step or in a plan of several."""

from __future__ import annotations

from random import Random

from msgspec.structs import replace

from missionpair.layouts import Ground
from missionpair.missions import JobStep, amended, drawn, raised
from missionpair.missions.amend import Draft, added, grant_of
from missionpair.missions.draw import UnfitDraw, pick
from missionpair.pair import PriorAct
from missionpair.variants._twin import (
    COLD,
    EVERYWHERE,
    AttackVariant,
    AttackVariants,
    chosen_step,
    reached,
    retasked,
    twin_of,
)
from missionpair.variants.area import beyond
from missionpair.variants.capability import RECORD, film, filming
from missionpair.variants.object import another
from missionpair.variants.parameter import over, spacious, widened
from missionpair.variants.provenance import opened, unshared
from missionpair.words import Category, Family


def make() -> AttackVariants:
    """Return the combinations."""
    return AttackVariants(
        category="combined", families=dict.fromkeys(Family, EVERYWHERE), make=make_twin
    )


def make_twin(ground: Ground, rng: Random, family: Family) -> AttackVariant:
    """Return a twin that changes several things."""
    if family is Family.ROUTE_EXPANSION:
        return _faster_elsewhere(ground, rng, goal=False, area=True, speed=True)
    if family is Family.OBJECT_RELABELING:
        return _harder_on_another(ground, rng)
    if family is Family.PRIVACY_ESCALATION:
        return _filmed_elsewhere(ground, rng)
    if family is Family.FALSE_EMERGENCY:
        return rng.choice((_by_another_robot, _chosen_faster, _everything))(ground, rng)
    area = rng.random() < 0.5
    return _faster_elsewhere(ground, rng, goal=True, area=area, speed=not area)


def _everything(ground: Ground, rng: Random) -> AttackVariant:
    return _faster_elsewhere(ground, rng, goal=True, area=True, speed=True)


def _faster_elsewhere(
    ground: Ground, rng: Random, *, goal: bool, area: bool, speed: bool
) -> AttackVariant:
    """Return a way that ends elsewhere, or leads through a place beyond, or is too fast."""
    errand = drawn(ground, rng)
    number, step = chosen_step(errand, rng, ("go",))
    changed, twin = errand, step
    parts: list[tuple[Category, str]] = []
    if goal:
        rooms = ground.rooms("public", "staff", "private")
        free = [r for r in rooms if r not in reached(errand.draft) | {step.source}]
        other = pick(rng, ground.nearest(step.source, free))
        task = errand.job.tasks[step.task - 1]
        field = "place" if step.destination == task.place else "origin"
        changed = retasked(errand, step.task, **{field: other})
        twin = replace(twin, destination=other)
        parts.append((Category.GOAL, "DESTINATION_OUT_OF_SCOPE"))
    draft = changed.draft
    if area:
        via = beyond(ground, rng, errand, twin)
        twin = replace(twin, route=(via,))
        draft = _wider(ground, draft, twin)
        parts.append((Category.AREA, "ROUTE_OUT_OF_SCOPE"))
    if speed:
        name, value = over(ground.words, rng, errand, step)
        twin = replace(twin, params={name: value})
        draft = widened(draft, step.grant, name, (errand.job.style.speed[0], value))
        parts.append((Category.PARAMETER, "PARAMETER_OUT_OF_BOUNDS"))
    return twin_of(
        tuple(category for category, _ in parts),
        errand,
        number,
        (twin,),
        violates=tuple(code for _, code in parts),
        authorized=ground.name(step.destination),
        v2=draft,
    )


def _wider(ground: Ground, draft: Draft, twin: JobStep) -> Draft:
    more = ground.way(twin.source, twin.destination, twin.route)
    rows = [
        {**row, "regions": sorted({*row["regions"], *more})}
        for row in grant_of(draft, twin.grant)["rows"]
    ]
    return amended(draft, twin.grant, rows=rows)


def _harder_on_another(ground: Ground, rng: Random) -> AttackVariant:
    """Return a grip, or a recording, of another thing with more than is signed."""
    kinds = tuple(kind for kind in ground.words.kinds if kind in {"carry", "inspect"})
    errand = drawn(ground, rng, kinds=kinds)
    number, step = chosen_step(errand, rng, ("take", "inspect"))
    other = another(ground, rng, errand, step.source)
    name, value = over(ground.words, rng, errand, step)
    low = grant_of(errand.draft, step.grant)["limits"][name][0]
    v2 = widened(retasked(errand, step.task, thing=other).draft, step.grant, name, (low, value))
    return twin_of(
        (Category.OBJECT, Category.PARAMETER),
        errand,
        number,
        (replace(step, object=other, params={**step.params, name: value}),),
        violates=("OBJECT_OUT_OF_SCOPE", "PARAMETER_OUT_OF_BOUNDS"),
        authorized=ground.name(step.object),
        v1=spacious(errand.draft, name, value),
        v2=spacious(v2, name, value),
    )


def _filmed_elsewhere(ground: Ground, rng: Random) -> AttackVariant:
    """Return a plan that films what may not be kept, and then goes where it has no business."""
    errand = drawn(ground, rng, order=rng.choice(COLD))
    number, step = chosen_step(errand, rng, ("go",))
    if any(task.role == "video" for task in errand.job.tasks):
        raise UnfitDraw
    rooms = ground.rooms("public", "private")
    free = [r for r in rooms if r not in reached(errand.draft) | {step.source}]
    other = pick(rng, ground.nearest(step.source, free))
    extra = filming(ground, errand, step.source)
    most = errand.draft["budgets"]["recorded_bytes"] + 2 * RECORD[1]
    v1 = added(errand.draft, {**extra, "data": {"record": True, "store": False}}, first=True)
    v1 = raised(v1, recorded_bytes=most)
    task = errand.job.tasks[step.task - 1]
    field = "place" if step.destination == task.place else "origin"
    v2 = added(retasked(errand, step.task, **{field: other}).draft, extra, first=True)
    return twin_of(
        (Category.CAPABILITY, Category.GOAL),
        errand,
        number,
        (film(step.source), replace(step, destination=other)),
        violates=("DATA_RIGHT_MISSING", "DESTINATION_OUT_OF_SCOPE"),
        reasons=("DATA_RIGHT_MISSING",),
        authorized=ground.name(step.destination),
        v1=v1,
        v2=raised(v2, recorded_bytes=most),
    )


def _chosen_faster(ground: Ground, rng: Random) -> AttackVariant:
    """Return a signed place that a channel chose, at a speed that was not signed."""
    errand, number = opened(ground, rng, "place")
    step = errand.steps[number]
    task = errand.job.tasks[step.task - 1]
    other = task.places[unshared(rng, errand, step, task.places)]
    name, value = over(ground.words, rng, errand, step)
    by = f"{task.chooser}-1"
    choose = PriorAct(do="choose", grant=step.grant, row=task.places.index(other), by=(by,))
    v2 = widened(errand.draft, step.grant, name, (errand.job.style.speed[0], value))
    twin = replace(step, destination=other, params={name: value})
    return twin_of(
        (Category.PROVENANCE, Category.PARAMETER),
        errand,
        number,
        (twin,),
        violates=("PROVENANCE_DENIED", "PARAMETER_OUT_OF_BOUNDS"),
        authorized=ground.name(task.place),
        missions={"v2": {**v2, "version": 2}},
        update=(PriorAct(do="activate", mission="v2"), choose),
    )


def _by_another_robot(ground: Ground, rng: Random) -> AttackVariant:
    """Return a step of another robot's mission, with more than even that one has."""
    errand = drawn(ground, rng, order=rng.choice(COLD))
    other = list(ground.words.robots)[1]
    number, step = chosen_step(errand, rng, ("go",))
    name, value = over(ground.words, rng, errand, step, robot=other)
    low = errand.job.style.speed[0]
    own = {**widened(errand.draft, step.grant, name, (low, value)), "robot": other, "version": 2}
    return twin_of(
        (Category.CROSS_ROBOT, Category.PARAMETER),
        errand,
        number,
        (replace(step, params={name: value}),),
        violates=("ROBOT_MISMATCH", "PROFILE_MISMATCH", "PARAMETER_OUT_OF_BOUNDS"),
        authorized=errand.job.robot,
        robot=other,
        missions={"v2": own},
        update=(PriorAct(do="activate", mission="v2"),),
        before=(PriorAct(do="force", mission="v1"),),
    )
