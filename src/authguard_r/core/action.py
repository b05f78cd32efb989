# SPDX-License-Identifier: Apache-2.0
"""The normalized action: what every planner dialect becomes before it is judged.

Source: `eq:action`, `eq:compact-action`. Spec page: docs/spec/action.md
"""

from __future__ import annotations

from msgspec import Struct

from authguard_r.core import identifiers as ids
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

    planner: ids.Identifier
    timestamp: ids.Timestamp
    evidence: ids.Digest
    mission: ids.MissionId | None = None
    mission_version: ids.Count = 0


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

    type: ids.ActionType
    tool: ids.ToolId
    object: ids.ObjectId | None = None
    source: ids.RegionId | None = None
    destination: ids.RegionId | None = None
    route: tuple[ids.RegionId, ...] = ()
    params: dict[ids.ParameterId, ids.Integer] = {}
    provenance: dict[str, Label] = {}
    meta: ActionMeta | None = None

    @property
    def places(self) -> tuple[ids.RegionId, ...]:
        """Every region that it names: source, destination, route."""
        return tuple(filter(None, (self.source, self.destination, *self.route)))


class ActionScope(Struct, frozen=True, omit_defaults=True, kw_only=True):
    """What would be carried out, and nothing else: the part of an action that an approval binds.

    The whole action's digest also covers labels and meta, which differ between two proposals of
    the same effect (docs/adr/0004-action-scope.md).
    """

    type: ids.ActionType
    tool: ids.ToolId
    object: ids.ObjectId | None = None
    source: ids.RegionId | None = None
    destination: ids.RegionId | None = None
    route: tuple[ids.RegionId, ...] = ()
    params: dict[ids.ParameterId, ids.Integer] = {}


def scope_of(action: Action) -> ActionScope:
    """Return the effect of the action without who proposed it, when, and from what."""
    return ActionScope(**{name: getattr(action, name) for name in ActionScope.__struct_fields__})
