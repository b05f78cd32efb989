# SPDX-License-Identifier: Apache-2.0
"""The signed site model: what every word of a mission means at one place.

Signed by the site authority; a mission binds its digest, so a word means at execution what it
meant when it was signed. Spec page: docs/spec/site-model.md
"""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Literal

from msgspec import Meta, Struct

from authguard_r.core.encoding import Tag, digest_of
from authguard_r.core.errors import EnvironmentFault
from authguard_r.core.facts import (
    ActionKind,
    ParameterKind,
    RegionFacts,
    RobotFacts,
    SiteFacts,
)
from authguard_r.core.geometry import polygon
from authguard_r.core.identifiers import (
    ActionType,
    Count,
    Digest,
    Identifier,
    Integer,
    ObjectId,
    ParameterId,
    RegionId,
    RobotId,
    ToolId,
    VariableId,
)
from authguard_r.core.reasons import Reason

Point = tuple[Integer, Integer]


class Rounding(StrEnum):
    """How a planner's decimal becomes an integer; always against the requester."""

    COUNT = "count"  # a remainder is refused
    LIMIT = "limit"  # away from zero: what is asked for is never understated
    POSITION = "position"  # half to even


class _Model(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True):
    """The manner of every part of the model: closed, immutable, one spelling."""


class Region(_Model, frozen=True, kw_only=True):
    """One region: a simple polygon on one floor of one map.

    Args:
        map: the map frame.
        floor: the floor.
        points: corners in millimeters, in order, not closed.
        approach: where a robot halts when it is sent here; inside, away from the edge.
        tags: such as `public`, `restricted`, `private`, `hazardous`.
        names: every external spelling.
    """

    map: Identifier
    floor: Integer
    points: Annotated[tuple[Point, ...], Meta(min_length=3, max_length=256)]
    approach: Point
    tags: tuple[Identifier, ...]
    names: tuple[str, ...] = ()


class Door(_Model, frozen=True, kw_only=True):
    """A passage between two regions, at a point that lies on the edge of both.

    Args:
        between: the two regions.
        at: millimeters.
        variable: attested truth value that says whether it is open; absent: it always is.
    """

    between: tuple[RegionId, RegionId]
    at: Point
    variable: VariableId | None = None


class ObjectModel(_Model, frozen=True, kw_only=True):
    """One object: its class for the risk policy, where it belongs, what it is called."""

    kind: Identifier
    home: RegionId
    mass_g: Count
    names: tuple[str, ...] = ()


class Parameter(_Model, frozen=True, kw_only=True):
    """One parameter of an action type; the unit ends its name (`speed_mm_s`).

    Args:
        unit: the unit as people write it (`mm/s`).
        low: smallest value the type can have.
        high: largest value the type can have.
        rounding: how a planner's decimal becomes an integer.
        required: an action of the type is malformed without it.
        monitored_by: attested variable that shows the real value.
    """

    unit: str
    low: Integer
    high: Integer
    rounding: Rounding
    required: bool
    monitored_by: VariableId | None = None


class ActionModel(_Model, frozen=True, kw_only=True):
    """One canonical action type; see `core.facts.ActionKind` for the flags."""

    fields: tuple[Literal["destination", "object", "route", "source"], ...]
    params: dict[ParameterId, Parameter] = {}
    moves: bool = False
    waits: bool = False
    records: bool = False
    stores: bool = False
    transmits: bool = False
    privacy: Annotated[int, Meta(ge=0, le=3)] = 0
    state_writing: bool = False


class Profile(_Model, frozen=True, kw_only=True):
    """What a robot can do at all: the capability profile that missions and gates bind.

    Args:
        tools: for each action type, the tools that can do it.
        max_speed_mm_s: top speed.
        max_force_mn: top gripping force, millinewton.
        max_payload_g: heaviest load.
    """

    tools: dict[ActionType, tuple[ToolId, ...]]
    max_speed_mm_s: Count
    max_force_mn: Count
    max_payload_g: Count


class Robot(_Model, frozen=True, kw_only=True):
    """One robot of the site: its profile, and where it stands when nothing is asked of it."""

    profile: Profile
    home: RegionId


class Site(_Model, frozen=True, kw_only=True):
    """Everything a mission may speak of."""

    schema: Literal["authguard-r/site/1"]
    id: Identifier
    version: Count
    regions: dict[RegionId, Region]
    objects: dict[ObjectId, ObjectModel]
    robots: dict[RobotId, Robot]
    vocabulary: dict[ActionType, ActionModel]
    doors: tuple[Door, ...] = ()


def site_digest(site: Site) -> Digest:
    """Return the digest that a mission binds as `site`."""
    return digest_of(Tag.SITE, site)


def profile_digest(profile: Profile) -> Digest:
    """Return the digest that a mission and a gate's certificate bind as `profile`."""
    return digest_of(Tag.PROFILE, profile)


def facts_of(site: Site, *, rid: RobotId, profile: Digest) -> SiteFacts:
    """Return the site as the decision reads it, for one robot.

    Args:
        site: the model.
        rid: the robot id in the gate's certificate.
        profile: the profile digest in the gate's certificate.

    Raises:
        EnvironmentFault: the site does not know this robot with this profile.
    """
    robot = site.robots.get(rid)
    if robot is None or profile_digest(robot.profile) != profile:
        raise EnvironmentFault(
            f"the site `{site.id}` has no robot `{rid}` with the profile of its certificate",
            reason=Reason.PROFILE_MISMATCH,
            where=f"robots.{rid}",
        )
    return SiteFacts(
        digest=site_digest(site),
        robot=RobotFacts(
            rid=rid,
            profile=profile,
            tools={kind: frozenset(tools) for kind, tools in robot.profile.tools.items()},
        ),
        regions={
            region: RegionFacts(polygon(m.map, m.floor, m.points), frozenset(m.tags))
            for region, m in site.regions.items()
        },
        objects={item: model.kind for item, model in site.objects.items()},
        vocabulary={kind: _kind(model) for kind, model in site.vocabulary.items()},
    )


def _kind(model: ActionModel) -> ActionKind:
    return ActionKind(
        fields=frozenset(model.fields),
        params={
            name: ParameterKind(
                low=p.low, high=p.high, required=p.required, monitored_by=p.monitored_by
            )
            for name, p in model.params.items()
        },
        moves=model.moves,
        waits=model.waits,
        records=model.records,
        stores=model.stores,
        transmits=model.transmits,
        privacy=model.privacy,
        state_writing=model.state_writing,
    )
