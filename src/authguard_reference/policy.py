# SPDX-License-Identifier: Apache-2.0
"""The decision: `alg:authguard` as docs/spec/decision.md has it; Auth of `eq:auth-predicate`.

Step 7 is in `approval` and `risk`, the grants and rows of step 6 in `grants`.
"""

from datetime import UTC, datetime, timedelta
from typing import Any

from authguard_reference.approval import step_7
from authguard_reference.grants import match
from authguard_reference.place import guards_findings
from authguard_reference.reasons import in_order
from authguard_reference.sources import label_of_signer
from authguard_reference.standing import STATUS_REFUSAL

Json = dict[str, Any]


def instant_ms(text: str) -> int:
    """Turn an RFC 3339 UTC time in whole seconds into milliseconds.

    Args:
        text: For example 2026-01-31T08:00:00Z.

    Returns:
        Milliseconds since 1970.
    """
    moment = datetime.strptime(text, "%Y-%m-%dT%H:%M:%SZ").replace(tzinfo=UTC)
    return (moment - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(milliseconds=1)


def time_findings(mission: Json, now: Json) -> list[str]:
    """Carry out step 3, time.

    Args:
        mission: The mission.
        now: The two clocks.

    Returns:
        Every violation.
    """
    found: list[str] = []
    if now["utc_ms"] < instant_ms(mission["not_before"]):
        found.append("NOT_YET_VALID")
    if now["utc_ms"] > instant_ms(mission["expiry"]):
        found.append("EXPIRED")
    return found


def registry_findings(mission: Json, digest: str, standing: Json | None) -> list[str]:
    """Carry out step 4, registry: the first that applies.

    Args:
        mission: The mission.
        digest: The mission's digest.
        standing: The standing, or None.

    Returns:
        At most one violation.
    """
    if standing is None or standing["mid"] != mission["mid"]:
        return ["MISSION_UNKNOWN"]
    if standing["digest"] != digest:
        if standing["version"] > mission["version"]:
            return ["SUPERSEDED"]
        return ["MISSION_UNKNOWN"]
    refusal = STATUS_REFUSAL[standing["status"]]
    return [refusal] if refusal != "" else []


def robot_findings(mission: Json, facts: Json) -> list[str]:
    """Carry out step 5, robot: each by itself.

    Args:
        mission: The mission.
        facts: The facts of the site and the robot.

    Returns:
        Every violation.
    """
    found: list[str] = []
    if mission["rid"] != facts["robot"]["rid"]:
        found.append("ROBOT_MISMATCH")
    if mission["profile"] != facts["robot"]["profile"]:
        found.append("PROFILE_MISMATCH")
    if mission["site"] != facts["digest"]:
        found.append("SITE_MISMATCH")
    return found


def meta_findings(mission: Json, action: Json) -> list[str]:
    """Check that the metadata names no other mission or version.

    Args:
        mission: The mission.
        action: The normalized action.

    Returns:
        At most one violation.
    """
    meta = action.get("meta", {})
    other_mission = "mission" in meta and meta["mission"] != mission["mid"]
    other_version = "mission_version" in meta and meta["mission_version"] != mission["version"]
    return ["META_MISMATCH"] if other_mission or other_version else []


def capability_findings(action: Json, facts: Json) -> list[str]:
    """Check that the robot can do this type with this tool at all.

    Args:
        action: The normalized action.
        facts: The facts of the site and the robot.

    Returns:
        At most one violation.
    """
    tools = facts["robot"]["tools"]
    kind = action["type"]
    if kind not in facts["vocabulary"]:
        return ["CAPABILITY_EXCEEDED"]
    if facts["vocabulary"][kind].get("state_writing", False):
        return ["CAPABILITY_EXCEEDED"]
    if kind not in tools or action["tool"] not in tools[kind]:
        return ["CAPABILITY_EXCEEDED"]
    return []


def ceiling_findings(mission: Json, action: Json) -> list[str]:
    """Check the mission's objects, regions and limits.

    Args:
        mission: The mission.
        action: The normalized action.

    Returns:
        Every violation.
    """
    found: list[str] = []
    regions = mission.get("regions", [])
    if "object" in action and action["object"] not in mission.get("objects", []):
        found.append("OBJECT_OUT_OF_SCOPE")
    if "source" in action and action["source"] not in regions:
        found.append("SOURCE_OUT_OF_SCOPE")
    if "destination" in action and action["destination"] not in regions:
        found.append("DESTINATION_OUT_OF_SCOPE")
    found += ["ROUTE_OUT_OF_SCOPE" for entry in action.get("route", []) if entry not in regions]
    params = action.get("params", {})
    for limit in mission.get("limits", []):
        name = limit["parameter"]
        if name in params and not limit["low"] <= params[name] <= limit["high"]:
            found.append("PARAMETER_OUT_OF_BOUNDS")
    return found


def verdict_of(reasons: list[str]) -> str:
    """Carry out step 9.

    Args:
        reasons: All findings.

    Returns:
        accept, request_approval or reject.
    """
    if reasons == []:
        return "accept"
    if reasons == ["APPROVAL_REQUIRED"]:
        return "request_approval"
    return "reject"


def mission_findings(
    mission: Json, action: Json, state: Json | None, facts: Json, now: Json
) -> list[str]:
    """Carry out step 6, policy, of the mission.

    Args:
        mission: The mission.
        action: The normalized action.
        state: The snapshot with its arrival, or None.
        facts: The facts of the site and the robot.
        now: The two clocks.

    Returns:
        Every violation.
    """
    found = meta_findings(mission, action)
    found += capability_findings(action, facts)
    found += ceiling_findings(mission, action)
    found += guards_findings(mission.get("guards", []), state, facts, now)
    return found


def decide(
    mission: Json,
    *,
    digest: str,
    usable_until_ms: int,
    action: Json,
    state: Json | None,
    facts: Json,
    now: Json,
    standing: Json | None,
    approvals: list[Json],
    preapprovals: list[Json] | None = None,
    issuer: Json | None = None,
) -> Json:
    """Decide on one action: `alg:authguard`.

    Args:
        mission: The mission.
        digest: The mission's digest.
        usable_until_ms: When the issuer's certificate or revocation list ends.
        action: The normalized action.
        state: The snapshot with its arrival, or None.
        facts: The facts of the site and the robot.
        now: The two clocks.
        standing: The standing, or None.
        approvals: The authentic answers.
        preapprovals: Authentic pre-approvals.
        issuer: The issuer as its certificate names it; None for one person.

    Returns:
        Verdict, reasons in ORDER, grant id, row index, required approvals, risk and the digest of
        the pre-approval that an acceptance rests on.
    """
    if now["utc_ms"] > usable_until_ms:  # step 1
        return {**result(["CERTIFICATE_EXPIRED"], None, None, None, None), "preapproved": None}
    found = time_findings(mission, now)  # step 3
    found += registry_findings(mission, digest, standing)  # step 4
    found += robot_findings(mission, facts)  # step 5
    found += mission_findings(mission, action, state, facts, now)  # step 6, of the mission
    seen: Json = {"action": action, "state": state, "facts": facts, "now": now}
    label = label_of_signer((issuer or {}).get("role", "operator"))
    grant, row, of_match = match(mission, standing=standing, issuer=label, **seen)  # step 6
    said: Json = {"approvals": approvals, "preapprovals": preapprovals or []}
    of_approval, required, risk, used = step_7(
        mission, digest, grant, row, standing=standing, issuer=issuer, **said, **seen
    )
    decided = result(found + of_match + of_approval, grant["id"], row, required, risk)  # step 9
    return {**decided, "preapproved": used if decided["verdict"] == "accept" else None}


def result(
    found: list[str], grant: str | None, row: int | None, required: int | None, risk: int | None
) -> Json:
    """Put a decision together.

    Args:
        found: All findings, repeats included.
        grant: The id of the matched grant, or None.
        row: The index of its row, or None.
        required: Req(a, s), or None.
        risk: rho(a, s), or None.

    Returns:
        The decision.
    """
    reasons = in_order(found)
    return {
        "verdict": verdict_of(reasons),
        "reasons": reasons,
        "grant": grant,
        "row": row,
        "required": required,
        "risk": risk,
    }


def authorized(mission: Json, **given: Any) -> bool:
    """Compute Auth(M, a, s, t) of `eq:auth-predicate`.

    Args:
        mission: As for decide.
        **given: All the rest of decide's arguments.

    Returns:
        True when the verdict is accept.
    """
    return bool(decide(mission, **given)["verdict"] == "accept")
