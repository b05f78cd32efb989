# SPDX-License-Identifier: Apache-2.0
"""From actions that were seen to the tightest mission that allows them: a draft, full of questions.

One grant for each type and tool, and one more for the way home, which ends the work. Its rows are
the rows that were seen, never a cross product; its limits are the extremes, its counts the counts.
What the log cannot know (until when, who chooses, how long, what needs approval) is left out, so
that compiling asks. How-to: docs/howto/onboarding.md
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from msgspec import Struct

from authguard_r.authoring.onboarding.evidence import Proposed, Unused
from authguard_r.core.action import Action
from authguard_r.core.identifiers import (
    ActionType,
    ObjectId,
    ParameterId,
    RegionId,
    RobotId,
    ToolId,
    is_identifier,
)
from authguard_r.core.mission import MAX_GRANTS, MAX_ROWS
from authguard_r.provenance.context import Influence
from authguard_r.site.model import Site

#: What the proposed mission is called until its author calls it something.
MISSION = "learned"


class SeenRow(Struct, frozen=True, kw_only=True):
    """One row with how it came about.

    Args:
        object: the object; None when the type has none.
        source: where it starts; None when it was not attested, or the type has none.
        destination: where it ends.
        regions: every region that was named or attested: ends, route, where the robot stood.
        seqs: the records that it was seen in.
        influences: inputs that had mentioned what it carries, each once.
        looked: whether every record was searched for such inputs.
    """

    object: ObjectId | None
    source: RegionId | None
    destination: RegionId | None
    regions: tuple[RegionId, ...]
    seqs: tuple[int, ...]
    influences: tuple[Influence, ...]
    looked: bool


class SeenGrant(Struct, frozen=True, kw_only=True):
    """Everything that was done by one tool as one type.

    Args:
        id: of the proposed grant.
        type: the action type.
        tool: the tool.
        rows: what was seen, in order.
        limits: the least and the greatest of each parameter.
        starts: how often it was proposed.
        leaves: whether it leads to where the robot lives: with this grant a planner may end the
            work.
    """

    id: str
    type: ActionType
    tool: ToolId
    rows: tuple[SeenRow, ...]
    limits: dict[ParameterId, tuple[int, int]]
    starts: int
    leaves: bool = False


class Learned(Struct, frozen=True):
    """The grants that a run justifies, and what a mission has no room for."""

    grants: tuple[SeenGrant, ...]
    unused: tuple[Unused, ...]


_GrantKey = tuple[ActionType, ToolId, bool]
_Key = tuple[ObjectId | None, RegionId | None, RegionId | None, tuple[RegionId, ...]]


class _Growing:
    """One grant while records are read."""

    def __init__(self) -> None:
        self.rows: dict[_Key, list[Proposed]] = {}
        self.limits: dict[ParameterId, tuple[int, int]] = {}
        self.starts = 0

    def add(self, item: Proposed) -> bool:
        """Take an action in; False when the grant has no room for its row."""
        action = item.action
        key = (action.object, action.source, action.destination, _regions(item))
        if key not in self.rows and len(self.rows) >= MAX_ROWS:
            return False
        self.rows.setdefault(key, []).append(item)
        for name, value in action.params.items():
            low, high = self.limits.get(name, (value, value))
            self.limits[name] = (min(low, value), max(high, value))
        self.starts += 1
        return True


def learn(proposed: Iterable[Proposed], homes: frozenset[RegionId] = frozenset()) -> Learned:
    """Return the grants that these actions justify, and nothing that they do not.

    Args:
        proposed: actions of a site, each of which that site knows (`require_known`).
        homes: where the robot lives; what leads there gets a grant that can be guarded by itself.
    """
    growing: dict[_GrantKey, _Growing] = {}
    unused: list[Unused] = []
    for item in proposed:
        key = (item.action.type, item.action.tool, item.action.destination in homes)
        if key not in growing and len(growing) >= MAX_GRANTS:
            unused.append(Unused(item.seq, f"a mission has at most {MAX_GRANTS} grants"))
        elif not growing.setdefault(key, _Growing()).add(item):
            unused.append(Unused(item.seq, f"a grant has at most {MAX_ROWS} rows"))
    ids: set[str] = set()
    return Learned(tuple(_grant(key, grown, ids) for key, grown in growing.items()), tuple(unused))


def _grant(key: _GrantKey, grown: _Growing, ids: set[str]) -> SeenGrant:
    kind, tool, leaves = key
    wanted = f"{kind}-{tool}{'-home' if leaves else ''}"
    number = len(ids)
    name = wanted if is_identifier(wanted) and wanted not in ids else f"grant-{number}"
    while name in ids:
        number += 1
        name = f"grant-{number}"
    ids.add(name)
    return SeenGrant(
        id=name,
        type=kind,
        tool=tool,
        rows=tuple(_row(key, items) for key, items in grown.rows.items()),
        limits=dict(sorted(grown.limits.items())),
        starts=grown.starts,
        leaves=leaves,
    )


def _row(key: _Key, items: list[Proposed]) -> SeenRow:
    thing, source, destination, regions = key
    found = [influence for item in items for influence in item.influences or ()]
    return SeenRow(
        object=thing,
        source=source,
        destination=destination,
        regions=regions,
        seqs=tuple(item.seq for item in items),
        influences=tuple(dict.fromkeys(found)),
        looked=all(item.influences is not None for item in items),
    )


def _regions(item: Proposed) -> tuple[RegionId, ...]:
    action: Action = item.action
    ends = (action.source, action.destination, *action.route, *item.place)
    return tuple(sorted({region for region in ends if region is not None}))


def draft_of(learned: Learned, site: Site, *, robot: RobotId | None) -> dict[str, Any]:
    """Return the mission as plain data in the draft format; what only a person can say is absent.

    Args:
        learned: at least one grant.
        site: the site whose types these are.
        robot: whose log it was.
    """
    return {
        "mission": MISSION,
        **({} if robot is None else {"robot": robot}),
        "grants": [_draft_grant(grant, site) for grant in learned.grants],
        "budgets": _budgets(learned, site),
    }


def _draft_grant(grant: SeenGrant, site: Site) -> dict[str, Any]:
    fields = site.vocabulary[grant.type].fields
    return {
        "id": grant.id,
        "type": grant.type,
        "tool": grant.tool,
        "rows": [_draft_row(row, with_source="source" in fields) for row in grant.rows],
        "limits": {name: list(pair) for name, pair in grant.limits.items()},
        "repeat": grant.starts,
        "starts": grant.starts,
    }


def _draft_row(row: SeenRow, *, with_source: bool) -> dict[str, Any]:
    """Return a row; without a source its regions are not all known, so they are asked for."""
    told = {"object": row.object, "source": row.source, "destination": row.destination}
    plain: dict[str, Any] = {name: value for name, value in told.items() if value is not None}
    if row.regions and not (with_source and row.source is None):
        plain["regions"] = list(row.regions)
    return plain


def _budgets(learned: Learned, site: Site) -> dict[str, Any]:
    """Return the totals that follow from what was seen: the count, and zero of what never was."""
    kinds = [site.vocabulary[grant.type] for grant in learned.grants]
    budgets: dict[str, Any] = {"actions": sum(grant.starts for grant in learned.grants)}
    if not any(kind.moves for kind in kinds):
        budgets["motion"] = 0
    if not any(kind.waits for kind in kinds):
        budgets["waiting"] = 0
    if not any(kind.records for kind in kinds):
        budgets["recorded_bytes"] = 0
    return budgets
