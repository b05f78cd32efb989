# SPDX-License-Identifier: Apache-2.0
"""Risk: rho(a, s) and Req(a, s) of `eq:threshold`; docs/spec/approval.md, "rho(a, s)"."""

from typing import Any

from authguard_reference.place import guard_finding

Json = dict[str, Any]


def regions_named(action: Json) -> list[str]:
    """List the regions an action names.

    Args:
        action: The normalized action.

    Returns:
        Source, destination and route, as far as present.
    """
    ends = [action[field] for field in ("source", "destination") if field in action]
    return [*ends, *action.get("route", [])]


def region_risk(policy: Json, action: Json, facts: Json) -> int:
    """Compute the region's part of rho.

    Args:
        policy: The mission's risk policy.
        action: The normalized action.
        facts: The facts of the site and the robot.

    Returns:
        The largest weight over all regions and their tags, 0 when there is none.
    """
    otherwise = policy.get("otherwise", 0)
    weights: list[int] = [0]
    for name in regions_named(action):
        if name not in facts["regions"]:
            weights.append(otherwise)
            continue
        tags = facts["regions"][name].get("tags", [])
        weights += [policy.get("region_tags", {}).get(tag, otherwise) for tag in tags]
    return max(weights)


def object_risk(policy: Json, action: Json, facts: Json) -> int:
    """Compute the object's part of rho.

    Args:
        policy: The mission's risk policy.
        action: The normalized action.
        facts: The facts of the site and the robot.

    Returns:
        The weight of the object's class, 0 without an object.
    """
    if "object" not in action:
        return 0
    kind = facts["objects"].get(action["object"], "")
    weight: int = policy.get("object_classes", {}).get(kind, policy.get("otherwise", 0))
    return weight


def privacy_risk(policy: Json, action: Json, facts: Json) -> int:
    """Compute the privacy part of rho.

    Args:
        policy: The mission's risk policy.
        action: The normalized action.
        facts: The facts of the site and the robot.

    Returns:
        The policy's privacy factor times the type's impact, 3 for an unknown type.
    """
    impact: int = 3
    if action["type"] in facts["vocabulary"]:
        impact = facts["vocabulary"][action["type"]].get("privacy", 0)
    factor: int = policy.get("privacy", 0)
    return factor * impact


def rho(policy: Json, action: Json, state: Json | None, facts: Json, now: Json) -> int:
    """Compute the risk score rho of action and state.

    Args:
        policy: The risk policy, of the mission or of the organization.
        action: The normalized action.
        state: The snapshot with its arrival, or None.
        facts: The facts of the site and the robot.
        now: The two clocks.

    Returns:
        The sum of all parts, at most the largest integer of the encoding.
    """
    total: int = policy.get("types", {}).get(action["type"], policy.get("otherwise", 0))
    total += region_risk(policy, action, facts)
    total += object_risk(policy, action, facts)
    total += privacy_risk(policy, action, facts)
    for entry in policy.get("parameters", []):
        value = abs(action.get("params", {}).get(entry["parameter"], 0))
        # rounded up, in integers: -(-a // b) is the ceiling of a / b
        total += -(-(entry.get("weight", 0) * value) // entry["full_scale"])
    for entry in policy.get("states", []):
        if guard_finding(entry["guard"], state, facts, now) != "GUARD_FALSE":
            total += entry.get("weight", 0)
    return min(total, 2**53 - 1)


def tier_of(policy: Json, risk: int) -> int:
    """Find the tier of `eq:threshold`.

    Args:
        policy: The risk policy.
        risk: The value of rho.

    Returns:
        1, 2 or 3.
    """
    if risk < policy.get("tau_1", 0):
        return 1
    if risk < policy.get("tau_2", 0):
        return 2
    return 3


def required_of(policy: Json, tier: int) -> int:
    """Find Req of `eq:threshold`.

    Args:
        policy: The mission's risk policy.
        tier: 1, 2 or 3.

    Returns:
        1, 2 or t.
    """
    required: dict[int, int] = {1: 1, 2: 2, 3: policy["t"]}
    return required[tier]
