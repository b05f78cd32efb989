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
    Positive,
    PrincipalId,
    RegionId,
    RobotId,
    ToolId,
    VariableId,
)
from authguard_r.core.mission import Sources
from authguard_r.core.provenance import Label, allowed_of
from authguard_r.core.reasons import Reason
from authguard_r.site.shapes import stopping_margin

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
        tags: `public`, `restricted`, `private`, `hazardous`, or the site's own words.
        names: every external spelling.
        within: the region that this one is part of; inside its edges, on the same map and floor. A
            grant of the parent does not count for this one: a pose here lies in both, and both must
            be allowed.
    """

    map: Identifier
    floor: Integer
    points: Annotated[tuple[Point, ...], Meta(min_length=3, max_length=256)]
    approach: Point
    tags: tuple[Identifier, ...]
    names: tuple[str, ...] = ()
    within: RegionId | None = None


class Door(_Model, frozen=True, kw_only=True):
    """A passage between two regions, at a point that both have and that is on an edge.

    Args:
        between: the two regions, of one map; on two floors it is a lift or a stair.
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
    """One canonical action type; see `core.facts.ActionKind` for the flags.

    Args:
        physical: how badly a body or property can be hurt at worst, for all parameters: 0 not at
            all, 1 a bruise or a scratch, 2 an injury or a thing destroyed, 3 a life. For people who
            read the site and review a mission; the decision's risk does not weigh it yet.
        beside: a controller that can may begin it while another action runs, and another while
            this one runs; absent, no.
    """

    fields: tuple[Literal["destination", "object", "route", "source"], ...]
    params: dict[ParameterId, Parameter] = {}
    moves: bool = False
    waits: bool = False
    records: bool = False
    stores: bool = False
    transmits: bool = False
    privacy: Annotated[int, Meta(ge=0, le=3)] = 0
    physical: Annotated[int, Meta(ge=0, le=3)] = 0
    state_writing: bool = False
    beside: bool = False


class Profile(_Model, frozen=True, kw_only=True):
    """What a robot can do at all: the capability profile that missions and gates bind.

    Args:
        tools: for each action type, the tools that can do it.
        max_speed_mm_s: top speed.
        max_force_mn: top gripping force, millinewton.
        max_payload_g: heaviest load.
        max_accel_mm_s2: hardest acceleration.
        brake_mm_s2: deceleration that braking reaches at least, loaded.
        reaction_ms: longest time from the order to stop until the brakes act.
        controllers: for each controller, the SHA-256 of its configuration as it must be.
    """

    tools: dict[ActionType, tuple[ToolId, ...]]
    max_speed_mm_s: Count
    max_force_mn: Count
    max_payload_g: Count
    max_accel_mm_s2: Positive | None = None
    brake_mm_s2: Positive | None = None
    reaction_ms: Count | None = None
    controllers: dict[Identifier, Digest] = {}


class Robot(_Model, frozen=True, kw_only=True):
    """One robot of the site: its profile, and where it stands when nothing is asked of it."""

    profile: Profile
    home: RegionId


class PersonRole(StrEnum):
    """The roles of a person of the site; a certificate decides what a person may sign."""

    OPERATOR = "operator"
    SAFETY_OFFICER = "safety_officer"
    SITE_AUTHORITY = "site_authority"
    SUPERVISOR = "supervisor"


class Person(_Model, frozen=True, kw_only=True):
    """One person by the id of their certificate.

    Args:
        roles: sorted set; for people who read the site. No check reads it: a signature counts by
            the role in its certificate alone.
        names: what they are called.
    """

    roles: tuple[PersonRole, ...]
    names: tuple[str, ...] = ()


class EmergencyPlaces(_Model, frozen=True, kw_only=True):
    """Where a robot may be sent in an emergency.

    Args:
        places: for each such region, what it is for (`charging`, `assembly`). It grants nothing;
            a signed emergency policy may name these regions only.
    """

    places: dict[RegionId, Identifier]


class Site(_Model, frozen=True, kw_only=True):
    """Everything a mission may speak of.

    Args:
        schema: the language of this file.
        id: the site.
        version: counts up with each signed change.
        regions: where a robot can be allowed to be.
        objects: what it can be allowed to handle.
        robots: who can be sent.
        vocabulary: what an action can be.
        doors: how regions are connected.
        people: who is who; grants nothing.
        emergency: where a robot may be sent in an emergency.
        baseline: sorted set of types that only read names, types and versions; the site authority
            signs that they are harmless. They have no field, no parameter and no flag.
        channels: the site's own ways on which text reaches a planner, each with its label; a
            shipped one (`site.channels.CHANNELS`) to trust it less. None is more than `model`.
        sources: AllowedSrc(f) by field, sorted: no mission of the site is wider
            (docs/spec/provenance.md#source-sets).
    """

    schema: Literal["authguard-r/site/1"]
    id: Identifier
    version: Count
    regions: dict[RegionId, Region]
    objects: dict[ObjectId, ObjectModel]
    robots: dict[RobotId, Robot]
    vocabulary: dict[ActionType, ActionModel]
    doors: tuple[Door, ...] = ()
    people: dict[PrincipalId, Person] = {}
    emergency: EmergencyPlaces | None = None
    baseline: tuple[ActionType, ...] = ()
    channels: dict[Identifier, Label] = {}
    sources: Sources = {}


def site_digest(site: Site) -> Digest:
    """Return the digest that a mission binds as `site`."""
    return digest_of(Tag.SITE, site)


def profile_digest(profile: Profile) -> Digest:
    """Return the digest that a mission and a gate's certificate bind as `profile`."""
    return digest_of(Tag.PROFILE, profile)


def stopping_mm(profile: Profile, speed_mm_s: int) -> int | None:
    """Return how far the robot goes after the order to stop, rounded up.

    Args:
        profile: the robot's.
        speed_mm_s: how fast it is going.

    Returns:
        Millimeters: the way until the brakes act and the way they take; None when the profile
        does not say how it brakes.
    """
    if profile.brake_mm_s2 is None or profile.reaction_ms is None:
        return None
    return stopping_margin(
        0, speed_mm_s, reaction_ms=profile.reaction_ms, brake_mm_s2=profile.brake_mm_s2
    )


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
            f"the site `{site.id}` has no robot `{rid}` with the profile of its certificate: a "
            "robot whose profile changed needs a new certificate (authguard keys request), and "
            "each mission is compiled and signed again (authguard mission compile)",
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
            region: RegionFacts(
                area=polygon(m.map, m.floor, m.points),
                tags=frozenset(m.tags),
                around=frozenset(ancestors(site, region)),
            )
            for region, m in site.regions.items()
        },
        objects={item: model.kind for item, model in site.objects.items()},
        vocabulary={kind: _kind(model) for kind, model in site.vocabulary.items()},
        sources=allowed_of(site.sources),
    )


def ancestors(site: Site, region: RegionId) -> tuple[RegionId, ...]:
    """Return the regions that this one is within, nearest first; stops where a cycle closes."""
    found: dict[RegionId, None] = {}
    model = site.regions.get(region)
    while model is not None and model.within is not None and model.within not in found:
        found[model.within] = None
        model = site.regions.get(model.within)
    return tuple(found)


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
