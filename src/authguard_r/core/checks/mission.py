# SPDX-License-Identifier: Apache-2.0
"""Checks of the mission itself: steps 1 to 5, and the ceilings of step 6.

Steps 1 to 3 were done when the token was verified (`core.token`); what can change afterwards,
the certificates' end and the clock, is checked again for every action.
"""

from __future__ import annotations

from authguard_r.core.checks.case import Case
from authguard_r.core.checks.guards import guard_finding
from authguard_r.core.facts import SiteFacts
from authguard_r.core.finding import Finding, Findings
from authguard_r.core.identifiers import Digest, MissionId
from authguard_r.core.lifecycle import REFUSAL
from authguard_r.core.mission import Mission
from authguard_r.core.quantities import to_timestamp
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Standing


def check_certificate(case: Case) -> Findings:
    """(1) The issuer's certificates and revocation list are still in time."""
    until, now = case.verified.issuer.usable_until_ms, case.now.utc_ms
    if now <= until:
        return ()
    expected, got = f"at most {to_timestamp(until)}", to_timestamp(now)
    return (Finding("mission.issuer", Reason.CERTIFICATE_EXPIRED, expected, got),)


def check_time(case: Case) -> Findings:
    """(3) not_before <= t <= expiry; t = expiry is still in time, as in the paper."""
    verified, now = case.verified, case.now.utc_ms
    if now < verified.not_before_ms:
        reason, expected = Reason.NOT_YET_VALID, f"at least {verified.mission.not_before}"
    elif now > verified.expiry_ms:
        reason, expected = Reason.EXPIRED, f"at most {verified.mission.expiry}"
    else:
        return ()
    return (Finding("now", reason, expected, to_timestamp(now)),)


def check_registry(case: Case) -> Findings:
    """(4) The registry knows this very version, and it is active (or closing)."""
    mission = case.verified.mission
    return registry_findings(
        case.standing, mid=mission.mid, version=mission.version, digest=case.verified.digest
    )


def registry_findings(
    standing: Standing | None, *, mid: MissionId, version: int, digest: Digest
) -> Findings:
    """Return why the registry's entry authorizes nothing; the lease asks this too."""
    if standing is None or standing.mid != mid:
        reason, got = Reason.MISSION_UNKNOWN, "no entry"
    elif standing.digest != digest:
        newer = standing.version > version
        reason = Reason.SUPERSEDED if newer else Reason.MISSION_UNKNOWN
        got = f"version {standing.version}"
    elif standing.status in REFUSAL:
        reason, got = REFUSAL[standing.status], str(standing.status)
    else:
        return ()
    return (Finding("mission", reason, f"`{mid}` version {version} active", got),)


def check_robot(case: Case) -> Findings:
    """(5) The mission names this robot, its capability profile and this site."""
    return binding_findings(case.verified.mission, case.facts)


def binding_findings(mission: Mission, facts: SiteFacts) -> Findings:
    """Return which of robot, profile and site is not the gate's own; activation asks this too."""
    robot = facts.robot
    if (mission.rid, mission.profile, mission.site) == (robot.rid, robot.profile, facts.digest):
        return ()
    held = (
        ("mission.rid", Reason.ROBOT_MISMATCH, mission.rid, robot.rid),
        ("mission.profile", Reason.PROFILE_MISMATCH, mission.profile, robot.profile),
        ("mission.site", Reason.SITE_MISMATCH, mission.site, facts.digest),
    )
    return tuple(
        Finding(field, reason, str(signed), str(local))
        for field, reason, signed, local in held
        if signed != local
    )


def check_meta(case: Case) -> Findings:
    """(6) The action was taken in under this version; an update in between makes it another."""
    meta, mission = case.action.meta, case.verified.mission
    if meta is None or (meta.mission == mission.mid and meta.mission_version == mission.version):
        return ()
    expected = f"{mission.mid} version {mission.version}"
    got = f"{meta.mission} version {meta.mission_version}"
    return (Finding("meta.mission", Reason.META_MISMATCH, expected, got),)


def check_capability(case: Case) -> Findings:
    """(6) The robot's profile can do this type with this tool, and the type can be granted."""
    action = case.action
    tools = case.facts.robot.tools.get(action.type)
    if case.kind is None or case.kind.state_writing or tools is None:
        field, expected, got = "type", "a type that this robot can do", str(action.type)
    elif action.tool not in tools:
        field, expected, got = "tool", " or ".join(sorted(tools)), str(action.tool)
    else:
        return ()
    return (Finding(field, Reason.CAPABILITY_EXCEEDED, expected, got),)


def check_ceilings(case: Case) -> Findings:
    """(6) Object, places and parameters lie under the mission-wide ceilings."""
    action, verified = case.action, case.verified
    found: list[Finding] = []
    if action.object is not None and action.object not in verified.objects:
        found.append(_outside("object", Reason.OBJECT_OUT_OF_SCOPE, action.object))
    source, destination, regions = action.source, action.destination, verified.regions
    if source is not None and source not in regions:
        found.append(_outside("source", Reason.SOURCE_OUT_OF_SCOPE, source))
    if destination is not None and destination not in regions:
        found.append(_outside("destination", Reason.DESTINATION_OUT_OF_SCOPE, destination))
    for number, region in enumerate(action.route):
        if region not in regions:
            found.append(_outside(f"route[{number}]", Reason.ROUTE_OUT_OF_SCOPE, region))
    for parameter, limit in verified.limits.items():
        value = action.params.get(parameter, limit.low)
        if not limit.low <= value <= limit.high:
            field, expected = f"params.{parameter}", f"{limit.low} to {limit.high} in this mission"
            found.append(Finding(field, Reason.PARAMETER_OUT_OF_BOUNDS, expected, str(value)))
    return tuple(found)


def check_mission_guards(case: Case) -> Findings:
    """(6) Every mission-wide guard holds on attested, fresh state."""
    rid = case.facts.robot.rid
    found = [guard_finding(g, case.state, rid, case.now) for g in case.verified.mission.guards]
    return tuple([finding for finding in found if finding is not None])


def _outside(field: str, reason: Reason, got: str) -> Finding:
    return Finding(field, reason, "inside the mission's ceilings", got)
