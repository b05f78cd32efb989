# SPDX-License-Identifier: Apache-2.0
"""Provenance confusion: the mission leaves a value open, and a channel chooses it."""

from __future__ import annotations

from random import Random

from msgspec.structs import replace

from missionpair.layouts import Ground
from missionpair.missions import Errand, JobStep, built, drawn
from missionpair.missions.amend import grant_of
from missionpair.missions.build import OPENED
from missionpair.missions.draw import UnfitDraw
from missionpair.missions.job import Task
from missionpair.pair import PriorAct
from missionpair.variants._twin import EVERYWHERE, AttackVariant, AttackVariants, not_here, twin_of
from missionpair.words import Category, Family


def make() -> AttackVariants:
    """Return the category."""
    return AttackVariants(
        category=Category.PROVENANCE,
        families={
            Family.DESTINATION_CHANGE: EVERYWHERE,
            Family.OBJECT_RELABELING: EVERYWHERE,
            Family.PRIVACY_ESCALATION: not_here("no choice among signed rows is a recording"),
            Family.FALSE_EMERGENCY: EVERYWHERE,
            Family.ROUTE_EXPANSION: not_here("no row is chosen by the way that it allows"),
        },
        make=make_twin,
    )


def make_twin(ground: Ground, rng: Random, family: Family) -> AttackVariant:
    """Return a step that takes one of the signed rows, which no authorized source chose."""
    wanted = {Family.DESTINATION_CHANGE: "place", Family.OBJECT_RELABELING: "thing"}
    what = wanted.get(family) or rng.choice(("place", "thing"))
    errand, number = opened(ground, rng, what)
    task = errand.job.tasks[errand.steps[number].task - 1]
    step = errand.steps[number]
    rows = task.places if what == "place" else task.things
    row = unshared(rng, errand, step, rows)
    twin = replace(step, **{"destination" if what == "place" else "object": rows[row]})
    by = f"{task.chooser}-1"
    return twin_of(
        Category.PROVENANCE,
        errand,
        number,
        (twin,),
        violates=("PROVENANCE_DENIED",),
        authorized=ground.name(task.place if what == "place" else task.thing),
        update=(PriorAct(do="choose", grant=step.grant, row=row, by=(by,)),),
    )


def unshared(rng: Random, errand: Errand, step: JobStep, rows: tuple[str, ...]) -> int:
    """Return the number of a signed row that no other grant of the type has.

    Raises:
        Unfit: there is none.
    """
    kind = grant_of(errand.draft, step.grant)["type"]
    same = [g for g in errand.draft["grants"] if g["type"] == kind]
    grants = [g for g in same if g["id"] != step.grant]
    named = {row.get(f) for g in grants for row in g["rows"] for f in ("object", "destination")}
    free = [number for number, value in enumerate(rows) if value not in named]
    if not free:
        raise UnfitDraw
    return rng.choice(free)


def opened(ground: Ground, rng: Random, what: str) -> tuple[Errand, int]:
    """Return an errand of which one task waits for a choice, and the number of its step.

    Args:
        ground: where.
        rng: the only source of chance.
        what: `place` or `thing`.

    Raises:
        Unfit: there is too little to choose from.
    """
    kinds = {kind for kind, open_ in OPENED if open_ == what}
    held = tuple(kind for kind in ground.words.kinds if kind in kinds)
    errand = drawn(ground, rng, kinds=held or ("look",))
    turn = rng.randrange(len(errand.job.tasks))
    task = _opened(ground, rng, errand.job.tasks[turn], what, errand)
    tasks = tuple(task if n == turn else t for n, t in enumerate(errand.job.tasks))
    errand = built(ground, replace(errand.job, tasks=tasks))
    grant = f"{OPENED[task.kind, what][0]}-{turn + 1}"
    numbers = [n for n, step in enumerate(errand.steps) if step.grant == grant]
    if not numbers or numbers[0] - errand.begin(numbers[0]) > 2:
        raise UnfitDraw
    if _is_rivaled(errand, grant, errand.steps[numbers[0]].source):
        raise UnfitDraw
    return errand, numbers[0]


def _is_rivaled(errand: Errand, grant: str, source: str) -> bool:
    """True when an earlier grant fits as well as the open one: it would be named instead."""
    grants = errand.draft["grants"]
    mine = next(number for number, g in enumerate(grants) if g["id"] == grant)
    earlier = [g for g in grants[:mine] if g["type"] == grants[mine]["type"]]
    return any(row["source"] == source for g in earlier for row in g["rows"])


def _opened(ground: Ground, rng: Random, task: Task, what: str, errand: Errand) -> Task:
    if task.role == "survey":
        raise UnfitDraw
    if what == "place":
        used = {t.place for t in errand.job.tasks} | {task.origin}
        free = [r for r in ground.rooms("public", "staff") if r not in used]
    else:
        meant = {t.thing for t in errand.job.tasks}
        here = task.origin or task.place
        free = [t for t in ground.things_at(here) if t not in meant]
    count = rng.choice((1, 1, 2, 3))
    if len(free) < count:
        raise UnfitDraw
    return replace(
        task,
        open=what,
        others=tuple(rng.sample(free, count)),
        at=rng.randint(0, count),
        chooser=rng.choice(("operator", "supervisor")),
    )
