# SPDX-License-Identifier: Apache-2.0
"""What a category has to say of one attack, and what all of them share."""

from __future__ import annotations

from collections.abc import Callable
from random import Random
from typing import Any

from msgspec import Struct
from msgspec.structs import replace

from missionpair.layouts import Ground
from missionpair.missions import Errand, JobStep, superseding
from missionpair.missions.amend import Draft
from missionpair.missions.draw import UnfitDraw
from missionpair.pair import PriorAct, Scenario, Start, WordedCall
from missionpair.words import Category, Domain, Family

#: Orders in which a step needs nothing before it but for where everything is.
COLD = ("guards", "open")
#: Domains whose missions record; in the others asking for a recording is another capability.
RECORDING = frozenset({Domain.OFFICE, Domain.INSPECTION, Domain.LABORATORY})
#: Among them those in which how long, or how finely, is the planner's to say.
RECORDING_FREELY = frozenset({Domain.OFFICE, Domain.INSPECTION})
#: Domains in which something is carried.
CARRYING = frozenset(set(Domain) - {Domain.INSPECTION})


class AttackVariant(Struct, frozen=True, kw_only=True):
    """One attack on one mission, without its words.

    Args:
        categories: what it changes.
        errand: the mission as it is meant.
        missions: drafts by key; `v1` is attacked.
        robot: at whose gate.
        start: where everything is.
        before: what happens first.
        plan: the twin.
        update: acts that authorize exactly it.
        violates: protected fields, by its author.
        reasons: what the gate refuses it with, where that differs; by its author.
        authorized: what the mission has where the attack changes it, in words.
        benign: the run as it is meant.
        commissioned: what the robot's profile lacks, by action type (`pair.Pair`).
        number: of the mission's step in whose place the attack comes; -1: of none.
    """

    categories: tuple[Category, ...]
    errand: Errand
    missions: dict[str, Draft]
    robot: str
    start: Start
    before: tuple[PriorAct, ...]
    plan: tuple[WordedCall, ...]
    update: tuple[PriorAct, ...]
    violates: tuple[str, ...]
    reasons: tuple[str, ...] = ()
    authorized: str
    benign: Scenario
    commissioned: dict[str, str] = {}
    number: int = -1

    @property
    def scenario(self) -> Scenario:
        """The attacked situation, with the twin as its plan."""
        return Scenario(robot=self.robot, start=self.start, before=self.before, plan=self.plan)


class Where(Struct, frozen=True, kw_only=True):
    """Whether a family is a reason for a category's change.

    Args:
        why_not: why it is no twin; empty when it is one.
        domains: where it is one.
        elsewhere: why it is no twin in the other domains.
    """

    why_not: str = ""
    domains: frozenset[Domain] = frozenset(Domain)
    elsewhere: str = ""

    def refuses(self, domain: Domain) -> str:
        """Return why it does not apply in a domain; empty when it does."""
        return self.why_not or ("" if domain in self.domains else self.elsewhere)


EVERYWHERE = Where()

Maker = Callable[[Ground, Random, Family], AttackVariant]


class AttackVariants(Struct, frozen=True, kw_only=True):
    """A category: which families are reasons for it, and what makes its twins.

    Args:
        category: its row in a table.
        families: for each family, whether it applies.
        make: returns a twin, or raises `UnfitDraw` when the draw has not what it needs.
    """

    category: str
    families: dict[Family, Where]
    make: Maker


def not_here(why: str) -> Where:
    """Return that a family is no reason for a category's change."""
    return Where(why_not=why)


def twin_of(
    category: Category | tuple[Category, ...],
    errand: Errand,
    number: int,
    plan: tuple[JobStep, ...],
    *,
    violates: tuple[str, ...],
    authorized: str,
    v1: Draft | None = None,
    v2: Draft | None = None,
    **more: Any,
) -> AttackVariant:
    """Return the twin that comes where a step of the mission is due.

    Args:
        category: what it changes.
        errand: the mission as it is meant.
        number: of the step.
        plan: what comes in its place.
        violates: protected fields.
        authorized: what the mission has there, in words.
        v1: the attacked draft, where it is not the errand's own.
        v2: its next version, which authorizes the twin; `superseding` is called on it.
        more: fields of the twin that differ from the usual ones; `run` are calls that come last
            before the twin, `acts` come after them.
    """
    start, steps = errand.before(number)
    history = (*errand.calls(steps), *more.pop("run", ()))
    run = (PriorAct(do="run", calls=history),) if history else ()
    first = errand.draft if v1 is None else v1
    missions = {"v1": first, **more.pop("missions", {})}
    update = more.pop("update", ())
    if v2 is not None:
        missions["v2"] = superseding(first, v2)
        update = (PriorAct(do="activate", mission="v2"),)
    fields: dict[str, Any] = {
        "categories": category if isinstance(category, tuple) else (category,),
        "errand": errand,
        "missions": missions,
        "robot": errand.job.robot,
        "start": more.pop("start", start),
        "before": (PriorAct(do="activate", mission="v1"), *run, *more.pop("acts", ())),
        "plan": errand.calls(plan),
        "update": update,
        "violates": violates,
        "authorized": authorized,
        "benign": errand.benign(),
        "number": number,
    }
    return AttackVariant(**{**fields, **more})


def chosen_step(
    errand: Errand, rng: Random, roles: tuple[str, ...], *, most: int = 3
) -> tuple[int, JobStep]:
    """Return one of the mission's steps, with its number, that does not need a long history.

    Args:
        errand: the mission.
        rng: the only source of chance.
        roles: what it may be.
        most: steps that may come before it.

    Raises:
        Unfit: there is none.
    """
    found = [
        (number, step)
        for number, step in enumerate(errand.steps)
        if step.role in roles and step.task and number - errand.begin(number) <= most
    ]
    if not found:
        raise UnfitDraw
    return rng.choice(found)


def reached(draft: Draft) -> set[str]:
    """Return every place to which some grant of the draft leads."""
    rows = [row for grant in draft["grants"] for row in grant["rows"]]
    return {row["destination"] for row in rows if "destination" in row}


def touched(draft: Draft) -> set[str]:
    """Return every place that a row of the draft names."""
    return {r for grant in draft["grants"] for row in grant["rows"] for r in row.get("regions", ())}


def alone(draft: Draft, grant: str) -> bool:
    """True when no other grant of the draft is of the same type."""
    kinds = [g["type"] for g in draft["grants"]]
    return kinds.count(next(g["type"] for g in draft["grants"] if g["id"] == grant)) == 1


def subject(errand: Errand, number: int, family: Family) -> str:
    """Return what a claim is about, in words: the thing of a task, or else its place.

    Args:
        errand: the mission.
        number: of the step that is attacked.
        family: what is claimed.
    """
    task = errand.job.tasks[max(1, errand.steps[number].task) - 1]
    is_thing = family is Family.OBJECT_RELABELING and task.thing
    return errand.ground.name(task.thing if is_thing else task.place)


def retasked(errand: Errand, number: int, **changes: Any) -> Errand:
    """Return the errand with one task changed, counted from 1."""
    from missionpair.missions import built

    tasks = tuple(
        replace(task, **changes) if n == number else task
        for n, task in enumerate(errand.job.tasks, 1)
    )
    return built(errand.ground, replace(errand.job, tasks=tasks))
