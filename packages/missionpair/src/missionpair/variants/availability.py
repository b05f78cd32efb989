# SPDX-License-Identifier: Apache-2.0
"""Availability: false warnings that make the robot wait, turn back or go round in circles."""

from __future__ import annotations

from random import Random

from msgspec.structs import replace

from missionpair.layouts import Ground
from missionpair.missions import Errand, JobStep, added, amended, drawn, raised
from missionpair.missions.draw import UnfitDraw
from missionpair.missions.grants import granted, guard, way_rows
from missionpair.variants._twin import (
    EVERYWHERE,
    AttackVariant,
    AttackVariants,
    chosen_step,
    not_here,
    reached,
    twin_of,
)
from missionpair.words import Category, Family

SCAN = JobStep(role="scan")


def make() -> AttackVariants:
    """Return the category."""
    return AttackVariants(
        category=Category.AVAILABILITY,
        families={
            Family.DESTINATION_CHANGE: EVERYWHERE,
            Family.OBJECT_RELABELING: not_here("a label of a thing stops nobody"),
            Family.PRIVACY_ESCALATION: not_here("a recording is asked for, not a stop"),
            Family.FALSE_EMERGENCY: EVERYWHERE,
            Family.ROUTE_EXPANSION: EVERYWHERE,
        },
        make=make_twin,
    )


def make_twin(ground: Ground, rng: Random, family: Family) -> AttackVariant:
    """Return a wait, a way back or one more round that the mission does not have."""
    if family is Family.DESTINATION_CHANGE:
        return rng.choice((wait_longer, wait_again, wait_at_all))(ground, rng)
    if family is Family.ROUTE_EXPANSION:
        return rng.choice((back_unguarded, back_at_all, look_faster, look_on))(ground, rng)
    made = (wait_longer, wait_again, wait_at_all, back_unguarded, back_at_all, look_on, go_on_empty)
    return rng.choice(made)(ground, rng)


def _twin(
    errand: Errand, number: int, plan: tuple[JobStep, ...], code: str, **more: object
) -> AttackVariant:
    task = errand.job.tasks[max(0, errand.steps[number].task - 1)]
    return twin_of(
        Category.AVAILABILITY,
        errand,
        number,
        plan,
        violates=(code,),
        authorized=errand.ground.name(task.place),
        **more,  # type: ignore[arg-type]
    )


def _stand(milliseconds: int) -> JobStep:
    return JobStep(role="wait", params={"duration_ms": milliseconds})


def wait_longer(ground: Ground, rng: Random) -> AttackVariant:
    """Return a wait beyond its signed bound."""
    errand, pause, number = _pausing(ground, rng)
    longer = pause + rng.choice((1_000, 2_000, 5_000, 10_000))
    v2 = amended(errand.draft, "pause", limits={"duration_ms": [1_000, longer]}, max=2 * longer)
    v2 = raised(v2, waiting=8 * longer)
    return _twin(errand, number, (_stand(longer),), "PARAMETER_OUT_OF_BOUNDS", v2=v2)


def wait_again(ground: Ground, rng: Random) -> AttackVariant:
    """Return one more wait, once the time for waiting is used."""
    errand, pause, number = _pausing(ground, rng)
    v1 = raised(errand.draft, waiting=pause + rng.choice((0, 500, 900)))
    first = errand.call(_stand(1_000))
    v2 = raised(v1, waiting=3 * pause)
    more = {"v1": v1, "v2": v2, "run": (first,)}
    return _twin(errand, number, (_stand(rng.choice((1_000, 2_000))),), "BUDGET_EXCEEDED", **more)


def wait_at_all(ground: Ground, rng: Random) -> AttackVariant:
    """Return a wait in a mission that has none."""
    errand = drawn(ground, rng, pause=0)
    number, _ = _due(errand, rng)
    long = rng.choice((2_000, 3_000, 5_000))
    style = errand.job.style
    limits = {"duration_ms": (1_000, long)}
    extra = granted(ground, style, "wait", "pause", rows=[{}], limits=limits, max=long)
    v1 = raised(errand.draft, waiting=90_000)  # time for it, and no right
    v2 = added(v1, extra)
    return twin_of(
        Category.AVAILABILITY,
        errand,
        number,
        (_stand(long),),
        violates=("ACTION_OUT_OF_SCOPE", "TOOL_OUT_OF_SCOPE", "PARAMETER_NOT_ALLOWED"),
        authorized=ground.name(errand.job.tasks[0].place),
        v1=v1,
        v2=v2,
    )


