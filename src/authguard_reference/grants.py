# SPDX-License-Identifier: Apache-2.0
"""Step 6 of `alg:authguard`, of each grant and each row: a in Pi_M(s, t), `eq:policy-set`.

The provenance check is in `sources`. A list of findings may hold a code more than once: every
violation counts.
"""

from typing import Any

from authguard_reference.place import guards_findings, place_of, pose_of, unfit
from authguard_reference.sources import provenance_findings, rows_in_question
from authguard_reference.standing import uses_of

Json = dict[str, Any]


def shape_findings(grant: Json, action: Json, facts: Json) -> list[str]:
    """Check type, tool, parameters and data rights against a grant.

    Args:
        grant: The grant.
        action: The normalized action.
        facts: The facts of the site and the robot.

    Returns:
        Every violation.
    """
    found: list[str] = []
    if action["type"] != grant["type"]:
        found.append("ACTION_OUT_OF_SCOPE")
    if action["tool"] != grant["tool"]:
        found.append("TOOL_OUT_OF_SCOPE")
    params = action.get("params", {})
    limits = grant.get("limits", [])
    for limit in limits:
        if limit["parameter"] not in params:
            found.append("PARAMETER_MISSING")
        elif not limit["low"] <= params[limit["parameter"]] <= limit["high"]:
            found.append("PARAMETER_OUT_OF_BOUNDS")
    limited = [limit["parameter"] for limit in limits]
    found += ["PARAMETER_NOT_ALLOWED" for name in params if name not in limited]
    kind = facts["vocabulary"].get(action["type"], {})
    for does, right in (("records", "record"), ("stores", "store"), ("transmits", "transmit")):
        if kind.get(does, False) and not grant.get("data", {}).get(right, False):
            found.append("DATA_RIGHT_MISSING")
    return found


def order_findings(grant: Json, mission: Json, standing: Json | None, now: Json) -> list[str]:
    """Check `after`, `until` and closing.

    Args:
        grant: The grant.
        mission: The mission.
        standing: The standing, or None.
        now: The two clocks.

    Returns:
        Every violation; none without a standing.
    """
    if standing is None:
        return []
    found: list[str] = []
    own = uses_of(standing, grant["id"], "last_success")
    lasts = [uses_of(standing, other, "last_success") for other in grant.get("after", [])]
    found += ["ORDER_VIOLATED" for last in lasts if last <= own]
    closers = [uses_of(standing, other, "successes") for other in grant.get("until", [])]
    found += ["GRANT_CLOSED" for successes in closers if successes > 0]
    if standing["status"] == "closing":
        closing_grants = mission.get("closing", {}).get("grants", [])
        is_late = now["utc_ms"] > standing.get("closes_ms", 0)
        if grant["id"] not in closing_grants or is_late:
            found.append("GRANT_CLOSED")
    return found


def use_findings(grant: Json, mission: Json, standing: Json | None, now: Json) -> list[str]:
    """Check repetitions, starts and the rate.

    Args:
        grant: The grant.
        mission: The mission.
        standing: The standing, or None.
        now: The two clocks.

    Returns:
        Every violation; none without a standing.
    """
    if standing is None:
        return []
    found: list[str] = []
    in_flight = [entry for entry in standing.get("open", []) if entry["grant"] == grant["id"]]
    if uses_of(standing, grant["id"], "successes") + len(in_flight) >= grant["repeat"]:
        found.append("REPEAT_EXHAUSTED")
    if uses_of(standing, grant["id"], "starts") >= grant["starts"]:
        found.append("STARTS_EXHAUSTED")
    rate = mission["budgets"].get("rate", {})
    begin = now["mono_ms"] - rate.get("per_ms", 0)
    recent = [release for release in standing.get("releases", []) if release > begin]
    if len(recent) >= rate.get("count", 0):
        found.append("RATE_EXCEEDED")
    return found


