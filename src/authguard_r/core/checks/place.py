# SPDX-License-Identifier: Apache-2.0
"""Where the robot really is, held against where the action says it starts."""

from __future__ import annotations

from authguard_r.core.checks.case import Case
from authguard_r.core.checks.guards import unfit_finding
from authguard_r.core.finding import Finding, Findings
from authguard_r.core.identifiers import RegionId, RobotId
from authguard_r.core.mission import Row
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.core.state import AttestedState


def check_place(case: Case, row: Row) -> Findings:
    """(6) The attested place is the action's source, or else inside the row's regions."""
    source = case.action.source
    if source is None and not row.regions:
        return ()
    return place_findings(
        case.state,
        row.regions if source is None else (source,),
        reason=Reason.OUTSIDE_REGIONS if source is None else Reason.SOURCE_NOT_ATTESTED,
        rid=case.facts.robot.rid,
        now=case.now,
        max_age_ms=case.verified.mission.place_max_age_ms,
    )


def place_findings(
    state: AttestedState | None,
    regions: tuple[RegionId, ...],
    *,
    reason: Reason,
    rid: RobotId,
    now: Now,
    max_age_ms: int,
) -> Findings:
    """Return why the robot cannot be said to be inside `regions`.

    A pose that may lie in two regions passes only where both are allowed: the robot may be in
    either.
    """
    pose = state.snapshot.pose if state is not None else None
    unfit = unfit_finding("state.pose", pose, state, rid=rid, now=now, max_age_ms=max_age_ms)
    if unfit is not None:
        return (unfit,)
    place = state.place if state is not None else frozenset[RegionId]()
    if place and place.issubset(regions):
        return ()
    found = " or ".join(sorted(place)) or "in no known region"
    return (Finding("state.pose", reason, f"within {', '.join(regions)}", found),)