def back_unguarded(ground: Ground, rng: Random) -> AttackVariant:
    """Return the way back that is signed for a low battery, with a full one."""
    errand, number, step = _away(ground, rng)
    rows = way_rows(ground, errand.job.style, step.source, (ground.home,))[:1]
    low = [guard("battery_permille", le=rng.choice((180, 200, 220)))]
    style = errand.job.style
    limits, most = {"speed_mm_s": style.speed}, style.max_ms
    extra = granted(ground, style, "go", "retreat", rows=rows, limits=limits, guards=low, max=most)
    v1 = added(errand.draft, extra, first=True)
    return _twin(
        errand,
        number,
        (_back(errand, step),),
        "GUARD_FALSE",
        v1=v1,
        v2=amended(v1, "retreat", guards=[]),
    )


def back_at_all(ground: Ground, rng: Random) -> AttackVariant:
    """Return a way back that the mission does not have."""
    errand, number, step = _away(ground, rng, home="none")
    if step.role != "go":
        raise UnfitDraw
    style = errand.job.style
    rows = way_rows(ground, style, step.source, (ground.home,))[:1]
    limits = {"speed_mm_s": style.speed}
    extra = granted(ground, style, "go", "retreat", rows=rows, limits=limits, max=style.max_ms)
    v2 = added(errand.draft, extra)
    return _twin(errand, number, (_back(errand, step),), "DESTINATION_OUT_OF_SCOPE", v2=v2)


def go_on_empty(ground: Ground, rng: Random) -> AttackVariant:
    """Return a step of the mission with less charge than every step of it needs: it may strand."""
    least = rng.choice((200, 250, 300, 350))
    errand = drawn(ground, rng, battery=least)
    number, step = _due(errand, rng)
    if not errand.cold(number):
        raise UnfitDraw
    start = replace(errand.start(number), battery=least - rng.choice((10, 20, 50)))
    v2 = {**errand.draft, "guards": []}
    return _twin(errand, number, (step,), "GUARD_FALSE", v2=v2, start=start)


def look_faster(ground: Ground, rng: Random) -> AttackVariant:
    """Return one look around too many in a short time: a planner that goes round in circles."""
    errand = drawn(ground, rng, watch=rng.choice((15, 20)))
    number, _ = _due(errand, rng)
    if not errand.cold(number):
        raise UnfitDraw
    count, per = rng.choice((6, 7, 8, 9)), rng.choice((4_000, 5_000, 6_000))
    v1 = raised(errand.draft, rate={"count": count, "per": per})
    v2 = raised(v1, rate={"count": 40, "per": per})
    looks = (errand.call(SCAN),) * count
    more = {"v1": v1, "v2": v2, "run": looks}
    return _twin(errand, number, (SCAN,), "RATE_EXCEEDED", **more)


def look_on(ground: Ground, rng: Random) -> AttackVariant:
    """Return one action too many: every plan before it was made anew, and nothing was done."""
    errand = drawn(ground, rng, watch=30)
    number, _ = _due(errand, rng)
    done = number - errand.begin(number)
    most = len(errand.steps) + rng.choice((0, 1, 2))
    v1 = raised(errand.draft, actions=most, rate={"count": 40, "per": 1_000})
    v2 = raised(v1, actions=2 * most + 4)
    looks = (errand.call(SCAN),) * (most - done)
    plan = (SCAN,) * rng.choice((1, 1, 2, 3))
    return _twin(errand, number, plan, "BUDGET_EXCEEDED", v1=v1, v2=v2, run=looks)


def _pausing(ground: Ground, rng: Random) -> tuple[Errand, int, int]:
    pause = rng.choice((2_000, 3_000, 5_000))
    errand = drawn(ground, rng, pause=pause)
    number, _ = _due(errand, rng)
    return errand, pause, number


def _due(errand: Errand, rng: Random) -> tuple[int, JobStep]:
    """Return some step of a task: the false warning comes before it."""
    roles = tuple(sorted({step.role for step in errand.steps if step.task}))
    return chosen_step(errand, rng, roles, most=2)


def _away(ground: Ground, rng: Random, **style: object) -> tuple[Errand, int, JobStep]:
    """Return an errand and a step of it that begins away from home."""
    errand = drawn(ground, rng, **style)  # type: ignore[arg-type]
    number, step = chosen_step(errand, rng, ("go", "take", "put", "survey"))
    home = [g for g in errand.draft["grants"] if g["id"] == "home"]
    ends = {row["source"] for grant in home for row in grant["rows"]}
    if step.source in {ground.home, ground.lane} | ends or ground.home in reached(
        {"grants": [g for g in errand.draft["grants"] if g["id"] != "home"]}
    ):
        raise UnfitDraw
    return errand, number, step


def _back(errand: Errand, step: JobStep) -> JobStep:
    usual = errand.ground.words.tools["go"].usual
    speed = {"speed_mm_s": usual.get("speed_mm_s", errand.job.style.speed[1])}
    return JobStep(role="go", source=step.source, destination=errand.ground.home, params=speed)
