# SPDX-License-Identifier: Apache-2.0
"""Lint rules about what is granted: to whom it turns out to be given, where, and why."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from authguard_r.authoring.compile import wording
from authguard_r.authoring.compile.conditions import real_guards
from authguard_r.authoring.compile.findings import LintFinding, LintScene, error, warning
from authguard_r.authoring.compile.path import SENSITIVE_TAGS
from authguard_r.authoring.compile.unlisted import unlisted
from authguard_r.authoring.compile.worst import reach, worst_risk
from authguard_r.core.facts import ActionKind
from authguard_r.core.identifiers import RegionId
from authguard_r.core.mission import Grant, Guard, Mission
from authguard_r.core.risk import required, tier_of
from authguard_r.enforcement.confirmation import LintCode
from authguard_r.site.model import ActionModel

Rule = Callable[[LintScene], Iterator[LintFinding]]
#: Types that keep a robot from its work.
_IDLE = frozenset({"dock", "hold", "wait"})


def unguarded_returns(scene: LintScene) -> Iterator[LintFinding]:
    """Returning, stopping and waiting end the work: who may cause them, and when?

    Order (`after`) is held by the registry, so it is some condition; attested state is a better. A
    guard on the whole mission says when its work may be done, not when it may be left; it counts
    where there is no other work. A guard that always holds has no effect.
    """
    yield from _unguarded(scene.mission, [abandons(g, scene) for g in scene.mission.actions])


def leaves_unguarded(mission: Mission) -> Iterator[LintFinding]:
    """The same without the site: idle types, and what leads somewhere once the work is done."""
    last = () if mission.closing is None else mission.closing.grants
    leaving = [
        grant.type in _IDLE
        or (grant.id in last and any(row.destination is not None for row in grant.alternatives))
        for grant in mission.actions
    ]
    yield from _unguarded(mission, leaving)


def _unguarded(mission: Mission, leaving: list[bool]) -> Iterator[LintFinding]:
    if real_guards(mission.guards) and all(leaving):
        return
    for number, grant in enumerate(mission.actions):
        if not leaving[number] or real_guards(grant.guards, mission.guards):
            continue
        place, lack = f"actions[{number}].guards", _lack(grant.guards)
        mend = (
            "add a guard on attested state, such as "
            "`{variable: battery_permille, le: 200, max_age: 2 s}` (the battery is low)"
        )
        if grant.after:
            message = f"only the order of grants delays `{grant.id}`: {lack}"
            yield warning(LintCode.UNGUARDED_RETURN, place, message, mend)
        else:
            message = f"`{grant.id}` may end the work at any time: {lack}"
            yield error(LintCode.UNGUARDED_RETURN, place, message, mend)


def _lack(guards: tuple[Guard, ...]) -> str:
    if guards:
        return "its guards on trusted state leave out no value that the mission's own allow"
    return "no guard on trusted state"


def abandons(grant: Grant, scene: LintScene) -> bool:
    """True for waiting, docking, holding, and for going home or to an emergency place."""
    kind = scene.facts.vocabulary.get(grant.type)
    if grant.type in _IDLE or (kind is not None and kind.waits):
        return True
    refuges = {scene.site.robots[scene.mission.rid].home}
    if scene.site.emergency is not None:
        refuges |= set(scene.site.emergency.places)
    moves = kind is not None and kind.moves
    return moves and any(row.destination in refuges for row in grant.alternatives)


def wider_than_task(scene: LintScene) -> Iterator[LintFinding]:
    """A signer should want on purpose what the task's words do not mention."""
    for number, grant in enumerate(scene.mission.actions):
        place = f"actions[{number}]"
        model = scene.site.vocabulary.get(grant.type)
        if model is None:
            continue
        if not _speaks_of_type(grant, model, scene):
            yield _unspoken(f"{place}.type", f"actions of type `{grant.type}`", grant)
        yield from _unspoken_rows(place, grant, model, scene)
        for right, used in (
            ("record", model.records),
            ("store", model.stores),
            ("transmit", model.transmits),
        ):
            if (
                used
                and getattr(grant.data, right)
                and not wording.asks_for_right(scene.task, right)
            ):
                yield _unspoken(f"{place}.data.{right}", f"a right to {right} sensor data", grant)


def _speaks_of_type(grant: Grant, model: ActionModel, scene: LintScene) -> bool:
    """True when words ask for the type, or it is one that no words need to ask for.

    Going somewhere is asked for by naming the place; what has no field and leaves no trace (a
    look-out for obstacles) is how, not what.
    """
    if model.moves and "destination" in model.fields:
        return True
    acts = (model.fields, model.params, model.moves, model.waits, model.records, model.privacy)
    return not any(acts) or wording.asks_for_type(scene.task, grant.type)


