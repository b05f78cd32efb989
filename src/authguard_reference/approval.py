# SPDX-License-Identifier: Apache-2.0
"""Approval: step 7 of `alg:authguard`; docs/spec/approval.md."""

from typing import Any

from authguard_reference.chain import canonical, digest
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


def fits(answer: Json, expected: Json, mission: Json, now: Json) -> bool:
    """Decide whether an authentic answer fits the open request.

    Args:
        answer: The approval and its approver.
        expected: What the approval must say, by field.
        mission: The mission, for roles and issuer.
        now: The two clocks.

    Returns:
        True when it fits.
    """
    approval, approver = answer["approval"], answer["approver"]
    return (
        all(approval[field] == value for field, value in expected.items())
        and now["utc_ms"] <= approval["expires_ms"]
        and now["utc_ms"] <= approver["usable_until_ms"]
        and approver["role"] in mission["risk_policy"]["roles"]
        and approver["id"] != mission["issuer"]
    )


def approval_finding(
    expected: Json,
    request: Json | None,
    *,
    required: int,
    mission: Json,
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
    if now["utc_ms"] > request["expires_ms"]:
        return "APPROVAL_TIMEOUT"
    fitting = [answer for answer in approvals if fits(answer, expected, mission, now)]
    if any(answer["approval"]["verdict"] == "deny" for answer in fitting):
        return "APPROVAL_DENIED"
    signers = {answer["approver"]["id"] for answer in fitting}
    if len(signers) >= required - 1:
        return ""
    return "APPROVAL_REQUIRED"


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


def step_7(
    mission: Json,
    digest: str,
    grant: Json,
    *,
    action: Json,
    state: Json | None,
    facts: Json,
    now: Json,
    standing: Json | None,
    approvals: list[Json],
) -> tuple[list[str], int, int]:
    """Carry out step 7, approval, for the matched grant.

    Args:
        mission: The mission.
        digest: The mission's digest.
        grant: The matched grant.
        action: The normalized action.
        state: The snapshot, or None.
        facts: The facts.
        now: The two clocks.
        standing: The standing, or None.
        approvals: The authentic answers.

    Returns:
        At most one violation, Req(a, s) and rho(a, s).
    """
    risk = rho(mission, action, state, facts, now)
    tier = tier_of(mission["risk_policy"], risk)
    required = required_of(mission["risk_policy"], tier)
    expected = binding_of(mission, digest, grant, action, robot=facts["robot"])
    expected["situation"] = situation_of(mission, grant, tier, state=state, facts=facts, now=now)
    request = None if standing is None else standing.get("requests", {}).get(grant["id"])
    prompts = 0 if standing is None else standing.get("prompts", 0)
    finding = approval_finding(
        expected,
        request,
        required=required,
        mission=mission,
        approvals=approvals,
        now=now,
        prompts=prompts,
    )
    return ([finding] if finding != "" else []), required, risk
