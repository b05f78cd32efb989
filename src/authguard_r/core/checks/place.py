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
    """(6) The attested place is the action's source, and inside the row's regions.

    A pose that may lie in two regions passes only where both are allowed: nobody can say that
    the robot is not in the other one.
    """
    if case.action.source is None and not row.regions:
        return ()
    pose = case.state.snapshot.pose if case.state is not None else None
    unfit = unfit_finding(
        "state.pose",
        pose,
        state=case.state,
        rid=case.facts.robot.rid,
        now=case.now,
        max_age_ms=case.verified.mission.place_max_age_ms,
    )
    if unfit is not None:
        return (unfit,)
    place = case.state.place if case.state is not None else frozenset()
    if case.action.source is not None:
        if place == {case.action.source}:
            return ()
        return (Finding("source", Reason.SOURCE_NOT_ATTESTED, _name(place), case.action.source),)
    return outside_finding(place, row.regions)


def place_findings(
    state: AttestedState | None,
    regions: tuple[RegionId, ...],
    *,
    rid: RobotId,
    now: Now,
    max_age_ms: int,
) -> Findings:
    """Return why the robot cannot be said to be inside `regions`; used while it moves."""
    pose = state.snapshot.pose if state is not None else None
    unfit = unfit_finding("state.pose", pose, state=state, rid=rid, now=now, max_age_ms=max_age_ms)
    if unfit is not None:
        return (unfit,)
    return outside_finding(state.place if state is not None else frozenset(), regions)


def outside_finding(place: frozenset[RegionId], regions: tuple[RegionId, ...]) -> Findings:
    """Return a finding unless every region that the robot may be in is allowed."""
    if place and place.issubset(regions):
        return ()
    return (
        Finding("state.pose", Reason.OUTSIDE_REGIONS, f"within {', '.join(regions)}", _name(place)),
    )


def _name(place: frozenset[RegionId]) -> str:
    return " or ".join(sorted(place)) or "in no known region"