def _unspoken_rows(
    place: str, grant: Grant, model: ActionModel, scene: LintScene
) -> Iterator[LintFinding]:
    for index, row in enumerate(grant.alternatives):
        where = f"{place}.alternatives[{index}]"
        if row.object is not None and not wording.mentions(
            scene.task, wording.object_names(row.object, scene.site)
        ):
            yield _unspoken(f"{where}.object", f"`{row.object}`", grant)
        region = row.source if row.destination is None and not model.moves else row.destination
        if region is not None and not _speaks_of_region(region, grant, scene):
            field = "destination" if row.destination is not None else "source"
            yield _unspoken(f"{where}.{field}", f"`{region}`", grant)


def _speaks_of_region(region: RegionId, grant: Grant, scene: LintScene) -> bool:
    """True when the region is named, holds what is named, or is the home that closing leads to."""
    closing, site, task = scene.mission.closing, scene.site, scene.task
    home = site.robots[scene.mission.rid].home
    if region == home and closing is not None and grant.id in closing.grants:
        return True
    return wording.mentions(task, wording.region_names(region, site)) or any(
        model.home == region and wording.mentions(task, wording.object_names(item, site))
        for item, model in site.objects.items()
    )


def _unspoken(where: str, what: str, grant: Grant) -> LintFinding:
    return warning(
        LintCode.WIDER_THAN_TASK,
        where,
        f"`{grant.id}` grants {what}, which the task does not name",
        "leave it out, or say it in the task",
    )


def through_sensitive(scene: LintScene) -> Iterator[LintFinding]:
    """A way through a private, restricted or hazardous region is granted on purpose.

    A word in the task grants nothing: a region that the task asks for is still shown, and a region
    that it only forbids ("never go through Office 1") counts as not named.
    """
    asked = wording.affirmed(scene.mission.task)
    for number, grant in enumerate(scene.mission.actions):
        for index, row in enumerate(grant.alternatives):
            for region in row.regions:
                tags = _sensitive_tags(region, scene)
                if not tags or region in {row.source, row.destination}:
                    continue
                spoken = wording.mentions(asked, wording.region_names(region, scene.site))
                judge = warning if spoken else error
                yield judge(
                    LintCode.THROUGH_SENSITIVE,
                    f"actions[{number}].alternatives[{index}].regions",
                    f"`{grant.id}` may pass through `{region}` ({', '.join(tags)})",
                    "leave the region out"
                    if spoken
                    else "leave the region out, or ask for it in the task",
                )


def _sensitive_tags(region: RegionId, scene: LintScene) -> list[str]:
    known = scene.facts.regions.get(region)
    return sorted(SENSITIVE_TAGS & known.tags) if known is not None else []


def never_asks(scene: LintScene) -> Iterator[LintFinding]:
    """A threshold above every risk that the mission can reach never asks a person."""
    mission = scene.mission
    highest = max(
        worst_risk(mission, grant, row, scene.facts)
        for grant in mission.actions
        for row in grant.alternatives
    )
    if highest >= mission.risk_policy.tau_1:
        return
    risky = [f"`{grant.id}`" for grant in mission.actions if _is_sensitive(grant, scene)]
    if risky:
        yield error(
            LintCode.NEVER_ASKS,
            "risk_policy.tau_1",
            f"no risk reaches {mission.risk_policy.tau_1} (the highest is {highest}), so no one is "
            f"asked about {', '.join(risky)}",
            f"lower `tau_1` to {highest} or below, or raise the weights",
        )


def unlisted_risk(scene: LintScene) -> Iterator[LintFinding]:
    """A name that the risk policy does not list weighs `otherwise`, which may ask people."""
    policy = scene.mission.risk_policy
    asked = required(policy, tier_of(policy, policy.otherwise)) - 1
    if not asked:
        return
    for number, grant in enumerate(scene.mission.actions):
        names = unlisted(policy, scene.site, grant)
        if names:
            yield warning(
                LintCode.RISK_UNLISTED,
                f"actions[{number}]",
                f"the risk policy does not list {', '.join(names)}: each weighs "
                f"{policy.otherwise}, so `{grant.id}` asks {asked} more people each time",
                "give each name a weight in `risk_policy` of the draft, and compile it again",
            )


def _is_sensitive(grant: Grant, scene: LintScene) -> bool:
    """True for what touches privacy, hazards, or presses hard."""
    kind: ActionKind | None = scene.facts.vocabulary.get(grant.type)
    if kind is not None and kind.privacy:
        return True
    most = scene.site.robots[scene.mission.rid].profile.max_force_mn
    for item in grant.limits:
        forceful = reach(item) * 100 >= most * scene.measures.forceful_percent
        if item.parameter.startswith("force_") and forceful:
            return True
    return any(
        any(_sensitive_tags(region, scene) for region in row.regions)
        or (row.object is not None and scene.facts.objects.get(row.object) == "hazardous")
        for row in grant.alternatives
    )


SCOPE_RULES: tuple[Rule, ...] = (
    unguarded_returns,
    wider_than_task,
    through_sensitive,
    never_asks,
    unlisted_risk,
)
