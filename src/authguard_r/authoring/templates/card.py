# SPDX-License-Identifier: Apache-2.0
"""What the signer of a template sees: every form that every line of its missions' cards can take.

Nothing is summed up: all combinations are filled, held to the schema and linted, and their cards
are laid over each other line by line. How-to: docs/howto/templates.md
"""

from __future__ import annotations

from collections.abc import Iterator

from authguard_r.authoring.compile.card import review
from authguard_r.authoring.compile.lint import LintFinding, Severity, lint
from authguard_r.core.errors import MalformedError
from authguard_r.core.mission import Mission
from authguard_r.core.reasons import Reason
from authguard_r.enforcement.templates.expansion import combinations, filled
from authguard_r.enforcement.templates.template import (
    HoleKind,
    Template,
    holes_in,
    place_of,
    require_sound,
)
from authguard_r.site.durations import duration
from authguard_r.site.model import Site


def every_mission(template: Template) -> tuple[Mission, ...]:
    """Return the mission of every combination of values, as a signer reads it.

    Args:
        template: decoded; from anyone.

    Raises:
        MalformedError: the template is not sound, or a combination is no schema-valid mission.
    """
    require_sound(template)
    found: list[Mission] = []
    for fill in combinations(template):
        try:
            found.append(filled(template, fill))
        except MalformedError as error:
            said = ", ".join(f"{name}={value}" for name, value in fill.items())
            raise MalformedError(
                f"{error.message} (with {said})", where=error.where, reason=error.reason
            ) from error
    return tuple(found)


def require_known(template: Template, site: Site) -> None:
    """Refuse values that are no object or region of the site.

    Raises:
        MalformedError: with the hole and the value (`NAME_UNKNOWN`).
    """
    known: dict[HoleKind, frozenset[str]] = {
        HoleKind.OBJECT: frozenset(site.objects),
        HoleKind.REGION: frozenset(site.regions),
    }
    for name, hole in template.holes.items():
        for value in hole.values:
            if hole.kind in known and value not in known[hole.kind]:
                raise MalformedError(
                    f"the site has no {hole.kind} `{value}`",
                    where=f"holes.{name}.values",
                    reason=Reason.NAME_UNKNOWN,
                )


def review_template(template: Template, missions: tuple[Mission, ...], site: Site) -> list[str]:
    """Return the card's lines: the template's own, then each line of every mission of it.

    Args:
        template: sound.
        missions: all of its combinations (`every_mission`).
        site: the site that it was written for.
    """
    lines = list(_head(template, len(missions)))
    cards = [review(mission, site) for mission in missions]
    for forms in zip(*cards, strict=True):  # holes change values, never the number of lines
        distinct = list(dict.fromkeys(forms))
        if len(distinct) == 1:
            lines.append(f"  {distinct[0]}")
        else:
            lines.append(f"  {len(distinct)} forms:")
            lines += [f"  | {form}" for form in distinct]
    return lines


def lint_template(missions: tuple[Mission, ...], site: Site) -> tuple[LintFinding, ...]:
    """Return what the lint finds in any combination, each finding once, errors first."""
    found = dict.fromkeys(finding for mission in missions for finding in lint(mission, site))
    return tuple(sorted(found, key=lambda finding: finding.severity is not Severity.ERROR))


def _head(template: Template, count: int) -> Iterator[str]:
    rate = template.rate
    yield f"Template {template.template}: signed once, for at most {template.instances} missions"
    yield (
        f"  at most {rate.count} in {duration(rate.per_ms)}; each valid at most "
        f"{duration(template.for_ms)}, none after {template.not_after}"
    )
    yield "  a scheduler, not you, fills it each time; any value of a hole with any of another"
    for name, hole in sorted(template.holes.items()):
        values = ", ".join(str(value) for value in hole.values)
        yield f"  hole {name} ({hole.kind}, {len(hole.values)} values): {values}"
        places = [place_of(path) for path, other in holes_in(template) if other == name]
        yield f"    at {', '.join(places)}"
    yield f"Every one of its {count} combinations is one of these missions; each has a name of its"
    yield f"own below `{template.template}.`, a window of its own and a nonce of its own:"
