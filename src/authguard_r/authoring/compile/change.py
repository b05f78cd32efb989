# SPDX-License-Identifier: Apache-2.0
"""The smallest signed change that would allow a refused action, for the operator only.

It is a next version of the mission, not yet signed and worth nothing until it is. The planner
never sees it (L9). Source: section "Mission Compilation and Clarification" (updates).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import msgspec

from authguard_r.core.action import Action
from authguard_r.core.identifiers import Digest, GrantId
from authguard_r.core.mission import Grant, Limit, Mission, Row
from authguard_r.core.reasons import Reason

#: What a new signature can fix; the rest is state, order, time or identity.
MENDABLE = frozenset(
    {
        Reason.EXPIRED,
        Reason.ACTION_OUT_OF_SCOPE,
        Reason.TOOL_OUT_OF_SCOPE,
        Reason.OBJECT_OUT_OF_SCOPE,
        Reason.SOURCE_OUT_OF_SCOPE,
        Reason.DESTINATION_OUT_OF_SCOPE,
        Reason.ROUTE_OUT_OF_SCOPE,
        Reason.PARAMETER_NOT_ALLOWED,
        Reason.PARAMETER_OUT_OF_BOUNDS,
    }
)


def already_there(item: object, source: object, destination: object) -> str:
    """Return what to say of a motion to the place where the robot is; empty for every other action.

    Args:
        item: the object of the action; None for a motion that handles no object.
        source: of the action, as it was attested.
        destination: of the action.
    """
    if item is not None or destination is None or source != destination:
        return ""
    return f"the robot is already in `{destination}`: the planner can leave this step out"


def smallest_change(
    mission: Mission,
    action: Action,
    *,
    reasons: tuple[Reason, ...],
    grant: GrantId,
    digest: Digest,
    nonce: str,
    expiry: str,
) -> Mission | None:
    """Return the next version with one grant put in the place of the nearest one.

    Args:
        mission: the version that refused.
        action: the refused action.
        reasons: why; None is returned when a signature cannot fix one of them, and for a motion
            to where the robot is.
        grant: the nearest grant.
        digest: the digest of the version that refused.
        nonce: fresh.
        expiry: the end of the new version when the old one is over.
    """
    if not reasons or not MENDABLE.issuperset(reasons):
        return None
    if already_there(action.object, action.source, action.destination):
        return None
    near = next(g for g in mission.actions if g.id == grant)
    amended = _amended(near, action, mission)
    kept = tuple(
        amended if g.id == grant else _renamed(g, near.id, amended.id) for g in mission.actions
    )
    row = amended.alternatives[0]
    objects = {*mission.objects, *([row.object] if row.object is not None else [])}
    expired = Reason.EXPIRED in reasons
    return msgspec.structs.replace(
        mission,
        version=mission.version + 1,
        supersedes=digest,
        nonce=nonce,
        actions=kept,
        objects=tuple(sorted(objects)),
        regions=tuple(sorted({*mission.regions, *row.regions})),
        limits=_raised(mission.limits, action),
        expiry=expiry if expired else mission.expiry,
    )


def to_draft(mission: Mission) -> dict[str, Any]:
    """Return the mission as a draft that the compiler takes back, word for word."""
    plain = msgspec.to_builtins(mission)
    policy, budgets = dict(plain["risk_policy"]), plain["budgets"]
    policy["valid"] = policy.pop("valid_ms")
    policy["states"] = [
        {**item, "guard": _draft_guard(item["guard"])} for item in policy.get("states", ())
    ]
    draft: dict[str, Any] = {
        "mission": plain["mid"],
        "version": plain["version"],
        "robot": plain["rid"],
        "window": {"not_before": plain["not_before"], "expiry": plain["expiry"]},
        "place_max_age": plain["place_max_age_ms"],
        "limits": _draft_limits(plain["limits"]),
        "guards": [_draft_guard(guard) for guard in plain["guards"]],
        "grants": [_draft_grant(grant) for grant in plain["actions"]],
        "risk_policy": policy,
        "budgets": {
            "actions": budgets["actions"],
            "rate": {"count": budgets["rate"]["count"], "per": budgets["rate"]["per_ms"]},
            "motion": budgets["motion_ms"],
            "waiting": budgets["wait_ms"],
            "recorded_bytes": budgets["recorded_bytes"],
            "prompts": budgets["prompts"],
            "planner_stops": budgets["planner_stops"],
        },
    }
    same = (
        *("issuer", "task", "supersedes", "objects", "regions", "on_refusal"),
        *("sources", "retention"),
    )
    draft |= {name: plain[name] for name in same if name in plain}
    if "closing" in plain:
        draft["closing"] = {
            "grants": plain["closing"]["grants"],
            "for": plain["closing"]["for_ms"],
        }
    return draft


def _draft_grant(grant: dict[str, Any]) -> dict[str, Any]:
    draft = dict(grant)
    draft["rows"] = draft.pop("alternatives")
    draft["data"] = {"record": False, "store": False, "transmit": False, **draft["data"]}
    draft["max"] = draft.pop("max_ms")
    draft["limits"] = _draft_limits(draft.get("limits", ()))
    for name in ("guards", "done_when"):
        draft[name] = [_draft_guard(guard) for guard in draft.get(name, ())]
    return draft


def _draft_guard(guard: dict[str, Any]) -> dict[str, Any]:
    return {
        "variable": guard["variable"],
        "max_age": guard["max_age_ms"],
        guard["comparison"]: guard["value"],
    }


def _draft_limits(limits: Iterable[dict[str, Any]]) -> dict[str, list[int]]:
    return {limit["parameter"]: [limit["low"], limit["high"]] for limit in limits}


def _amended(near: Grant, action: Action, mission: Mission) -> Grant:
    """Return the nearest grant with exactly the refused action as its one row.

    It gets an id of its own: standing is carried over by id, and this is another permission.
    """
    ends = {r for r in (action.source, action.destination) if r is not None}
    around = {r for row in near.alternatives if row.source == action.source for r in row.regions}
    gone = {row.destination for row in near.alternatives} - {action.destination}
    regions = (around - gone) | ends | set(action.route)
    row = Row(
        object=action.object,
        source=action.source,
        destination=action.destination,
        regions=tuple(sorted(regions)),
    )
    limits = {limit.parameter: limit for limit in near.limits}
    for name, value in action.params.items():
        held = limits.get(name, Limit(parameter=name, low=value, high=value))
        limits[name] = Limit(parameter=name, low=min(held.low, value), high=max(held.high, value))
    taken = {grant.id for grant in mission.actions}
    number = next(n for n in range(2, 1000) if f"{near.id[:58]}.{n}" not in taken)
    return msgspec.structs.replace(
        near,
        id=GrantId(f"{near.id[:58]}.{number}"),
        type=action.type,
        tool=action.tool,
        alternatives=(row,),
        limits=tuple(limits[name] for name in sorted(limits)),
    )


def _renamed(grant: Grant, old: GrantId, new: GrantId) -> Grant:
    """Return the grant with references to the replaced one pointing at its successor."""
    swap = {old: new}
    after = tuple(sorted(swap.get(item, item) for item in grant.after))
    until = tuple(sorted(swap.get(item, item) for item in grant.until))
    return msgspec.structs.replace(grant, after=after, until=until)


def _raised(limits: tuple[Limit, ...], action: Action) -> tuple[Limit, ...]:
    return tuple(
        Limit(
            parameter=limit.parameter,
            low=min(limit.low, action.params.get(limit.parameter, limit.low)),
            high=max(limit.high, action.params.get(limit.parameter, limit.high)),
        )
        for limit in limits
    )
