# SPDX-License-Identifier: Apache-2.0
"""What an integrator can pass to Cedar beside the action: counts, budgets, choices, approvals.

Cedar remembers nothing itself. Here the caller remembers for it, as the mission's registry does,
and each policy asks. Spec page: docs/spec/defenses.md#cedar
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from authguard_r.core.action import Action
from authguard_r.core.facts import ActionKind
from authguard_r.core.mission import Grant, Mission, Row
from missionpair.judging import Walk, proved

#: Type of the record, as the schema has it.
TYPE = (
    "status: String, recent: Long, actions: Long, motion_ms: Long, wait_ms: Long, "
    "recorded_bytes: Long, approved: Bool, grants: { %s }, selected: { %s }"
)
_GRANT = "{ starts: Long, successes: Long, last: Long, held: Long }"
_APPROVAL = frozenset({"APPROVAL_REQUIRED", "APPROVAL_DENIED", "APPROVAL_TIMEOUT"})


def context_type(mission: Mission) -> str:
    """Return the type of the context's further fields."""
    grants = ", ".join(f'"{grant.id}": {_GRANT}' for grant in mission.actions)
    selected = ", ".join(f'"{grant.id}"?: Long' for grant in mission.actions)
    return TYPE % (grants, selected)


def context_of(walk: Walk, action: Action, mission: Mission) -> dict[str, Any]:
    """Return the further fields for one question."""
    standing = walk.standing or {}
    spent, uses = standing.get("spent", {}), standing.get("uses", {})
    begin = walk.now.mono_ms - mission.budgets.rate.per_ms
    held = [entry["grant"] for entry in standing.get("open", ())]
    return {
        "status": standing.get("status", "unknown"),
        "recent": sum(1 for at in standing.get("releases", ()) if at > begin),
        "actions": standing.get("actions", 0),
        "motion_ms": spent.get("motion_ms", 0),
        "wait_ms": spent.get("wait_ms", 0),
        "recorded_bytes": spent.get("recorded_bytes", 0),
        # people who stand by would have signed, had anybody asked them
        "approved": bool(walk.stage.approvers)
        or _APPROVAL.isdisjoint(proved(walk, action).reasons),
        "grants": {
            grant.id: {
                "starts": uses.get(grant.id, {}).get("starts", 0),
                "successes": uses.get(grant.id, {}).get("successes", 0),
                "last": uses.get(grant.id, {}).get("last_success", 0),
                "held": held.count(grant.id),
            }
            for grant in mission.actions
        },
        "selected": dict(standing.get("selected", {})),
    }


def conditions(mission: Mission, grant: Grant, row: Row, kind: ActionKind) -> Iterator[str]:
    """Yield what a row's policy asks of these fields."""
    own, budgets = f'context.grants["{grant.id}"]', mission.budgets
    closing = "false"
    if mission.closing is not None and grant.id in mission.closing.grants:
        closing = 'context.status == "closing"'
    yield f'(context.status == "active" || {closing})'
    yield f"{own}.successes + {own}.held < {grant.repeat}"
    yield f"{own}.starts < {grant.starts}"
    yield f"context.recent < {budgets.rate.count}"
    yield f"context.actions < {budgets.actions}"
    if kind.moves:
        yield f"context.motion_ms + {grant.max_ms} <= {budgets.motion_ms}"
    if kind.waits:
        yield f"context.wait_ms + {grant.max_ms} <= {budgets.wait_ms}"
    if kind.records:
        size = 'context.params["max_bytes"]'
        yield 'context.params has "max_bytes"'
        yield f"context.recorded_bytes + {size} <= {budgets.recorded_bytes}"
    for before in grant.after:
        yield f'context.grants["{before}"].last > {own}.last'
    for end in grant.until:
        yield f'context.grants["{end}"].successes == 0'
    yield "context.approved"
    chosen = f'context.selected["{grant.id}"]'
    at = grant.alternatives.index(row)
    here = f'context.selected has "{grant.id}" && {chosen} == {at}'
    if _is_open(grant) and str(grant.chooser) != "planner":
        yield here
    else:
        yield f'(!(context.selected has "{grant.id}") || ({here}))'


def _is_open(grant: Grant) -> bool:
    """True when a person chooses among the grant's rows: they differ in thing or place."""
    ends = {(row.object, row.destination) for row in grant.alternatives}
    starts = {row.source for row in grant.alternatives}
    return len(ends) > 1 and len(starts) < len(grant.alternatives)
