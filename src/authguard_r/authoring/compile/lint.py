# SPDX-License-Identifier: Apache-2.0
"""The lint: what a careful reader would ask about a mission before signing it.

The enforcer carries out what was signed, also an unguarded return to base; so the question belongs
here. No finding changes the mission. Source: section "Mission Compilation and Clarification", the
return-to-base case. Spec page: docs/spec/lint.md
"""

from __future__ import annotations

from collections.abc import Iterable

from authguard_r.authoring.compile.findings import LintFinding, LintScene, Measures, Severity, error
from authguard_r.authoring.compile.lint_bounds import BOUND_RULES
from authguard_r.authoring.compile.lint_choice import CHOICE_RULES
from authguard_r.authoring.compile.lint_matches import MATCH_RULES, contradictions
from authguard_r.authoring.compile.lint_scope import SCOPE_RULES, leaves_unguarded
from authguard_r.authoring.compile.wording import words_of
from authguard_r.authoring.compile.worst import facts_for
from authguard_r.core.mission import Mission
from authguard_r.enforcement.confirmation import LintCode
from authguard_r.site.model import Site, site_digest

DEFAULT = Measures()


def lint(mission: Mission, site: Site, measures: Measures = DEFAULT) -> tuple[LintFinding, ...]:
    """Return what a signer should look at, errors first, else in the order of the mission.

    Args:
        mission: the very structure that is to be signed; schema-valid.
        site: the site that it binds.
        measures: where the lines are drawn.
    """
    facts = facts_for(mission, site)
    if mission.site != site_digest(site) or facts is None:
        return (
            error(
                LintCode.SITE_DIFFERS,
                "site" if mission.site != site_digest(site) else "profile",
                "the mission was compiled for another site model or capability profile",
                "authguard mission compile DRAFT --site SITE: compile the draft again, and sign it",
            ),
        )
    task = words_of(mission.task)
    scene = LintScene(mission=mission, site=site, facts=facts, measures=measures, task=task)
    rules = (*SCOPE_RULES, *CHOICE_RULES, *BOUND_RULES, *MATCH_RULES)
    return _errors_first(finding for rule in rules for finding in rule(scene))


def lint_alone(mission: Mission) -> tuple[LintFinding, ...]:
    """Return the errors and warnings that need no site to be seen; far fewer than `lint` finds.

    Without its site the home region is unknown; a grant that stays open once the work is done and
    leads to a place counts as the way there.

    Args:
        mission: the very structure that is to be signed; schema-valid.
    """
    shut = (f for number in range(len(mission.actions)) for f in contradictions(mission, number))
    return _errors_first((*leaves_unguarded(mission), *shut))


def _errors_first(found: Iterable[LintFinding]) -> tuple[LintFinding, ...]:
    return tuple(sorted(found, key=lambda finding: finding.severity is not Severity.ERROR))


def errors(findings: tuple[LintFinding, ...]) -> tuple[LintCode, ...]:
    """Return the codes that a signer must accept by name, sorted."""
    return tuple(sorted({f.code for f in findings if f.severity is Severity.ERROR}))


def finding_lines(findings: tuple[LintFinding, ...]) -> list[str]:
    """Return findings for people, each with what to do, and where in the draft."""
    return [
        line
        for item in findings
        for line in (
            f"{item.severity.upper():7} {item.code} at {item.where}: {item.message}",
            f"        to do{_in_draft(item.where)}: {item.mend}",
        )
    ]


def _in_draft(where: str) -> str:
    """Return the place of a grant's finding in the draft, which has other words for two fields."""
    if not where.startswith("actions["):
        return ""
    place = where.replace("actions[", "grants[").replace("alternatives[", "rows[")
    return f" in the draft at {place}"


__all__ = [
    "LintCode",
    "LintFinding",
    "Measures",
    "Severity",
    "errors",
    "finding_lines",
    "lint",
    "lint_alone",
]
