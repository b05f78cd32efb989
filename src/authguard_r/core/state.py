# SPDX-License-Identifier: Apache-2.0
"""The attested state: what an estimator signed, and when the gate received it.

A request never carries state. A snapshot that is older, foreign, unsigned or labelled by a
camera satisfies no guard. Source: section "Provenance Labels" (trusted state estimator),
section "Scope of the Proofs". Spec page: docs/spec/state.md
"""

from __future__ import annotations

from msgspec import Struct

from authguard_r.core.facts import SiteFacts
from authguard_r.core.geometry import may_lie_in
from authguard_r.core.identifiers import Count, Identifier, Integer, RegionId, RobotId, VariableId
from authguard_r.core.provenance import Label
from authguard_r.core.quantities import Now


class Reading(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One value of one variable.

    Args:
        value: an integer in the variable's unit, a truth value, or an identifier.
        label: where the estimator had it from; only `trusted_sensor` counts.
        age_ms: how old it was when the snapshot was made, in milliseconds.
    """

    value: Integer | bool | Identifier
    label: Label
    age_ms: Count


class Pose(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Where the robot is, with how much it may be wrong.

    Args:
        map: the map frame.
        floor: the floor.
        x_mm: position in millimeters.
        y_mm: position in millimeters.
        margin_mm: radius that holds the true position, in millimeters.
        label: as in `Reading`.
        age_ms: as in `Reading`.
    """

    map: Identifier
    floor: Integer
    x_mm: Integer
    y_mm: Integer
    margin_mm: Count
    label: Label
    age_ms: Count


class Snapshot(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True):
    """What an estimator signs: everything it knows at one moment.

    Args:
        robot: the robot it speaks of.
        epoch: grows with each start of the estimator.
        seq: grows with each snapshot of an epoch; a smaller or equal pair is a replay.
        pose: absent when the robot is not localized.
        readings: by variable.
    """

    robot: RobotId
    epoch: Count
    seq: Count
    pose: Pose | None = None
    readings: dict[VariableId, Reading] = {}


class AttestedState(Struct, frozen=True, kw_only=True):
    """A snapshot that the gate authenticated, with the place worked out once.

    Args:
        snapshot: what was signed.
        place: every region that the pose may lie in; empty when it lies in none or is unknown.
        arrived_mono_ms: the gate's monotonic clock when it came in.
    """

    snapshot: Snapshot
    place: frozenset[RegionId]
    arrived_mono_ms: int


def attest(snapshot: Snapshot, facts: SiteFacts, *, arrived_mono_ms: int) -> AttestedState:
    """Return the state that checks read; the caller has authenticated the snapshot."""
    return AttestedState(
        snapshot=snapshot, place=place_of(snapshot, facts), arrived_mono_ms=arrived_mono_ms
    )


def place_of(snapshot: Snapshot, facts: SiteFacts) -> frozenset[RegionId]:
    """Return every region that the robot may be in.

    A position inside a margin of two regions is in both, and passes only where both are allowed.
    """
    pose = snapshot.pose
    if pose is None:
        return frozenset()
    return frozenset(
        region
        for region, known in facts.regions.items()
        if known.area.map == pose.map
        and known.area.floor == pose.floor
        and may_lie_in(known.area, (pose.x_mm, pose.y_mm), pose.margin_mm)
    )


def age_ms(state: AttestedState, reading: Reading | Pose, now: Now) -> int:
    """Return how old a value is at `now`: its age when signed plus the time since it arrived."""
    return reading.age_ms + now.mono_ms - state.arrived_mono_ms
