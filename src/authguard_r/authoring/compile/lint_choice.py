# SPDX-License-Identifier: Apache-2.0
"""Lint rules about who decides between permissions that differ in risk.

Every row of `chooser: planner` is a permission for an attacker who controls the planner. So are
grants of one row each that are open at the same time, for the planner says which of them it asks
for. Spec page: docs/spec/lint.md
"""

from __future__ import annotations

from collections.abc import Iterator

from authguard_r.authoring.compile.conditions import can_hold
from authguard_r.authoring.compile.findings import LintFinding, LintScene, error, warning
from authguard_r.authoring.compile.lint_matches import comes_before
from authguard_r.authoring.compile.lint_scope import Rule, abandons
from authguard_r.authoring.compile.worst import worst_risk
from authguard_r.core.mission import Grant, Mission, Row
from authguard_r.core.provenance import UNTRUSTED, WIDEST, Chooser, SourceField, allowed_of
from authguard_r.enforcement.confirmation import LintCode

_MEND = (
    "let the operator or a supervisor choose among the rows of one grant, or let order (`after`, "
    "`until`) or guards keep them apart"
)
#: Choosers whose word is a signature.
_SIGNED = frozenset({Chooser.OPERATOR, Chooser.SUPERVISOR})


def planner_chooses_risk(scene: LintScene) -> Iterator[LintFinding]:
    """`chooser: planner` accepts every row, also one that an attacker picks."""
    for number, grant in enumerate(scene.mission.actions):
        if (
            grant.chooser is Chooser.PLANNER
            and len({_risk(r, grant, scene) for r in grant.alternatives}) > 1
        ):
            yield warning(
                LintCode.PLANNER_CHOOSES_RISK,
                f"actions[{number}].chooser",
                f"an attacker of the planner picks among rows of `{grant.id}` of different risk",
                _MEND,
            )


def never_set(scene: LintScene) -> Iterator[LintFinding]:
    """A planner proposes type and tool: where it may set neither, every proposal is refused."""
    mission, site = allowed_of(scene.mission.sources), allowed_of(scene.site.sources)
    for field in (SourceField.TYPE, SourceField.TOOL):
        left = mission.get(field, WIDEST[field]) & site.get(field, WIDEST[field])
        if not left & UNTRUSTED:
            whose = "the site's" if not site.get(field, UNTRUSTED) & UNTRUSTED else "the mission's"
            yield error(
                LintCode.NEVER_MATCHES,
                f"sources.{field}",
                f"no planner can set `{field}`: {whose} source set has no label of a planner's",
                f"add `model` to {whose} `sources.{field}`",
            )


def planner_chooses_grant(scene: LintScene) -> Iterator[LintFinding]:
    """Rows split into grants of their own are as open to the planner as rows that it may choose.

    Leaving the work is no choice among its rows: what must hold it back is UNGUARDED_RETURN's.
    """
    found: list[Grant] = []
    for number, grant in enumerate(scene.mission.actions):
        if abandons(grant, scene):
            continue
        for other in found:
            if _competes(other, grant, scene) and not _apart(other, grant, scene.mission):
                yield warning(
                    LintCode.PLANNER_CHOOSES_RISK,
                    f"actions[{number}]",
                    f"an attacker of the planner picks between `{other.id}` and `{grant.id}`, "
                    "which differ in risk",
                    _MEND,
                )
        found.append(grant)


def _competes(one: Grant, other: Grant, scene: LintScene) -> bool:
    """True when the planner can ask for either, from one place, and they differ in risk."""
    if (one.type, one.tool) != (other.type, other.tool) or not (_is_free(one) and _is_free(other)):
        return False
    return any(
        _is_choice(a, b) and _risk(a, one, scene) != _risk(b, other, scene)
        for a in one.alternatives
        for b in other.alternatives
    )


def _is_free(grant: Grant) -> bool:
    """True when no signature stands between the planner and a row: one row needs no choice."""
    return len(grant.alternatives) == 1 or grant.chooser not in _SIGNED


def _is_choice(one: Row, other: Row) -> bool:
    """True when the planner can have either row: from one place, or by going to the other first.

    A way goes on where another ended, and one object is where it is: that is no choice.
    """
    if one.source == other.source:
        return True
    return one.destination is None and (one.object is None or one.object != other.object)


def _apart(one: Grant, other: Grant, mission: Mission) -> bool:
    """True when the two are never open together."""
    if not can_hold((*mission.guards, *one.guards, *other.guards)):
        return True
    return _is_over(one, other, mission) or _is_over(other, one, mission)


def _is_over(one: Grant, other: Grant, mission: Mission) -> bool:
    """True when one is closed before the other opens: used up, or ended by what must come first."""
    before = comes_before(mission, other.id)
    if other.id in before:
        return True  # it waits for itself and never opens
    return (one.id in before and one.repeat == 1) or not before.isdisjoint(one.until)


def _risk(row: Row, grant: Grant, scene: LintScene) -> tuple[int, frozenset[str], str]:
    """Return what makes rows differ in risk: the score, the regions' tags, the object's class."""
    regions = scene.facts.regions
    tags = frozenset(tag for r in row.regions if r in regions for tag in regions[r].tags)
    kind = "" if row.object is None else scene.facts.objects.get(row.object, "")
    return worst_risk(scene.mission, grant, row, scene.facts), tags, kind


CHOICE_RULES: tuple[Rule, ...] = (never_set, planner_chooses_risk, planner_chooses_grant)
