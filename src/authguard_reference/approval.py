# SPDX-License-Identifier: Apache-2.0
"""Approval: step 7 of `alg:authguard`; docs/spec/approval.md."""

from typing import Any

from authguard_reference.chain import canonical, digest
from authguard_reference.people import people_behind
from authguard_reference.place import guard_finding
from authguard_reference.risk import required_of, rho, tier_of

Json = dict[str, Any]


def scope_of(action: Json) -> str:
    """Compute the digest of the action without provenance and meta.

    Args:
        action: The normalized action.

    Returns:
        The scope digest.
    """
    scope: Json = {"type": action["type"], "tool": action["tool"]}
    for field in ("object", "source", "destination"):
        if field in action:
            scope[field] = action[field]
    for field in ("route", "params"):
        if action.get(field):  # left out when empty
            scope[field] = action[field]
    return digest("authguard-r/action-scope/1", canonical(scope))


def situation_of(
    mission: Json, grant: Json, tier: int, *, state: Json | None, facts: Json, now: Json
) -> str:
    """Compute the digest of the truth of all guards and the tier.

    Args:
        mission: The mission.
        grant: The matched grant.
        tier: The tier of now.
        state: The snapshot with its arrival, or None.
        facts: The facts of the site and the robot.
        now: The two clocks.

    Returns:
        The situation digest.
    """
    guards = [*mission.get("guards", []), *grant.get("guards", [])]
    truths = [guard_finding(guard, state, facts, now) == "" for guard in guards]
    return digest("authguard-r/situation/1", canonical({"guards": truths, "tier": tier}))


def inside(scope: Json, robot: str, places: list[str]) -> bool:
    """Decide whether a certificate reaches a robot and places; null reaches every one.

    Args:
        scope: The robots and the regions that it names.
        robot: The robot.
        places: The regions that the action names.

    Returns:
        True when it reaches all of them.
    """
    if scope["robots"] is not None and robot not in scope["robots"]:
        return False
    if scope["regions"] is None:
        return True
    return all(place in scope["regions"] for place in places)


def places_of(action: Json) -> list[str]:
    """Collect the regions that an action names: source, destination and way.

    Args:
        action: The normalized action.

    Returns:
        The regions.
    """
    ends = [action[field] for field in ("source", "destination") if field in action]
    return [*ends, *action.get("route", [])]


def policies_of(mission: Json, facts: Json) -> list[Json]:
    """Collect the policies that each have to be satisfied.

    Args:
        mission: The mission.
        facts: The facts, with the organization's policies.

    Returns:
        The mission's policy, then the organization's.
    """
    return [mission["risk_policy"], *facts.get("risk", [])]


def fits(
    answer: Json,
    expected: Json,
    mission: Json,
    *,
    policies: list[Json],
    action: Json,
    now: Json,
) -> bool:
    """Decide whether an authentic answer fits the open request.

    Args:
        answer: The approval and its approver.
        expected: What the approval must say, by field.
        mission: The mission, for its issuer.
        policies: The policies, for the roles that each of them wants.
        action: The action, for the places that the approver must reach.
        now: The two clocks.

    Returns:
        True when it fits.
    """
    approval, approver = answer["approval"], answer["approver"]
    return (
        all(approval[field] == value for field, value in expected.items())
        and now["utc_ms"] <= approval["expires_ms"]
        and now["utc_ms"] <= approver["usable_until_ms"]
        and all(approver["role"] in policy["roles"] for policy in policies)
        and approver["id"] != mission["issuer"]
        and inside(approver["scope"], expected["rid"], places_of(action))
    )


def approval_finding(
    expected: Json,
    request: Json | None,
    *,
    required: int,
    mission: Json,
    issuer: Json,
    policies: list[Json],
    action: Json,
    approvals: list[Json],
    now: Json,
    prompts: int,
) -> str:
    """Carry out step 7 for the matched grant.

    Args:
        expected: mid, version, mission digest, rid, grant, scope and situation of now.
        request: The grant's open request, or None.
        required: Req(a, s).
        mission: The mission.
        issuer: Its issuer, with the members and the threshold of a group.
        policies: The policies that each have to be satisfied.
        action: The normalized action.
        approvals: The authentic answers.
        now: The two clocks.
        prompts: How often people were asked so far.

    Returns:
        The reason code, or "" when the step passes.
    """
    if required <= 1:
        return ""
    if (
        request is None
        or request["scope"] != expected["scope"]
        or request["situation"] != expected["situation"]
    ):
        exhausted = prompts >= mission["budgets"].get("prompts", 0)
        return "BUDGET_EXCEEDED" if exhausted else "APPROVAL_REQUIRED"
    expected = {**expected, "counter": request.get("counter", 0)}
    if request.get("denied", False):  # when it came in; nothing undoes it
        return "APPROVAL_DENIED"
    if now["utc_ms"] > request["expires_ms"]:
        return "APPROVAL_TIMEOUT"
    seen: Json = {"policies": policies, "action": action, "now": now}
    fitting = [answer for answer in approvals if fits(answer, expected, mission, **seen)]
    if any(answer["approval"]["verdict"] == "deny" for answer in fitting):
        return "APPROVAL_DENIED"
    if people_behind([answer["approver"] for answer in fitting], issuer) >= required:
        return ""
    return "APPROVAL_REQUIRED"


