# SPDX-License-Identifier: Apache-2.0
"""The emergency policy: what a robot may do without a mission, signed by a safety officer.

Everything in a capability is fixed: a caller names it and adds nothing. What a capability does
not say it works without, it does not work without. Spec page: docs/spec/emergency.md#policy
"""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Literal

from msgspec import Meta, Struct

from authguard_r.core.identifiers import (
    ActionType,
    Count,
    Digest,
    Identifier,
    Integer,
    ParameterId,
    RegionId,
    RobotId,
    Timestamp,
    ToolId,
)
from authguard_r.core.mission import Guard

#: Most capabilities of a policy: what is pre-authorized is small.
MOST_CAPABILITIES = 16
#: Longest time that one call may take, in milliseconds.
MOST_MS = 600_000
HOUR_MS = 3_600_000
#: Most uses of one capability by one caller in an hour, those that were given back included.
MOST_PER_HOUR = 60


class Aim(StrEnum):
    """What a capability is for. There is no fourth: braking needs no capability."""

    CALL_HELP = "call_help"
    RELEASE_FORCE = "release_force"
    SAFE_PLACE = "safe_place"


class Caller(StrEnum):
    """Who may call a capability; `gate` is the gate itself, as soon as the guards hold."""

    GATE = "gate"
    OPERATOR = "operator"
    PLANNER = "planner"


class Missing(StrEnum):
    """What may be missing while a capability still works."""

    CLOCK = "clock"
    MISSION = "mission"
    STORE = "store"


class Capability(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True):
    """One pre-authorized act, with nothing left open.

    Args:
        id: what a caller names.
        aim: what it is for; says which types and fields it may have.
        type: canonical action type of the site's vocabulary.
        tool: the tool that carries it out.
        guards: all must hold on attested state when it begins and until it ends; one at least.
        callers: sorted; a caller that is not named is refused.
        max_ms: longest time that it may take.
        per_hour: most uses within an hour, for each caller by itself.
        destination: one of the site's emergency places; for `safe_place` alone.
        params: every parameter's value.
        regions: where the robot must be the whole time; required of what moves.
        place_max_age_ms: how old the place and monitored values may be.
        without: sorted; what may be missing.
        after_stop: works while an operator's stop stands, too.
        past_safety: begun although the safety gate calls it unsafe; only what does not move.
    """

    id: Identifier
    aim: Aim
    type: ActionType
    tool: ToolId
    guards: Annotated[tuple[Guard, ...], Meta(min_length=1, max_length=16)]
    callers: Annotated[tuple[Caller, ...], Meta(min_length=1, max_length=3)]
    max_ms: Annotated[int, Meta(ge=1, le=MOST_MS)]
    per_hour: Annotated[int, Meta(ge=1, le=MOST_PER_HOUR)]
    destination: RegionId | None = None
    params: dict[ParameterId, Integer] = {}
    regions: tuple[RegionId, ...] = ()
    place_max_age_ms: Count = 0
    without: tuple[Missing, ...] = ()
    after_stop: bool = False
    past_safety: bool = False


class EmergencyPolicy(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One robot's emergency policy.

    Args:
        schema: version of this format.
        id: name of the policy.
        version: grows with each change.
        robot: the robot.
        profile: digest of its capability profile.
        site: digest of the site whose words it speaks.
        not_before: from when on it counts.
        expiry: until when.
        capabilities: what it allows; everything else is refused.
    """

    schema: Literal["authguard-r/emergency-policy/1"]
    id: Identifier
    version: Count
    robot: RobotId
    profile: Digest
    site: Digest
    not_before: Timestamp
    expiry: Timestamp
    capabilities: Annotated[
        tuple[Capability, ...], Meta(min_length=1, max_length=MOST_CAPABILITIES)
    ]
