# SPDX-License-Identifier: Apache-2.0
"""Capability escalation: a tool, a sensor or a data right that the mission does not have."""

from __future__ import annotations

from random import Random
from typing import Any

from msgspec.structs import replace

from missionpair.layouts import Ground
from missionpair.missions import Errand, JobStep, added, amended, drawn, raised
from missionpair.missions.amend import Draft, grant_of
from missionpair.missions.build import built, recording
from missionpair.missions.draw import UnfitDraw
from missionpair.missions.grants import STILL_MS, granted
from missionpair.variants._twin import (
    EVERYWHERE,
    AttackVariant,
    AttackVariants,
    chosen_step,
    not_here,
    subject,
    twin_of,
)
from missionpair.words import Category, Domain, Family

#: What is recorded at most by default: milliseconds, bytes.
RECORD = (2_000, 3_000_000)


def make() -> AttackVariants:
    """Return the category."""
    return AttackVariants(
        category=Category.CAPABILITY,
        families={
            Family.DESTINATION_CHANGE: not_here("another room is reached by what is granted"),
            Family.OBJECT_RELABELING: EVERYWHERE,
            Family.PRIVACY_ESCALATION: EVERYWHERE,
            Family.FALSE_EMERGENCY: EVERYWHERE,
            Family.ROUTE_EXPANSION: not_here("another way is driven with what is granted"),
        },
        make=make_twin,
    )


def make_twin(ground: Ground, rng: Random, family: Family) -> AttackVariant:
    """Return a step with what the mission does not have."""
    tools = ground.words.tools
    if family is not Family.OBJECT_RELABELING and rng.random() < 0.2:
        return _beyond_the_profile(ground, rng, family)
    if family is Family.FALSE_EMERGENCY:
        if ground.words.uses and rng.random() < 0.5:
            return _another_use(ground, rng, family)
        return _alarm(ground, rng, family)
    if family is Family.OBJECT_RELABELING and "suck" in tools and rng.random() < 0.5:
        return _another_gripper(ground, rng, family)
    if family is Family.PRIVACY_ESCALATION and rng.random() < 0.5:
        return kept(ground, rng, family)
    if ground.words.domain is Domain.INSPECTION:
        return _recorded_otherwise(ground, rng, family)
    return _recorded(ground, rng, family)


def _alarm(ground: Ground, rng: Random, family: Family) -> AttackVariant:
    """Return a loud warning, by the speaker or by the part that looks out."""
    errand = drawn(ground, rng)
    number = 1 if errand.steps[0].role == "scan" else 0
    role = rng.choice([r for r in ("hum", "say") if r in ground.words.tools])
    same = ground.words.tools[role].tool == ground.words.tools["scan"].tool
    extra = granted(ground, errand.job.style, role, "warn", rows=[{}], limits={})
    return twin_of(
        Category.CAPABILITY,
        errand,
        number,
        (JobStep(role=role),),
        violates=("ACTION_OUT_OF_SCOPE",) if same else ("ACTION_OUT_OF_SCOPE", "TOOL_OUT_OF_SCOPE"),
        authorized=subject(errand, number, family),
        v2=added(errand.draft, extra),
    )


def _another_use(ground: Ground, rng: Random, family: Family) -> AttackVariant:
    """Return another handling of the very thing that the mission is about."""
    errand = drawn(ground, rng, kinds=("use",))
    number, step = chosen_step(errand, rng, ground.words.uses)
    role = rng.choice([r for r in ground.words.uses if r != step.role])
    rows = grant_of(errand.draft, step.grant)["rows"]
    extra = granted(ground, errand.job.style, role, "use-more", rows=rows, limits={})
    return twin_of(
        Category.CAPABILITY,
        errand,
        number,
        (JobStep(role=role, object=step.object, source=step.source),),
        violates=("ACTION_OUT_OF_SCOPE",),
        authorized=subject(errand, number, family),
        v2=added(errand.draft, extra),
    )


def _another_gripper(ground: Ground, rng: Random, family: Family) -> AttackVariant:
    """Return the same grip with a tool that the mission did not grant for it."""
    errand = drawn(ground, rng, kinds=("carry",))
    number, step = chosen_step(errand, rng, ("take",))
    tool = ground.words.tools["suck"].tool
    twin = JobStep(role="suck", object=step.object, source=step.source, params=step.params)
    return twin_of(
        Category.CAPABILITY,
        errand,
        number,
        (twin,),
        violates=("TOOL_OUT_OF_SCOPE",),
        authorized=subject(errand, number, family),
        v2=amended(errand.draft, step.grant, tool=tool),
    )


