# SPDX-License-Identifier: Apache-2.0
"""The lease: `eq:trace-auth` asked again while the action runs; docs/spec/lease.md."""

from typing import Any

from authguard_reference.place import guards_findings, place_of, pose_of, reading_of, unfit
from authguard_reference.policy import instant_ms
from authguard_reference.reasons import in_order
from authguard_reference.standing import STATUS_REFUSAL

Json = dict[str, Any]


def permit(
    mission: Json, digest: str, grant: Json, row: Json, action: Json, *, facts: Json, now: Json
) -> Json:
    """Put the lease of a release together.

    Args:
        mission: The mission.
        digest: The mission's digest.
        grant: The matched grant.
        row: Its matched row.
        action: The normalized action.
        facts: The facts of the site and the robot.
        now: The two clocks of the release.

    Returns:
        The lease, as `still` reads it.
    """
    kinds = facts["vocabulary"][action["type"]]["params"]
    bounds: list[Json] = []
    for parameter, value in action.get("params", {}).items():
        variable = kinds.get(parameter, {}).get("monitored_by")
        if variable is not None:
            bounds.append({"variable": variable, "high": value})
    return {
        "mid": mission["mid"],
        "version": mission["version"],
        "digest": digest,
        "until_utc_ms": instant_ms(mission["expiry"]),
        "until_mono_ms": now["mono_ms"] + grant["max_ms"],
        "regions": row.get("regions", []),
        "bounds": bounds,
        "guards": [*mission.get("guards", []), *grant.get("guards", [])],
        "max_age_ms": mission.get("place_max_age_ms", 0),
    }


def still(
    lease: Json, state: Json | None, *, facts: Json, now: Json, standing: Json | None
) -> list[str]:
    """Ask whether a released action may go on.

    Args:
        lease: The lease of the release.
        state: The snapshot with its arrival, or None.
        facts: The facts of the site and the robot.
        now: The two clocks.
        standing: The standing, or None.

    Returns:
        The reasons why it may not, unique, in ORDER; empty when it may.
    """
    found: list[str] = []
    if now["utc_ms"] > lease["until_utc_ms"]:
        found.append("EXPIRED")
    if now["mono_ms"] > lease["until_mono_ms"]:
        found.append("LEASE_ENDED")
    found.append(standing_finding(lease, standing))
    found.append(place_finding(lease, state, facts, now))
    found += guards_findings(lease.get("guards", []), state, facts, now)
    for bound in lease.get("bounds", []):
        found.append(bound_finding(bound, lease["max_age_ms"], state, facts, now))
    return in_order(found)  # which drops the "" of what holds


def standing_finding(lease: Json, standing: Json | None) -> str:
    """Check the standing: the first that applies.

    Args:
        lease: The lease of the release.
        standing: The standing, or None.

    Returns:
        The reason code, or "".
    """
    if standing is None or standing["mid"] != lease["mid"]:
        return "MISSION_UNKNOWN"
    if standing["digest"] != lease["digest"]:
        return "SUPERSEDED" if standing["version"] > lease["version"] else "MISSION_UNKNOWN"
    return STATUS_REFUSAL[standing["status"]]


def place_finding(lease: Json, state: Json | None, facts: Json, now: Json) -> str:
    """Check the place, if the row has regions.

    Args:
        lease: The lease of the release.
        state: The snapshot with its arrival, or None.
        facts: The facts of the site and the robot.
        now: The two clocks.

    Returns:
        The reason code, or "".
    """
    regions = lease.get("regions", [])
    if regions == []:
        return ""
    pose = pose_of(state)
    finding = unfit(pose, lease["max_age_ms"], state, facts, now)
    if finding != "" or pose is None:
        return finding
    place = place_of(pose, facts)
    if place == set() or not place <= set(regions):
        return "OUTSIDE_REGIONS"
    return ""


def bound_finding(bound: Json, max_age_ms: int, state: Json | None, facts: Json, now: Json) -> str:
    """Check one monitored parameter.

    Args:
        bound: The variable and the released value.
        max_age_ms: The age that is allowed.
        state: The snapshot with its arrival, or None.
        facts: The facts of the site and the robot.
        now: The two clocks.

    Returns:
        The reason code, or "".
    """
    reading = reading_of(bound["variable"], state)
    finding = unfit(reading, max_age_ms, state, facts, now)
    if finding != "" or reading is None:
        return finding
    if type(reading["value"]) is not int or reading["value"] > bound["high"]:
        return "BOUND_EXCEEDED"
    return ""
