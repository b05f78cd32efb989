# SPDX-License-Identifier: Apache-2.0
"""What a safety officer signs under a tag of its own, and the defaults without a signature."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct

from authguard_r.core.encoding import Tag, digest_of
from authguard_r.core.identifiers import (
    ActionType,
    Count,
    Digest,
    Identifier,
    ObjectId,
    ParameterId,
    RegionId,
    RobotId,
    VariableId,
)
from authguard_r.site.model import Site, profile_digest

#: Stands for the action's own object in an `Executable` rule.
THE_OBJECT = "the-object"
SPEED = ParameterId("speed_mm_s")
#: The two parts of a velocity; their sum is never less than the speed.
VELOCITY = (ParameterId("linear_mm_s"), ParameterId("lateral_mm_s"))
SPEEDS = frozenset({SPEED, *VELOCITY})
#: Standard words that act on a thing where it stands.
IN_PLACE: frozenset[ActionType] = frozenset(
    map(
        ActionType,
        (
            *("break", "clean", "close", "cook", "describe", "dirty", "door_lock", "empty"),
            *("fill", "find", "inspect", "open", "put_in", "read_sensor", "slice"),
            *("turn_off", "turn_on", "use_up"),
        ),
    )
)


class Executable(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """An action type that can only be carried out while a variable has a value.

    Args:
        type: the action type.
        variable: the state variable.
        equals: the value it must have; `the-object` stands for the action's own object.
    """

    type: ActionType
    variable: VariableId
    equals: Identifier


#: What people read and a terminal prints: no line ends, nothing that is not ASCII.
Line = Annotated[str, Meta(pattern=r"\A[ -~]{1,1000}\Z")]
#: Where a Unix socket can be: its name has to fit the kernel's 108 bytes.
SocketPath = Annotated[str, Meta(pattern=r"\A/[!-~]{1,106}\Z")]
#: The longest time in which a checker may be asked, in milliseconds.
MAX_ASKED_MS = 1_000


class Rule(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True):
    """What the actions of a mission, in their order, must satisfy.

    Args:
        id: its name in findings; no two rules have the same.
        formula: docs/spec/safety.md#syntax.
        message: what a finding says instead of the formula.
    """

    id: Identifier
    formula: Line
    message: Line | None = None


class ExternalChecker(
    Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True
):
    """Another process that has to agree to every action.

    Args:
        id: its name in findings.
        socket: where it listens.
        timeout_ms: what has not answered by then did not agree.
        uid: the user that it has to run as; absent: the gate's own.
    """

    id: Identifier
    socket: SocketPath
    timeout_ms: Annotated[int, Meta(ge=1, le=MAX_ASKED_MS)]
    uid: Count | None = None


class SafetyConfig(
    Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True
):
    """What is physically safe for one robot at one site.

    Args:
        schema: version of this format.
        id: name of the configuration.
        version: grows with each change.
        rid: the robot.
        profile: digest of the capability profile whose envelope this is.
        max_speed_mm_s: top speed.
        max_force_mn: top gripping force, millinewton.
        max_payload_g: heaviest load.
        masses_g: mass of every object that may be lifted.
        keep_out: regions that the robot must never be sent to or through.
        human_distance_mm: at or under this distance to a person, `human_speed_mm_s` holds.
        human_speed_mm_s: top speed near people.
        max_age_ms: how old a reading may be.
        executable: rules of what can be carried out in which state.
        paced: for types that move and need not carry a speed, how fast the controller is
            configured to carry them out at most; such a type that is not here is unsafe.
        in_place: types that act on a thing where it stands and lift nothing.
        rules: what the mission's actions, in their order, must satisfy.
        checker: another process that has to agree; absent: none is asked.
    """

    schema: Literal["authguard-r/safety/1"]
    id: Identifier
    version: Count
    rid: RobotId
    profile: Digest
    max_speed_mm_s: Count
    max_force_mn: Count
    max_payload_g: Count
    masses_g: dict[ObjectId, Count]
    keep_out: tuple[RegionId, ...]
    human_distance_mm: Count
    human_speed_mm_s: Count
    max_age_ms: Count
    executable: tuple[Executable, ...] = ()
    paced: dict[ActionType, Count] = {}
    in_place: tuple[ActionType, ...] = ()
    rules: tuple[Rule, ...] = ()
    checker: ExternalChecker | None = None


def safety_digest(config: SafetyConfig) -> Digest:
    """Return the digest under which the log names the configuration."""
    return digest_of(Tag.SAFETY, config)


def default_config(site: Site, rid: RobotId) -> SafetyConfig:
    """Return the envelope of the robot's own profile, with hazardous regions kept out.

    For set-ups without a safety officer's own configuration. Near people it is slow; it lifts
    what the site knows the mass of; it goes nowhere hazardous. A type that carries no speed is
    taken to go at the profile's top speed.
    """
    profile = site.robots[rid].profile
    return SafetyConfig(
        schema="authguard-r/safety/1",
        id=f"{site.id}-default",
        version=0,  # it is not signed
        rid=rid,
        profile=profile_digest(profile),
        max_speed_mm_s=profile.max_speed_mm_s,
        max_force_mn=profile.max_force_mn,
        max_payload_g=profile.max_payload_g,
        masses_g={item: model.mass_g for item, model in site.objects.items()},
        keep_out=tuple(sorted(r for r, m in site.regions.items() if "hazardous" in m.tags)),
        human_distance_mm=1_200,
        human_speed_mm_s=300,
        max_age_ms=1_000,
        executable=(
            Executable(type=ActionType("pick"), variable=VariableId("holding"), equals="nothing"),
            Executable(type=ActionType("place"), variable=VariableId("holding"), equals=THE_OBJECT),
        ),
        paced={
            kind: profile.max_speed_mm_s
            for kind, model in site.vocabulary.items()
            if model.moves and not any(model.params[p].required for p in SPEEDS & set(model.params))
        },
        in_place=tuple(sorted(IN_PLACE.intersection(site.vocabulary))),
    )