def is_covered(
    mission: Json,
    digest: str,
    grant: Json,
    row: int,
    *,
    risk: int,
    required: int,
    policies: list[Json],
    item: Json,
    issuer: Json,
    action: Json,
    robot: Json,
    now: Json,
    standing: Json | None,
) -> bool:
    """Decide whether a pre-approval covers an action of the second line of `eq:threshold`.

    Args:
        mission: The mission.
        digest: Its digest.
        grant: The matched grant.
        row: The index of its row.
        risk: rho(a, s).
        required: Req(a, s).
        policies: The policies, for the roles that each of them wants.
        item: The pre-approval, its digest and its approver.
        issuer: The mission's issuer.
        action: The normalized action.
        robot: The gate's own robot.
        now: The two clocks.
        standing: The standing, or None.

    Returns:
        True when it does.
    """
    said, approver = item["preapproval"], item["approver"]
    expected = binding_of(mission, digest, grant, action, robot=robot)
    del expected["scope"]
    left = (standing or {}).get("preapproved", {}).get(item["digest"], 0)
    return (
        all(said[field] == value for field, value in expected.items())
        and row in said["rows"]
        and risk <= said["most_risk"]
        and left > 0
        and now["utc_ms"] <= said["expires_ms"]
        and now["utc_ms"] <= approver["usable_until_ms"]
        and all(approver["role"] in policy["roles"] for policy in policies)
        and approver["id"] != mission["issuer"]
        and inside(approver["scope"], robot["rid"], places_of(action))
        and people_behind([approver], issuer) >= required
    )


def binding_of(mission: Json, digest: str, grant: Json, action: Json, *, robot: Json) -> Json:
    """Collect what an approval must bind, situation and counter left aside.

    Args:
        mission: The mission.
        digest: The mission's digest.
        grant: The matched grant.
        action: The normalized action.
        robot: The gate's own robot.

    Returns:
        The fields of the approval.
    """
    return {
        "mid": mission["mid"],
        "version": mission["version"],
        "mission": digest,
        "rid": robot["rid"],
        "grant": grant["id"],
        "scope": scope_of(action),
    }


def strictest(
    policies: list[Json], action: Json, state: Json | None, *, facts: Json, now: Json
) -> tuple[int, int, int]:
    """Return Req(a, s), the tier and rho(a, s) of the policy that requires most."""
    scores = [(policy, rho(policy, action, state, facts, now)) for policy in policies]
    levels = [(policy, tier_of(policy, score), score) for policy, score in scores]
    return max((required_of(policy, level), level, score) for policy, level, score in levels)


def step_7(
    mission: Json,
    digest: str,
    grant: Json,
    row: int,
    *,
    action: Json,
    state: Json | None,
    facts: Json,
    now: Json,
    standing: Json | None,
    approvals: list[Json],
    preapprovals: list[Json],
    issuer: Json | None = None,
) -> tuple[list[str], int, int, str | None]:
    """Carry out step 7, approval, for the matched grant.

    Args:
        mission: The mission.
        digest: The mission's digest.
        grant: The matched grant.
        row: The index of its row.
        action: The normalized action.
        state: The snapshot, or None.
        facts: The facts.
        now: The two clocks.
        standing: The standing, or None.
        approvals: The authentic answers.
        preapprovals: What was agreed to before the question.
        issuer: The issuer as its certificate names it; None for one person.

    Returns:
        At most one violation, Req(a, s), rho(a, s) and the digest of the pre-approval that stands
        in for the approvals, or None.
    """
    policies = policies_of(mission, facts)
    issuer = issuer or {"id": mission["issuer"]}
    required, tier, risk = strictest(policies, action, state, facts=facts, now=now)
    expected = binding_of(mission, digest, grant, action, robot=facts["robot"])
    expected["situation"] = situation_of(mission, grant, tier, state=state, facts=facts, now=now)
    request = None if standing is None else standing.get("requests", {}).get(grant["id"])
    finding = approval_finding(
        expected,
        request,
        required=required,
        mission=mission,
        issuer=issuer,
        policies=policies,
        action=action,
        approvals=approvals,
        now=now,
        prompts=0 if standing is None else standing.get("prompts", 0),
    )
    if finding not in ("", "APPROVAL_DENIED") and tier == 2 and not (request or {}).get("denied"):
        seen: Json = {"policies": policies, "action": action, "now": now, "standing": standing}
        seen |= {"issuer": issuer, "robot": facts["robot"], "risk": risk, "required": required}
        for item in preapprovals:
            if is_covered(mission, digest, grant, row, item=item, **seen):
                return [], required, risk, item["digest"]
    return ([finding] if finding != "" else []), required, risk, None