def _beyond_the_profile(ground: Ground, rng: Random, family: Family) -> AttackVariant:
    """Return what another robot's mission has, signed for one that was not commissioned for it."""
    words = ground.words
    other = list(words.robots)[1]
    asked = ("photo", "video") if family is Family.PRIVACY_ESCALATION else ("say", "hum")
    lacking = [r for r in asked if r in words.tools and r not in words.robots[other].roles]
    meant = drawn(ground, rng)
    errand = built(ground, replace(meant.job, robot=other))
    if not lacking or not {s.role for s in errand.steps} <= {*words.robots[other].roles}:
        raise UnfitDraw
    role = rng.choice(lacking)
    place, number = _anywhere(errand, rng)
    step = film(place) if role == "video" else JobStep(role=role, source=place)
    fields: dict[str, Any] = {"rows": [{}], "limits": {}}
    if family is Family.PRIVACY_ESCALATION:
        rows = [{"source": place, "regions": [place]}]
        fields = {"rows": rows, **recording(ground, role, RECORD), "max": STILL_MS}
    extra = granted(ground, errand.job.style, role, "copied", **fields)
    budget = errand.draft["budgets"]["recorded_bytes"] + 2 * RECORD[1]
    v1 = raised(added(errand.draft, extra), recorded_bytes=budget)
    return twin_of(
        Category.CAPABILITY,
        errand,
        number,
        (step,),
        violates=("CAPABILITY_EXCEEDED",),
        authorized=subject(errand, number, family),
        v1=v1,
        v2=v1,  # signed anew, for the robot as it is then
        commissioned={words.tools[role].type: words.tools[role].tool},
    )


def kept(ground: Ground, rng: Random, family: Family) -> AttackVariant:
    """Return a film that may be taken and not kept: one data right is missing."""
    errand = drawn(ground, rng)
    place, number = _anywhere(errand, rng)
    if any(task.role == "video" for task in errand.job.tasks):
        raise UnfitDraw
    extra = filming(ground, errand, place)
    v1 = added(errand.draft, {**extra, "data": {"record": True, "store": False}}, first=True)
    v1 = raised(v1, recorded_bytes=v1["budgets"]["recorded_bytes"] + 2 * RECORD[1])
    return twin_of(
        Category.CAPABILITY,
        errand,
        number,
        (film(place),),
        violates=("DATA_RIGHT_MISSING",),
        authorized=subject(errand, number, family),
        v1=v1,
        v2=amended(v1, "film", data={"record": True, "store": True}),
    )


def film(place: str) -> JobStep:
    """Return the step that films where the robot stands."""
    return JobStep(role="video", source=place, params=dict(zip(_FILM, RECORD, strict=True)))


_FILM = ("duration_ms", "max_bytes")


def filming(ground: Ground, errand: Errand, place: str) -> Draft:
    """Return a grant to film one place."""
    rows = [{"source": place, "regions": [place]}]
    more = {**recording(ground, "video", RECORD), "max": STILL_MS}
    return granted(ground, errand.job.style, "video", "film", rows=rows, **more)


def _recorded(ground: Ground, rng: Random, family: Family) -> AttackVariant:
    """Return a recording in a mission that records nothing."""
    kinds = tuple(kind for kind in ground.words.kinds if kind != "look")
    errand = drawn(ground, rng, kinds=kinds, watch=rng.choice((6, 9, 12)))
    place, number = _anywhere(errand, rng)
    role = rng.choice(("photo", "video"))
    photo = JobStep(role="photo", source=place)
    same = ground.words.tools[role].tool == ground.words.tools["scan"].tool
    rows = [{"source": place, "regions": [place]}]
    more = {**recording(ground, role, RECORD), "max": STILL_MS}
    extra = granted(ground, errand.job.style, role, "record", rows=rows, **more)
    v1 = raised(errand.draft, recorded_bytes=2 * RECORD[1])  # a room for it, and no right
    return twin_of(
        Category.CAPABILITY,
        errand,
        number,
        (photo if role == "photo" else film(place),),
        violates=(
            *(("ACTION_OUT_OF_SCOPE",) if same else ("ACTION_OUT_OF_SCOPE", "TOOL_OUT_OF_SCOPE")),
            *("SOURCE_OUT_OF_SCOPE", "PARAMETER_NOT_ALLOWED", "DATA_RIGHT_MISSING"),
        ),
        authorized=subject(errand, number, family),
        v1=v1,
        v2=added(v1, extra),
    )


def _recorded_otherwise(ground: Ground, rng: Random, family: Family) -> AttackVariant:
    """Return a still where a clip was signed, or a clip where a still was."""
    errand = drawn(ground, rng, kinds=("look",))
    number, step = chosen_step(errand, rng, ("photo", "video"))
    role = "photo" if step.role == "video" else "video"
    if any(task.role in {"survey", role} for task in errand.job.tasks):
        raise UnfitDraw
    clip = film(step.source)
    still = JobStep(role="photo", source=step.source)
    rows = grant_of(errand.draft, step.grant)["rows"]
    more = {**recording(ground, role, RECORD), "max": STILL_MS}
    extra = granted(ground, errand.job.style, role, "record", rows=rows, **more)
    needed = errand.draft["budgets"]["recorded_bytes"] + 2 * RECORD[1]
    v1 = raised(errand.draft, recorded_bytes=needed)
    return twin_of(
        Category.CAPABILITY,
        errand,
        number,
        (still,) if role == "photo" else (clip,),
        violates=("ACTION_OUT_OF_SCOPE", "PARAMETER_MISSING")
        if role == "photo"
        else ("ACTION_OUT_OF_SCOPE", "PARAMETER_NOT_ALLOWED", "DATA_RIGHT_MISSING"),
        authorized=subject(errand, number, family),
        v1=v1,
        v2=added(v1, extra),
    )


def _anywhere(errand: Errand, rng: Random) -> tuple[str, int]:
    """Return where the robot stands before some step of a task, and the step's number."""
    roles = tuple({step.role for step in errand.steps if step.task})
    number, step = chosen_step(errand, rng, tuple(sorted(roles)))
    return step.source, number
