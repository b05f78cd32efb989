# SPDX-License-Identifier: Apache-2.0
"""The normalized action: what every planner dialect becomes before it is judged.

Source: `eq:action`, `eq:compact-action`. Spec page: docs/spec/action.md
"""

from __future__ import annotations

from msgspec import Struct

from authguard_r.core.identifiers import (
    ActionType,
    Count,
    Digest,
    Identifier,
    Integer,
    MissionId,
    ObjectId,
    ParameterId,
    RegionId,
    Timestamp,
    ToolId,
)
from authguard_r.core.provenance import Label


class ActionMeta(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True):
    """What the enforcer says about a proposal; never read from the proposal itself.

    Args:
        planner: the client that proposed (trusted: named by the enforcer).
        mission: the mission that the enforcer, not the planner, holds this proposal against.
        mission_version: its version at the time.
        timestamp: when the proposal was taken in.
        evidence: digest of the exact bytes that the planner wrote.
    """

    planner: Identifier
    timestamp: Timestamp
    evidence: Digest
    mission: MissionId | None = None
    mission_version: Count = 0


class Action(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True):
    """One proposed effect on the world, in the site's own words. A proposal, never authority.

    Args:
        type: canonical action type of the site's vocabulary.
        tool: the actuator, sensor or service that would carry it out.
        object: the object acted on; absent when the type has none.
        source: where the action starts; must equal the attested place.
        destination: where it ends.
        route: regions it asks to pass, in order; empty when it leaves the way open.
        params: integers in the unit that each name ends with (`speed_mm_s`).
        provenance: label of each privileged field, set by us (`normalize`), never by the planner.
        meta: set by the enforcer; absent in a what-if that names none.
    """

    type: ActionType
    tool: ToolId
    object: ObjectId | None = None
    source: RegionId | None = None
    destination: RegionId | None = None
    route: tuple[RegionId, ...] = ()
    params: dict[ParameterId, Integer] = {}
    provenance: dict[str, Label] = {}
    meta: ActionMeta | None = None


class ActionScope(Struct, frozen=True, omit_defaults=True, kw_only=True):
    """What would be carried out, and nothing else: the part of an action that an approval binds.

    The whole action's digest also covers labels and meta, which differ between two proposals of
    the same effect (docs/adr/0004-action-scope.md).
    """

    type: ActionType
    tool: ToolId
    object: ObjectId | None = None
    source: RegionId | None = None
    destination: RegionId | None = None
    route: tuple[RegionId, ...] = ()
    params: dict[ParameterId, Integer] = {}


def scope_of(action: Action) -> ActionScope:
    """Return the effect of the action without who proposed it, when, and from what."""
    return ActionScope(
        type=action.type,
        tool=action.tool,
        object=action.object,
        source=action.source,
        destination=action.destination,
        route=action.route,
        params=action.params,
    )
