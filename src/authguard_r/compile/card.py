# SPDX-License-Identifier: Apache-2.0
"""The operator's card: what a mission grants, row by row, and what it does not.

Written from the very structure that is signed, never from the draft. Risks to privacy and bodies
are marked; a new version's widening comes first. How-to: docs/howto/missions.md
"""

from __future__ import annotations

from collections.abc import Iterator

from authguard_r.core.mission import Grant, Guard, Limit, Mission, Row
from authguard_r.site.model import Site

_COMPARISON = {"eq": "is", "ne": "is not", "lt": "<", "le": "<=", "gt": ">", "ge": ">="}


def review(mission: Mission, site: Site) -> tuple[str, ...]:
    """Return the card's lines."""
    return (*_head(mission), *_grants(mission, site), *_rest(mission, site))


def compare(old: Mission, new: Mission, site: Site) -> tuple[str, ...]:
    """Return what a new version changes, widening first."""
    before, after = set(_permissions(old, site)), set(_permissions(new, site))
    added = [f"ADDS    {line}" for line in _permissions(new, site) if line not in before]
    removed = [f"removes {line}" for line in _permissions(old, site) if line not in after]
    return (*added, *removed) or ("changes no permission",)


def _head(mission: Mission) -> Iterator[str]:
    yield f"Mission {mission.mid}, version {mission.version}, for robot {mission.rid}"
    yield f'  "{mission.task}"'
    yield f"  signed by {mission.issuer}; valid {mission.not_before} to {mission.expiry}"
    for guard in mission.guards:
        yield f"  only while {_condition(guard)}"


def _grants(mission: Mission, site: Site) -> Iterator[str]:
    yield "It grants:"
    for grant in mission.actions:
        yield from _grant(grant, site)


def _grant(grant: Grant, site: Site) -> Iterator[str]:
    mark = _marks(grant, site)
    times = f"{grant.repeat} time(s), at most {grant.starts} start(s), {grant.max_ms} ms each"
    yield f"  {grant.id}: {grant.type} with {grant.tool}, {times}{mark}"
    for row in grant.alternatives:
        yield f"    - {_row(row)}"
    if len(grant.alternatives) > 1:
        yield f"    chosen by: {grant.chooser}"
    for limit in grant.limits:
        yield f"    {_limit(limit)}"
    for guard in grant.guards:
        yield f"    only while {_condition(guard)}"
    if grant.after:
        yield f"    after: {', '.join(grant.after)}"
    if grant.until:
        yield f"    until: {', '.join(grant.until)}"
    rights = [r for r in ("record", "store", "transmit") if getattr(grant.data, r)]
    if rights:
        yield f"    MAY {', '.join(rights)} sensor data"


def _marks(grant: Grant, site: Site) -> str:
    """Mark what touches privacy, moves a body, or cannot be undone."""
    kind = site.vocabulary.get(grant.type)
    held = (
        ("PRIVACY", kind is not None and kind.privacy > 0),
        ("MOTION", kind is not None and kind.moves),
        ("IRREVERSIBLE", grant.irreversible),
    )
    marks = [name for name, holds in held if holds]
    return f"  [{', '.join(marks)}]" if marks else ""


def _rest(mission: Mission, site: Site) -> Iterator[str]:
    budgets, policy = mission.budgets, mission.risk_policy
    yield (
        f"In all: {budgets.actions} actions, {budgets.motion_ms} ms in motion, "
        f"{budgets.wait_ms} ms waiting, {budgets.recorded_bytes} bytes recorded"
    )
    yield (
        f"Asks a second person from risk {policy.tau_1}, {policy.t} people from {policy.tau_2} "
        f"(of {', '.join(policy.roles)})"
    )
    granted = {grant.type for grant in mission.actions}
    tools = site.robots[mission.rid].profile.tools if mission.rid in site.robots else {}
    withheld = sorted(kind for kind in tools if kind not in granted)
    closed = sorted(region for region in site.regions if region not in mission.regions)
    yield f"It does NOT grant: {', '.join(withheld) or 'nothing that this robot can do'}"
    yield f"It never enters: {', '.join(closed) or 'no region is closed'}"


def _permissions(mission: Mission, site: Site) -> Iterator[str]:
    """One line for each thing that a version permits, so that versions can be compared."""
    yield f"valid {mission.not_before} to {mission.expiry}"
    for grant in mission.actions:
        lines = list(_grant(grant, site))
        for row in grant.alternatives:
            yield f"{grant.id}: {grant.type} {_row(row)}"
        for line in lines[1:]:
            if not line.startswith("    - "):
                yield f"{grant.id}:{line[3:]}"
        yield lines[0].strip()


def _row(row: Row) -> str:
    parts = [f"{f} {getattr(row, f)}" for f in ("object", "source", "destination")]
    named = [part for part in parts if not part.endswith(" None")]
    within = f"within {', '.join(row.regions)}" if row.regions else "nowhere in particular"
    return ", ".join([*named, within])


def _limit(limit: Limit) -> str:
    return f"{limit.parameter} from {limit.low} to {limit.high}"


def _condition(guard: Guard) -> str:
    return (
        f"{guard.variable} {_COMPARISON[guard.comparison]} {guard.value} "
        f"(at most {guard.max_age_ms} ms old)"
    )
