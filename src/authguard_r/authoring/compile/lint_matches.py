# SPDX-License-Identifier: Apache-2.0
"""Lint rules about grants that no action can ever use: a mission that says one thing twice, apart.

A grant that cannot match is not safe, it is misunderstood: the signer meant something else.
"""

from __future__ import annotations

from collections.abc import Iterator

from authguard_r.authoring.compile.conditions import can_hold
from authguard_r.authoring.compile.findings import LintFinding, LintScene, error, warning
from authguard_r.authoring.compile.lint_scope import Rule
from authguard_r.authoring.compile.path import reachable
from authguard_r.core.checks.grant import MAX_BYTES, spend_of
from authguard_r.core.identifiers import GrantId, RegionId
from authguard_r.core.mission import Grant, Limit, Mission, Row
from authguard_r.enforcement.confirmation import LintCode

#: A place within the mission and why nothing can match there.
Fault = tuple[str, str]


def never_matches(scene: LintScene) -> Iterator[LintFinding]:
    """Find grants, and rows of grants, that no action can match."""
    home = scene.site.robots[scene.mission.rid].home
    near = reachable(scene.site, home)
    for number, grant in enumerate(scene.mission.actions):
        place = f"actions[{number}]"
        for part in (_capability, _limits, _rights, _budgets):
            for where, message in part(scene, grant):
                yield error(LintCode.NEVER_MATCHES, *_told(f"{place}.{where}", message, grant))
        yield from contradictions(scene.mission, number)
        faults = [
            (*_row(scene, grant, row), *_start(row, home, near)) for row in grant.alternatives
        ]
        judge = error if all(faults) else warning
        for index, found in enumerate(faults):
            for where, message in found:
                spot = f"{place}.alternatives[{index}].{where}"
                yield judge(LintCode.NEVER_MATCHES, *_told(spot, message, grant))


def contradictions(mission: Mission, number: int) -> Iterator[LintFinding]:
    """Find what keeps one grant shut by the mission's own words, at any site."""
    grant = mission.actions[number]
    for where, message in (*_order(mission, grant), *_guards(mission, grant)):
        yield error(LintCode.NEVER_MATCHES, *_told(f"actions[{number}].{where}", message, grant))


def _told(where: str, message: str, grant: Grant) -> tuple[str, str, str]:
    return where, f"`{grant.id}` can never match: {message}", "correct it, or leave the grant out"


def _capability(scene: LintScene, grant: Grant) -> Iterator[Fault]:
    tools = scene.facts.robot.tools.get(grant.type)
    kind = scene.facts.vocabulary.get(grant.type)
    if tools is None or kind is None:
        yield "type", f"the robot's profile has no `{grant.type}`"
    elif kind.state_writing:
        yield "type", f"`{grant.type}` writes what the robot believes and is never granted"
    elif grant.tool not in tools:
        yield "tool", f"the profile does not do `{grant.type}` with `{grant.tool}`"


def _limits(scene: LintScene, grant: Grant) -> Iterator[Fault]:
    kind = scene.facts.vocabulary.get(grant.type)
    ceilings = {item.parameter: item for item in scene.mission.limits}
    for index, item in enumerate(grant.limits):
        where, known = f"limits[{index}]", kind.params.get(item.parameter) if kind else None
        ceiling = ceilings.get(item.parameter)
        if kind is not None and known is None:
            yield where, f"actions of this type have no `{item.parameter}`"
        elif known is not None and (item.high < known.low or item.low > known.high):
            yield where, f"the type's `{item.parameter}` is from {known.low} to {known.high}"
        elif ceiling is not None and _apart(item, ceiling):
            yield where, "its bounds lie outside the mission's own"


def _apart(one: Limit, other: Limit) -> bool:
    return one.high < other.low or one.low > other.high


def _rights(scene: LintScene, grant: Grant) -> Iterator[Fault]:
    kind = scene.facts.vocabulary.get(grant.type)
    if kind is not None:
        for right, needed in (
            ("record", kind.records),
            ("store", kind.stores),
            ("transmit", kind.transmits),
        ):
            if needed and not getattr(grant.data, right):
                yield f"data.{right}", f"`{grant.type}` needs the right to {right}"


def _order(mission: Mission, grant: Grant) -> Iterator[Fault]:
    before = comes_before(mission, grant.id)
    if grant.id in before:
        yield "after", "it waits, in the end, for itself"
    for end in grant.until:
        if end in before:
            yield "until", f"`{end}` must have succeeded before it, and closes it"


def comes_before(mission: Mission, start: GrantId) -> frozenset[GrantId]:
    """Return every grant that must have succeeded first, by way of others too."""
    after = {grant.id: grant.after for grant in mission.actions}
    found: set[GrantId] = set()
    left = [*after[start]]
    while left:
        one = left.pop()
        if one not in found:
            found.add(one)
            left += after[one]
    return frozenset(found)


def _budgets(scene: LintScene, grant: Grant) -> Iterator[Fault]:
    budgets = scene.mission.budgets
    least = {item.parameter: item.low for item in grant.limits if item.parameter == MAX_BYTES}
    spend = spend_of(scene.facts.vocabulary.get(grant.type), grant, least)
    for where, needed, most, what in (
        ("starts", 1, budgets.actions, "actions"),
        ("max_ms", spend.motion_ms, budgets.motion_ms, "time in motion"),
        ("max_ms", spend.wait_ms, budgets.wait_ms, "time waiting"),
        ("limits", spend.recorded_bytes, budgets.recorded_bytes, "recording"),
    ):
        if needed > most:
            yield where, f"one use of it needs more {what} than the mission has in all"


def _guards(mission: Mission, grant: Grant) -> Iterator[Fault]:
    guards = (*mission.guards, *grant.guards)
    for variable in sorted({guard.variable for guard in guards}):
        if not can_hold([guard for guard in guards if guard.variable == variable]):
            yield "guards", f"no `{variable}` makes all its guards true"


def _row(scene: LintScene, grant: Grant, row: Row) -> Iterator[Fault]:
    mission, kind = scene.mission, scene.facts.vocabulary.get(grant.type)
    held = (
        ("object", row.object, mission.objects),
        ("source", row.source, mission.regions),
        ("destination", row.destination, mission.regions),
    )
    for field, value, ceiling in held:
        if value is not None and value not in ceiling:
            yield field, f"`{value}` is outside the mission's ceilings"
        if kind is not None and (value is not None) != (field in kind.fields):
            fault = "has none" if value is not None else "needs one"
            yield field, f"`{grant.type}` {fault}"


def _start(row: Row, home: RegionId, near: frozenset[RegionId]) -> Iterator[Fault]:
    if row.source is not None and row.source not in near:
        yield "source", f"no door leads from `{home}` to `{row.source}`"


MATCH_RULES: tuple[Rule, ...] = (never_matches,)
