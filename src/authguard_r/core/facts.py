# SPDX-License-Identifier: Apache-2.0
"""The part of the signed site model that the decision reads, in its shape.

`site` makes it from the signed model, `server.wiring` adds the gate's certificate; nothing here
comes from a request. Spec page: docs/spec/site-model.md
"""

from __future__ import annotations

from msgspec import Struct

from authguard_r.core import identifiers as ids
from authguard_r.core.geometry import Polygon
from authguard_r.core.mission import RiskPolicy
from authguard_r.core.provenance import AllowedSources


class ParameterKind(Struct, frozen=True, kw_only=True):
    """One parameter of an action type.

    Args:
        low: smallest value that the type can have at all.
        high: largest value that the type can have at all.
        required: an action of the type is malformed without it.
        monitored_by: attested state variable that shows the real value while the robot moves.
    """

    low: int
    high: int
    required: bool
    monitored_by: ids.VariableId | None = None


class ActionKind(Struct, frozen=True, kw_only=True):
    """One canonical action type of the site's vocabulary.

    Args:
        fields: which of object, source, destination, route an action of this type has.
        params: its parameters.
        moves: it moves the robot, so its lease counts against the motion budget.
        waits: it waits on purpose, so its lease counts against the waiting budget.
        records: it records sensor data; `max_bytes` is then required and data rights are checked.
        stores: it keeps what it recorded beyond the action.
    transmits: it also sends what it recorded away from the robot.
        privacy: privacy impact, 0 (none) to 3.
        state_writing: it changes the robot's own belief and can never be granted.
    """

    fields: frozenset[str]
    params: dict[ids.ParameterId, ParameterKind]
    moves: bool = False
    waits: bool = False
    records: bool = False
    stores: bool = False
    transmits: bool = False
    privacy: int = 0
    state_writing: bool = False


class RegionFacts(Struct, frozen=True):
    """One region: its shape, the tags that the risk policy weighs, and the regions around it."""

    area: Polygon
    tags: frozenset[str]
    around: frozenset[ids.RegionId] = frozenset()


class RobotFacts(Struct, frozen=True, kw_only=True):
    """Who this gate guards and what the robot can do.

    Args:
        rid: the robot id in the gate's own certificate, from nowhere else.
        profile: digest of the capability profile named by that certificate.
        tools: for each action type that the robot can do, the tools that can do it.
    """

    rid: ids.RobotId
    profile: ids.Digest
    tools: dict[ids.ActionType, frozenset[ids.ToolId]]


class SiteFacts(Struct, frozen=True, kw_only=True):
    """The site model as the decision reads it.

    Args:
        digest: the one that a mission binds.
        robot: whom the gate guards.
        regions: every region of the site.
        objects: the class of each object.
        vocabulary: the action types.
        risk: the organization's own policies beside every mission's; the strictest counts.
        sources: AllowedSrc(f) of the site; no mission is wider.
    """

    digest: ids.Digest
    robot: RobotFacts
    regions: dict[ids.RegionId, RegionFacts]
    objects: dict[ids.ObjectId, str]
    vocabulary: dict[ids.ActionType, ActionKind]
    risk: tuple[RiskPolicy, ...] = ()
    sources: AllowedSources = {}
