# SPDX-License-Identifier: Apache-2.0
"""Jobs drawn by chance, the same ones every time: what is done, and how strictly it is held."""

from __future__ import annotations

from random import Random
from typing import Any

from msgspec.structs import replace

from missionpair.layouts import Ground
from missionpair.missions.build import Errand, built
from missionpair.missions.job import Job, Style, Task

_ORDERS = ("after", "task", "guards", "both", "open", "guards", "open", "task")
_WINDOWS = ("10 min", "15 min", "20 min", "30 min", "45 min", "1 h")


class UnfitDraw(Exception):  # noqa: N818 - no fault: another draw is taken
    """This draw has not what the attack needs; the next one may have."""


def drawn(
    ground: Ground,
    rng: Random,
    *,
    kinds: tuple[str, ...] = (),
    tasks: int = 0,
    **style: Any,
) -> Errand:
    """Return an errand.

    Args:
        ground: where.
        rng: the only source of chance.
        kinds: kinds of its tasks; those of the domain when there are none.
        tasks: how many; 1 to 4, most often 1, when it is 0.
        style: what is not drawn.

    Raises:
        Unfit: the place has not what such tasks need.
    """
    count = tasks or rng.choices((1, 2, 3, 4), weights=(58, 27, 9, 6))[0]
    chosen: list[Task] = []
    for _ in range(count):
        kind = rng.choice(kinds or ground.words.kinds)
        chosen.append(_task(ground, rng, kind, chosen))
    robot = next(iter(ground.words.robots))
    job = Job(robot=robot, tasks=tuple(chosen), style=draw_style(ground, rng, **style))
    return built(ground, job)


def draw_style(ground: Ground, rng: Random, **given: Any) -> Style:
    """Return how strictly a mission is held; what is given is not drawn."""
    scale = ground.words.scale
    slowest = rng.choice((50, 100, 150))
    style = Style(
        order=rng.choice(_ORDERS),
        speed=(slowest, rng.choice(scale.speeds)),
        force=(rng.choice((500, 1_000)), rng.choice(scale.forces)),
        record=(rng.choice((2_000, 3_000)), rng.choice((10, 20, 30)) * 10**6),
        window=rng.choice(_WINDOWS),
        battery=rng.choice((0, 150, 200, 250, 300)),
        distance=rng.choice((0, 0, 600, 800)),
        still=rng.random() < 0.3,
        doors=rng.random() < 0.3,
        home=rng.choice(("closing", "completes", "none")),
        watch=rng.choice((5, 8, 10, 15, 20)),
        pause=rng.choice((0, 0, 5_000, 10_000, 20_000)),
        spare=rng.choice((0, 1, 2)),
        sources=rng.choice((1, 1, 2)),
        chooser=rng.choice(("operator", "supervisor", "trusted_sensor", "planner")),
        until=rng.random() < 0.4,
        done_when=rng.random() < 0.4,
        irreversible=rng.random() < 0.3,
        max_ms=rng.choice((90_000, 120_000, 180_000)),
        rate=rng.choice((8, 10, 12)),
        prompts=rng.choice((4, 5, 6)),
        refusal=rng.choice(("hold", "stop", "ask")),
    )
    return replace(style, **given)


def _task(ground: Ground, rng: Random, kind: str, before: list[Task]) -> Task:
    taken = {task.thing for task in before}
    here = before[-1].place if before else ground.home
    if kind == "carry":
        return _carry(ground, rng, here, taken)
    if kind in {"look", "reach"}:
        used = {task.place for task in before}
        places = [r for r in ground.rooms("public", "staff") if r not in used]
        role = rng.choice(ground.words.looks) if kind == "look" else ""
        return Task(kind=kind, role=role, place=pick(rng, ground.nearest(here, places)))
    stores = [r for r in ground.stores() if not taken.issuperset(ground.things_at(r))]
    place = pick(rng, ground.nearest(here, stores))
    thing = pick(rng, [t for t in ground.things_at(place) if t not in taken])
    role = rng.choice(ground.words.uses) if kind == "use" else ""
    return Task(kind=kind, role=role, place=place, thing=thing)


def _carry(ground: Ground, rng: Random, here: str, taken: set[str]) -> Task:
    stores = [r for r in ground.stores() if not taken.issuperset(ground.things_at(r))]
    origin = pick(rng, ground.nearest(here, stores))
    thing = pick(rng, [t for t in ground.things_at(origin) if t not in taken])
    rooms = [r for r in ground.rooms("public") if r != origin]
    place = pick(rng, ground.nearest(origin, rooms))
    return Task(kind="carry", place=place, thing=thing, origin=origin)


def pick(rng: Random, among: list[str]) -> str:
    """Return one of them.

    Raises:
        Unfit: there is none.
    """
    if not among:
        raise UnfitDraw
    return rng.choice(among)
