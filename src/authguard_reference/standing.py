# SPDX-License-Identifier: Apache-2.0
"""The registry R of `alg:authguard`: docs/spec/standing.md. Nothing here changes its inputs."""

from copy import deepcopy
from typing import Any

Json = dict[str, Any]

#: from -> event -> to; what is not here is refused.
TRANSITIONS: dict[str, dict[str, str]] = {
    "issued": {
        "activate": "active",
        "revoke": "revoked",
        "expire": "expired",
        "supersede": "superseded",
    },
    "active": {
        "suspend": "suspended",
        "begin_closing": "closing",
        "complete": "completed",
        "revoke": "revoked",
        "expire": "expired",
        "supersede": "superseded",
    },
    "suspended": {
        "resume": "active",
        "complete": "completed",
        "revoke": "revoked",
        "expire": "expired",
        "supersede": "superseded",
    },
    "closing": {
        "complete": "completed",
        "revoke": "revoked",
        "expire": "expired",
    },
    "completed": {},
    "revoked": {},
    "expired": {},
    "superseded": {},
}

#: Step 4 of decision.md: the code with which a status refuses, "" when it refuses nothing.
STATUS_REFUSAL: dict[str, str] = {
    "issued": "MISSION_NOT_ACTIVE",
    "active": "",
    "suspended": "MISSION_SUSPENDED",
    "closing": "",
    "completed": "MISSION_COMPLETED",
    "revoked": "REVOKED",
    "expired": "EXPIRED",
    "superseded": "SUPERSEDED",
}

SPENT = ("motion_ms", "wait_ms", "recorded_bytes")
OUTCOMES = ("succeeded", "not_started", "failed", "aborted", "unknown")
ALWAYS_WRITTEN = ("mid", "version", "digest", "rid", "status")


def uses_of(standing: Json | None, grant: str, field: str) -> int:
    """Read one counter of a grant.

    Args:
        standing: The standing, or None.
        grant: The grant's id.
        field: One of starts, successes, last_success.

    Returns:
        The counter; what is left out is zero.
    """
    if standing is None:
        return 0
    count: int = standing.get("uses", {}).get(grant, {}).get(field, 0)
    return count


def release(
    standing: Json, grant: str, *, ticket: str, spend: Json, now: Json, per_ms: int
) -> Json:
    """Record a release.

    Args:
        standing: The standing before.
        grant: The id of the grant.
        ticket: The name of the release.
        spend: The lease's maximum: motion_ms, wait_ms, recorded_bytes.
        now: The two clocks.
        per_ms: The window of the mission's rate.

    Returns:
        The standing after.
    """
    after = deepcopy(standing)
    use = after.setdefault("uses", {}).setdefault(grant, {})
    use["starts"] = use.get("starts", 0) + 1
    after["actions"] = after.get("actions", 0) + 1
    spent = after.setdefault("spent", {})
    for kind in SPENT:
        spent[kind] = spent.get(kind, 0) + spend.get(kind, 0)
    mono_ms = now["mono_ms"]
    kept = [past for past in after.get("releases", []) if past > mono_ms - per_ms]
    after["releases"] = [*kept, mono_ms]
    reserved = {kind: spend.get(kind, 0) for kind in SPENT}
    opened = {"ticket": ticket, "grant": grant, "reserved": reserved}
    after["open"] = [*after.get("open", []), opened]
    after.get("requests", {}).pop(grant, None)
    return _without_defaults(after)


def settle(standing: Json, mission: Json, *, ticket: str, outcome: str, used: Json) -> Json:
    """Record the outcome of a release.

    Args:
        standing: The standing before.
        mission: The mission, for the grant's `irreversible`.
        ticket: The name of the release.
        outcome: One of OUTCOMES.
        used: What was really used: motion_ms, wait_ms, recorded_bytes.

    Returns:
        The standing after; for `unknown` nothing changes.

    Raises:
        ValueError: If the outcome has no such name or no such ticket is open.
    """
    after = deepcopy(standing)
    entries = [entry for entry in after.get("open", []) if entry["ticket"] == ticket]
    if outcome not in OUTCOMES or len(entries) != 1:
        raise ValueError("no such outcome or no such open ticket")
    if outcome == "unknown":
        return after
    entry = entries[0]
    after["open"] = [other for other in after["open"] if other["ticket"] != ticket]
    _give_back(after, entry["reserved"], used)
    use = after.setdefault("uses", {}).setdefault(entry["grant"], {})
    if outcome == "succeeded":
        after["order"] = after.get("order", 0) + 1
        use["successes"] = use.get("successes", 0) + 1
        use["last_success"] = after["order"]
    if outcome == "not_started" and not _is_irreversible(mission, entry["grant"]):
        use["starts"] = use.get("starts", 0) - 1
        after["actions"] = after.get("actions", 0) - 1
    return _without_defaults(after)


def _give_back(after: Json, reserved: Json, used: Json) -> None:
    """Put what was really used in the place of what was reserved."""
    spent = after.setdefault("spent", {})
    for kind in SPENT:
        spent[kind] = spent.get(kind, 0) - reserved.get(kind, 0) + max(0, used.get(kind, 0))


def _is_irreversible(mission: Json, grant_id: str) -> bool:
    for grant in mission["actions"]:
        if grant["id"] == grant_id:
            return bool(grant.get("irreversible", False))
    return False


def _without_zeros(counters: Json) -> Json:
    return {name: value for name, value in counters.items() if value != 0}


def _without_defaults(standing: Json) -> Json:
    """Leave out what is zero or empty, as the spec's shape does."""
    tidy = dict(standing)
    uses = {grant: _without_zeros(use) for grant, use in tidy.get("uses", {}).items()}
    tidy["uses"] = {grant: use for grant, use in uses.items() if use != {}}
    tidy["spent"] = _without_zeros(tidy.get("spent", {}))
    tidy["open"] = [
        {**entry, "reserved": _without_zeros(entry["reserved"])} for entry in tidy.get("open", [])
    ]
    return {
        field: value
        for field, value in tidy.items()
        if field in ALWAYS_WRITTEN or value not in (0, [], {})
    }


def is_complete(standing: Json, mission: Json) -> bool:
    """Decide whether the mission is complete.

    Args:
        standing: The standing.
        mission: The mission.

    Returns:
        True when there are grants with `completes` and each has `repeat` successes.
    """
    completing = [grant for grant in mission["actions"] if grant.get("completes", False)]
    if completing == []:
        return False
    return all(
        uses_of(standing, grant["id"], "successes") >= grant["repeat"] for grant in completing
    )
