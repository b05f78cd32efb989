# SPDX-License-Identifier: Apache-2.0
"""Permission is a lease, not a fact: what a release permits, where, and for how long.

A robot moves for seconds after a decision. `still` asks the same conditions again on every state
update and at least every 100 ms; any finding cancels the action and stops the robot. Spec page:
docs/spec/lease.md
"""

from __future__ import annotations

from msgspec import Struct

from authguard_r.core.action import Action
from authguard_r.core.checks.guards import guard_finding, unfit_finding
from authguard_r.core.checks.mission import registry_findings
from authguard_r.core.checks.place import place_findings
from authguard_r.core.facts import SiteFacts
from authguard_r.core.finding import Finding, Findings, in_paper_order
from authguard_r.core.identifiers import Digest, GrantId, MissionId, RegionId, RobotId, VariableId
from authguard_r.core.mission import Grant, Guard, Row
from authguard_r.core.quantities import Now, to_timestamp
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Standing
from authguard_r.core.state import AttestedState
from authguard_r.core.token import VerifiedMission


class Bound(Struct, frozen=True):
    """An attested variable that may not exceed what the action asked for."""

    variable: VariableId
    high: int


class Lease(Struct, frozen=True, kw_only=True):
    """What one release permits.

    Args:
        mid: the mission.
        version: its version; another version ends the lease.
        digest: the signed bytes' digest.
        grant: the grant that matched.
        ticket: digest of the released action.
        until_utc_ms: the mission's end.
        until_mono_ms: the grant's longest lease, on the monotonic clock.
        regions: where the robot must stay; empty for an action without a place.
        bounds: monitored parameters.
        guards: the mission's and the grant's.
        max_age_ms: how old the place and the monitored values may be.
    """

    mid: MissionId
    version: int
    digest: Digest
    grant: GrantId
    ticket: Digest
    until_utc_ms: int
    until_mono_ms: int
    regions: tuple[RegionId, ...]
    bounds: tuple[Bound, ...]
    guards: tuple[Guard, ...]
    max_age_ms: int


def permit(
    verified: VerifiedMission,
    action: Action,
    *,
    grant: Grant,
    row: Row,
    facts: SiteFacts,
    now: Now,
    ticket: Digest,
) -> Lease:
    """Return the lease of an accepted action; the caller has the decision."""
    kinds, params = facts.vocabulary[action.type].params, action.params
    monitored = [(kinds[name].monitored_by, high) for name, high in params.items() if name in kinds]
    return Lease(
        mid=verified.mission.mid,
        version=verified.mission.version,
        digest=verified.digest,
        grant=grant.id,
        ticket=ticket,
        until_utc_ms=verified.expiry_ms,
        until_mono_ms=now.mono_ms + grant.max_ms,
        regions=row.regions,
        bounds=tuple([Bound(which, high) for which, high in monitored if which is not None]),
        guards=(*verified.mission.guards, *grant.guards),
        max_age_ms=verified.mission.place_max_age_ms,
    )


def still(
    lease: Lease,
    state: AttestedState | None,
    *,
    facts: SiteFacts,
    now: Now,
    standing: Standing | None,
) -> Findings:
    """Return why the robot may not go on, empty while it may."""
    found = [
        *time_findings(lease, now),
        *registry_findings(standing, mid=lease.mid, version=lease.version, digest=lease.digest),
    ]
    rid = facts.robot.rid
    if lease.regions:
        found += place_findings(
            state,
            lease.regions,
            reason=Reason.OUTSIDE_REGIONS,
            rid=rid,
            now=now,
            max_age_ms=lease.max_age_ms,
        )
    guards = [guard_finding(guard, state, rid, now) for guard in lease.guards]
    found += [finding for finding in guards if finding is not None]
    for bound in lease.bounds:
        found += bound_findings(bound, state, rid=rid, now=now, max_age_ms=lease.max_age_ms)
    return in_paper_order(tuple(found)) if found else ()


def time_findings(lease: Lease, now: Now) -> Findings:
    """Return why a lease has ended by itself."""
    found: list[Finding] = []
    if now.utc_ms > lease.until_utc_ms:
        at, got = to_timestamp(lease.until_utc_ms), to_timestamp(now.utc_ms)
        found.append(Finding("now", Reason.EXPIRED, f"at most {at}", got))
    if now.mono_ms > lease.until_mono_ms:
        late = f"{now.mono_ms - lease.until_mono_ms} ms later"
        found.append(Finding("lease", Reason.LEASE_ENDED, "in its time", late))
    return tuple(found)


def bound_findings(
    bound: Bound, state: AttestedState | None, *, rid: RobotId, now: Now, max_age_ms: int
) -> Findings:
    """Return why an attested variable is not known to keep to its bound."""
    field = f"state.{bound.variable}"
    reading = state.snapshot.readings.get(bound.variable) if state is not None else None
    unfit = unfit_finding(field, reading, state, rid=rid, now=now, max_age_ms=max_age_ms)
    if unfit is not None:
        return (unfit,)
    value = reading.value if reading is not None else None
    beyond = Finding(field, Reason.BOUND_EXCEEDED, f"at most {bound.high}", str(value))
    return () if type(value) is int and value <= bound.high else (beyond,)