def budget_findings(
    grant: Json, mission: Json, action: Json, facts: Json, standing: Json | None
) -> list[str]:
    """Check the budgets that a release would draw on.

    Args:
        grant: The grant.
        mission: The mission.
        action: The normalized action.
        facts: The facts of the site and the robot.
        standing: The standing, or None.

    Returns:
        BUDGET_EXCEEDED for each budget that would not suffice; none without a standing.
    """
    if standing is None:
        return []
    kind = facts["vocabulary"].get(action["type"], {})
    used = {"actions": standing.get("actions", 0), **standing.get("spent", {})}
    addition = {"actions": 1, "motion_ms": 0, "wait_ms": 0, "recorded_bytes": 0}
    if kind.get("moves", False):
        addition["motion_ms"] = grant["max_ms"]
    if kind.get("waits", False):
        addition["wait_ms"] = grant["max_ms"]
    if kind.get("records", False):
        addition["recorded_bytes"] = action.get("params", {}).get("max_bytes", 0)
    found: list[str] = []
    for name, more in addition.items():
        if more != 0 and used.get(name, 0) + more > mission["budgets"].get(name, 0):
            found.append("BUDGET_EXCEEDED")
    return found


def row_findings(
    row: Json, mission: Json, action: Json, *, state: Json | None, facts: Json, now: Json
) -> list[str]:
    """Check the action against one whole row.

    Args:
        row: The row.
        mission: The mission.
        action: The normalized action.
        state: The snapshot with its arrival, or None.
        facts: The facts of the site and the robot.
        now: The two clocks.

    Returns:
        Every violation.
    """
    found = ["OBJECT_OUT_OF_SCOPE"] if action.get("object") != row.get("object") else []
    found += ["SOURCE_OUT_OF_SCOPE"] if action.get("source") != row.get("source") else []
    if action.get("destination") != row.get("destination"):
        found.append("DESTINATION_OUT_OF_SCOPE")
    regions = row.get("regions", [])
    found += ["ROUTE_OUT_OF_SCOPE" for entry in action.get("route", []) if entry not in regions]
    if "source" not in action and regions == []:
        return found
    pose = pose_of(state)
    finding = unfit(pose, mission.get("place_max_age_ms", 0), state, facts, now)
    if finding != "" or pose is None:
        return [*found, finding]
    place = place_of(pose, facts)
    if "source" in action:
        return found if place == {action["source"]} else [*found, "SOURCE_NOT_ATTESTED"]
    if place == set() or not place <= set(regions):
        found.append("OUTSIDE_REGIONS")
    return found


def grant_findings(
    grant: Json,
    mission: Json,
    action: Json,
    *,
    state: Json | None,
    facts: Json,
    now: Json,
    standing: Json | None,
    issuer: str,
) -> list[str]:
    """Check the action against a grant, its rows left aside.

    Args:
        grant: The grant.
        mission: The mission.
        action: The normalized action.
        state: The snapshot with its arrival, or None.
        facts: The facts of the site and the robot.
        now: The two clocks.
        standing: The standing, or None.
        issuer: The label of what the mission's issuer signs.

    Returns:
        Every violation.
    """
    found = shape_findings(grant, action, facts)
    found += order_findings(grant, mission, standing, now)
    found += use_findings(grant, mission, standing, now)
    found += budget_findings(grant, mission, action, facts, standing)
    found += guards_findings(grant.get("guards", []), state, facts, now)
    found += provenance_findings(
        grant, mission, action, facts=facts, standing=standing, issuer=issuer
    )
    return found


def match(
    mission: Json,
    action: Json,
    state: Json | None,
    facts: Json,
    now: Json,
    *,
    standing: Json | None,
    issuer: str,
) -> tuple[Json, int, list[str]]:
    """Find the matched grant and its row.

    The fewest findings win, none at best; `min` keeps the first of equals, the signed order.
    A grant's own findings are the same for all its rows, so this is the row rule as well.

    Args:
        mission: The mission.
        action: The normalized action.
        state: The snapshot with its arrival, or None.
        facts: The facts of the site and the robot.
        now: The two clocks.
        standing: The standing, or None.
        issuer: The label of what the mission's issuer signs.

    Returns:
        The grant, its row's index and the findings of both, repeats included.
    """
    seen: Json = {"state": state, "facts": facts, "now": now}
    candidates: list[tuple[Json, int, list[str]]] = []
    for grant in mission["actions"]:
        of_grant = grant_findings(grant, mission, action, standing=standing, issuer=issuer, **seen)
        for index in rows_in_question(grant, standing):
            of_row = row_findings(grant["alternatives"][index], mission, action, **seen)
            candidates.append((grant, index, of_grant + of_row))
    return min(candidates, key=lambda candidate: len(candidate[2]))
