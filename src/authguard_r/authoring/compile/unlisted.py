# SPDX-License-Identifier: Apache-2.0
"""Names of a site that a risk policy does not list: each weighs `otherwise`, often a second person.

Read by lint, card, draft and site check, so that no signer is surprised. Source: `eq:threshold`,
section "Risk-Adaptive Approval". Spec page: docs/spec/lint.md
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from authguard_r.authoring.compile.draft import DraftGrant, DraftRisk, DraftRow
from authguard_r.core.mission import Grant, RiskPolicy, Row
from authguard_r.site.model import Site


def unlisted(policy: RiskPolicy | DraftRisk, site: Site, grant: Grant | DraftGrant) -> list[str]:
    """Return what of a grant the policy does not list, for people.

    Args:
        policy: its weights.
        site: where the objects and regions are described; other names are left out.
        grant: what is granted.
    """
    rows: tuple[Row | DraftRow, ...] = (
        grant.alternatives if isinstance(grant, Grant) else grant.rows or ()
    )
    used = [(row.source, row.destination, *(row.regions or ())) for row in rows]
    return unlisted_names(
        policy,
        site,
        types=() if grant.type is None else (grant.type,),
        objects=(row.object for row in rows if row.object is not None),
        regions=(place for places in used for place in places if place is not None),
    )


def unlisted_names(
    policy: RiskPolicy | DraftRisk,
    site: Site,
    *,
    types: Iterable[str],
    objects: Iterable[str],
    regions: Iterable[str],
) -> list[str]:
    """Return which names the policy does not list: each once, with the first that bears it.

    Args:
        policy: its weights.
        site: where the objects and regions are described; other names are left out.
        types: action types.
        objects: objects whose class is looked up.
        regions: regions whose tags are looked up; a region without tags has the empty one.
    """
    things = {str(name): model.kind for name, model in site.objects.items()}
    places = {str(name): model.tags or ("",) for name, model in site.regions.items()}
    classes = ((things[o], o) for o in sorted({*objects} & {*things}))
    tags = ((tag, r) for r in sorted({*regions} & {*places}) for tag in places[r])
    return [
        *(f"action type `{name}`" for name in sorted({*types} - {*map(str, policy.types)})),
        *_phrases("object class", classes, policy.object_classes),
        *_phrases("region tag", tags, policy.region_tags),
    ]


def _phrases(what: str, used: Iterable[tuple[str, str]], listed: dict[str, int]) -> Iterator[str]:
    first: dict[str, str] = {}
    for name, owner in used:
        first.setdefault(name, owner)
    for name, owner in first.items():
        if name not in listed:
            yield f"{what} `{name}` (`{owner}`)"
