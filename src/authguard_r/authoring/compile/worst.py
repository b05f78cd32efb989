# SPDX-License-Identifier: Apache-2.0
"""How risky a row can get at all: at its farthest bounds, through every region it may touch.

Read by the lint and the card. A condition that cannot be attested counts as risky, as in
`core.risk`. Source: `eq:threshold`. Spec page: docs/spec/lint.md
"""

from __future__ import annotations

from authguard_r.core.action import Action
from authguard_r.core.errors import EnvironmentFault
from authguard_r.core.facts import SiteFacts
from authguard_r.core.mission import Grant, Limit, Mission, RiskPolicy, Row
from authguard_r.core.quantities import Now
from authguard_r.core.risk import rho
from authguard_r.site.model import Site, facts_of


def facts_for(mission: Mission, site: Site) -> SiteFacts | None:
    """Return the site as the mission's gate reads it; None when it has no such robot."""
    try:
        return facts_of(site, rid=mission.rid, profile=mission.profile)
    except EnvironmentFault:
        return None


def reach(limit: Limit) -> int:
    """Return how far from zero the bounds let a parameter get: backwards is as fast."""
    return max(abs(limit.low), abs(limit.high))


def worst_risk(
    mission: Mission,
    grant: Grant,
    row: Row,
    facts: SiteFacts,
    *,
    policy: RiskPolicy | None = None,
) -> int:
    """Return the greatest rho of any action that the row allows.

    Args:
        mission: of which the grant is.
        grant: with the bounds.
        row: of the grant.
        facts: the site as the gate reads it.
        policy: whose weights; the mission's own when absent.
    """
    action = Action(
        type=grant.type,
        tool=grant.tool,
        object=row.object,
        source=row.source,
        destination=row.destination,
        route=row.regions,
        params={limit.parameter: reach(limit) for limit in grant.limits},
    )
    weighed = mission.risk_policy if policy is None else policy
    return rho(action, weighed, state=None, facts=facts, now=Now(0, 0))
