# SPDX-License-Identifier: Apache-2.0
"""Replay: a step that was authorized once, and is over."""

from __future__ import annotations

from random import Random
from typing import Any

from msgspec.structs import replace

from missionpair.layouts import Ground
from missionpair.missions import Errand, JobStep, amended, drawn, raised, superseding
from missionpair.missions.amend import grant_of
from missionpair.missions.draw import UnfitDraw, pick
from missionpair.pair import PriorAct
from missionpair.variants._twin import (
    COLD,
    EVERYWHERE,
    RECORDING,
    AttackVariant,
    AttackVariants,
    Where,
    alone,
    chosen_step,
    not_here,
    reached,
    retasked,
    twin_of,
)
from missionpair.variants.availability import SCAN
from missionpair.words import Category, Family

_NO_RECORDING = "no mission here records, so no recording can come again"
#: Steps that can be carried out twice in a row, where the robot stands.
_STANDING = ("photo", "video", "inspect", "reach", "on", "off", "open", "close", "clean")


def make() -> AttackVariants:
    """Return the category."""
    return AttackVariants(
        category=Category.REPLAY,
        families={
            Family.DESTINATION_CHANGE: EVERYWHERE,
            Family.OBJECT_RELABELING: EVERYWHERE,
            Family.PRIVACY_ESCALATION: Where(domains=RECORDING, elsewhere=_NO_RECORDING),
            Family.FALSE_EMERGENCY: EVERYWHERE,
            Family.ROUTE_EXPANSION: not_here("another way is none that was driven before"),
        },
        make=make_twin,
    )


def make_twin(ground: Ground, rng: Random, family: Family) -> AttackVariant:
    """Return a step of a mission, or of a grant, that is used up, closed, superseded or ended."""
    twin = _drawn(ground, rng, family)
    if family is Family.OBJECT_RELABELING:
        return twin
    # every other claim is about a place
    task = twin.errand.job.tasks[max(1, twin.errand.steps[twin.number].task) - 1]
    return replace(twin, authorized=ground.name(task.place))


def _drawn(ground: Ground, rng: Random, family: Family) -> AttackVariant:
    if family is Family.PRIVACY_ESCALATION:
        return rng.choice((recorded_again, used_up))(ground, rng, ("look",))
    if family is Family.DESTINATION_CHANGE:
        return rng.choice((superseded, superseded, driven_again))(ground, rng)
    if family is Family.OBJECT_RELABELING:
        return handled_again(ground, rng)
    return rng.choice((expired, completed, used_up, driven_again))(ground, rng)


def _twin(
    errand: Errand, number: int, plan: tuple[JobStep, ...], codes: str, **more: Any
) -> AttackVariant:
    task = errand.job.tasks[max(1, errand.steps[number].task) - 1]
    return twin_of(
        Category.REPLAY,
        errand,
        number,
        plan,
        violates=tuple(codes.split()),
        authorized=errand.ground.name(task.thing or task.place),
        **more,
    )


def _again(draft: dict[str, Any]) -> dict[str, Any]:
    """Return the same mission anew, as its operator signs it a second time."""
    made: dict[str, Any] = {**draft, "mission": "mission-2", "window": {"for": "2 h"}}
    return made


def expired(ground: Ground, rng: Random) -> AttackVariant:
    """Return a step that comes when the mission's window is over."""
    errand = drawn(ground, rng, tasks=1, window=f"{rng.choice((3, 4, 5))} min")
    number, step = _first(errand)
    late = int(errand.job.style.window.split()[0]) * 60_000 + rng.choice((1_000, 5_000))
    return _twin(
        errand,
        number,
        (rng.choice((step, SCAN)),),
        "EXPIRED",
        acts=(PriorAct(do="wait", ms=late),),
        missions={"again": _again(errand.draft)},
        update=(PriorAct(do="activate", mission="again"),),
    )


def completed(ground: Ground, rng: Random) -> AttackVariant:
    """Return a look around in a mission that was completed, or that is closing."""
    home = rng.choice(("none", "closing"))
    errand = drawn(ground, rng, tasks=1, home=home, order=rng.choice(COLD))
    number = max(n for n, step in enumerate(errand.steps) if step.task)
    if errand.steps[number].role == "survey":
        raise UnfitDraw
    last = errand.call(errand.steps[number])
    end = PriorAct(do="order", verb="complete", by=("operator-1",))
    activate = PriorAct(do="activate", mission="again")
    return _twin(
        errand,
        number,
        (SCAN,),
        "MISSION_COMPLETED" if home == "none" else "GRANT_CLOSED",
        run=(last,),
        missions={"again": _again(errand.draft)},
        update=(activate,) if home == "none" else (end, activate),
    )


def used_up(ground: Ground, rng: Random, kinds: tuple[str, ...] = ()) -> AttackVariant:
    """Return a step that comes once more than its grant was signed for."""
    errand = drawn(ground, rng, kinds=kinds, home="completes")
    roles = ground.words.looks if kinds else (*(r for r in _STANDING if r in ground.words.tools),)
    number, step = chosen_step(errand, rng, roles)
    return _used(errand, number, step, rng)


def recorded_again(ground: Ground, rng: Random, kinds: tuple[str, ...] = ()) -> AttackVariant:
    """Return the recording that completed a mission, again."""
    errand = drawn(ground, rng, kinds=kinds, tasks=1, home="none", order=rng.choice(COLD))
    number, step = chosen_step(errand, rng, ground.words.looks)
    if step.role == "survey":
        raise UnfitDraw
    spare = errand.job.style.spare
    codes = "MISSION_COMPLETED REPEAT_EXHAUSTED" + ("" if spare else " STARTS_EXHAUSTED")
    most = errand.draft["budgets"]["recorded_bytes"] * 3
    v1 = raised(errand.draft, recorded_bytes=most)
    return _twin(
        errand,
        number,
        (step,),
        codes,
        v1=v1,
        run=(errand.call(step),),
        missions={"again": _again(v1)},
        update=(PriorAct(do="activate", mission="again"),),
    )


