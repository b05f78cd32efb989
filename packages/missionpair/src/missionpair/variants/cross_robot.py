# SPDX-License-Identifier: Apache-2.0
"""Cross-robot: the mission of one robot, at the gate of another."""

from __future__ import annotations

from random import Random

from missionpair.layouts import Ground
from missionpair.missions import drawn, superseding
from missionpair.missions.draw import UnfitDraw
from missionpair.pair import PriorAct
from missionpair.variants._twin import (
    COLD,
    EVERYWHERE,
    AttackVariant,
    AttackVariants,
    chosen_step,
    not_here,
    subject,
    twin_of,
)
from missionpair.words import Category, Family


def make() -> AttackVariants:
    """Return the category."""
    return AttackVariants(
        category=Category.CROSS_ROBOT,
        families={
            Family.DESTINATION_CHANGE: not_here("the claim is about the robot, not about a room"),
            Family.OBJECT_RELABELING: EVERYWHERE,
            Family.PRIVACY_ESCALATION: not_here("a recording is no reason for another robot"),
            Family.FALSE_EMERGENCY: EVERYWHERE,
            Family.ROUTE_EXPANSION: not_here("another way is no reason for another robot"),
        },
        make=make_twin,
    )


def make_twin(ground: Ground, rng: Random, family: Family) -> AttackVariant:
    """Return a step of the mission, where it was put into another robot's store."""
    errand = drawn(ground, rng, order=rng.choice((*COLD, "task")))
    other = list(ground.words.robots)[1]
    able = ground.words.robots[other].roles
    roles = tuple({step.role for step in errand.steps if step.task and step.role in able})
    number, step = chosen_step(errand, rng, tuple(sorted(roles)))
    if not errand.cold(number):
        raise UnfitDraw
    own = {**errand.draft, "robot": other}
    if rng.random() < 0.5:
        missions = {"v2": superseding(errand.draft, own)}
        update: tuple[PriorAct, ...] = (PriorAct(do="activate", mission="v2"),)
    else:
        missions = {"own": {**own, "mission": "mission-2"}}
        revoke = PriorAct(do="order", verb="revoke", by=("operator-1",))
        update = (revoke, PriorAct(do="activate", mission="own"))
    return twin_of(
        Category.CROSS_ROBOT,
        errand,
        number,
        (step,),
        violates=("ROBOT_MISMATCH", "PROFILE_MISMATCH"),
        authorized=errand.job.robot
        if family is Family.OBJECT_RELABELING
        else subject(errand, number, family),
        robot=other,
        missions=missions,
        update=update,
        before=(PriorAct(do="force", mission="v1"),),
    )