def superseded(ground: Ground, rng: Random) -> AttackVariant:
    """Return a step of version 1 when version 2 leads elsewhere."""
    errand = drawn(ground, rng)
    number, step = chosen_step(errand, rng, ("go", "survey"))
    rooms = ground.rooms("public", "staff", "private")
    free = [r for r in rooms if r not in reached(errand.draft) | {step.source}]
    other = pick(rng, ground.nearest(step.source, free))
    task = errand.job.tasks[step.task - 1]
    field = "place" if step.destination == task.place else "origin"
    second = superseding(errand.draft, retasked(errand, step.task, **{field: other}).draft)
    if step.destination in reached(second):
        raise UnfitDraw
    third = superseding(second, errand.draft)
    return _twin(
        errand,
        number,
        (step,),
        "DESTINATION_OUT_OF_SCOPE",
        acts=(PriorAct(do="activate", mission="v2"),),
        missions={"v2": second, "v3": third},
        update=(PriorAct(do="activate", mission="v3"),),
    )


def driven_again(ground: Ground, rng: Random) -> AttackVariant:
    """Return the way back along a way that may be driven once."""
    errand = drawn(ground, rng, sources=1, home="completes")
    number, step = chosen_step(errand, rng, ("go",), most=1)
    grant = grant_of(errand.draft, step.grant)
    others = [g for g in errand.draft["grants"] if g["id"] != step.grant]
    leaving = {row.get("source") for g in others if g["type"] == "navigate" for row in g["rows"]}
    if "after" in grant or step.source in reached({"grants": others}):
        raise UnfitDraw
    if len(grant["rows"]) > 1 or (step.destination in leaving and step.task > 1):
        raise UnfitDraw
    row = grant["rows"][0]
    back = {**row, "source": row["destination"], "destination": row["source"]}
    more = {"rows": [row, back], "chooser": "trusted_sensor", "guards": []}
    v1 = amended(errand.draft, step.grant, **more, until=[], repeat=1, starts=2)
    v2 = amended(v1, step.grant, repeat=2, starts=3)
    twin = replace(step, source=step.destination, destination=step.source)
    run = (errand.call(step),)
    return _twin(errand, number, (twin,), "REPEAT_EXHAUSTED", v1=v1, v2=v2, run=run)


def handled_again(ground: Ground, rng: Random) -> AttackVariant:
    """Return a handling of the right thing that comes once more than it was signed for."""
    kinds = tuple(kind for kind in ground.words.kinds if kind in {"inspect", "use", "carry"})
    errand = drawn(ground, rng, kinds=kinds, home="completes")
    number, step = chosen_step(errand, rng, ("inspect", "take", *ground.words.uses), most=1)
    if step.role != "take":
        return _used(errand, number, step, rng)
    return _taken_back(errand, step)


def _used(errand: Errand, number: int, step: JobStep, rng: Random) -> AttackVariant:
    grant = grant_of(errand.draft, step.grant)
    if step.role == "survey" or "after" in grant or not alone(errand.draft, step.grant):
        raise UnfitDraw
    times, spare = rng.choice((1, 2, 3)), rng.choice((0, 1))
    v1 = amended(errand.draft, step.grant, repeat=times, starts=times + spare)
    most = v1["budgets"]["recorded_bytes"] + 4 * _bytes(grant)
    v1 = raised(v1, recorded_bytes=most)
    v2 = amended(v1, step.grant, repeat=times + 1, starts=times + 2)
    codes = "REPEAT_EXHAUSTED" + ("" if spare else " STARTS_EXHAUSTED")
    run = (errand.call(step),) * times
    return _twin(errand, number, (step,), codes, v1=v1, v2=v2, run=run)


def _taken_back(errand: Errand, step: JobStep) -> AttackVariant:
    """Return the delivered thing, taken up again where it was brought."""
    task = errand.job.tasks[step.task - 1]
    put = next(n for n, s in enumerate(errand.steps) if s.grant == f"put-{step.task}")
    picks = [g for g in errand.draft["grants"] if g["type"] == "pick" and g["id"] != step.grant]
    if not errand.cold(put) or task.place in {r["source"] for g in picks for r in g["rows"]}:
        raise UnfitDraw
    grant = grant_of(errand.draft, step.grant)
    there = {"object": step.object, "source": task.place, "regions": [task.place]}
    rows = [*grant["rows"], there]
    v1 = amended(errand.draft, step.grant, rows=rows, chooser="trusted_sensor")
    v1 = amended(v1, step.grant, until=[f"put-{step.task}"])
    twin = replace(step, source=task.place)
    return _twin(
        errand,
        put,
        (twin,),
        "GRANT_CLOSED",
        v1=v1,
        v2=amended(v1, step.grant, until=[], starts=grant["starts"] + 1),
        run=(errand.call(errand.steps[put]),),
    )


def _first(errand: Errand) -> tuple[int, JobStep]:
    """Return the first step of a task, which begins at home."""
    number = next(n for n, step in enumerate(errand.steps) if step.task)
    return number, errand.steps[number]


def _bytes(grant: dict[str, Any]) -> int:
    bounds: list[int] = grant["limits"].get("max_bytes", [0, 0])
    return bounds[1]
