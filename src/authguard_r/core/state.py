# SPDX-License-Identifier: Apache-2.0
"""The attested state: what an estimator signed, and when the gate received it.

A request never carries state. A snapshot that is older, foreign, unsigned or labelled by a
camera satisfies no guard. Source: section "Provenance Labels" (trusted state estimator),
section "Scope of the Proofs". Spec page: docs/spec/state.md
"""

from __future__ import annotations

from msgspec import Struct

from authguard_r.core import identifiers as ids
from authguard_r.core.encoding import Tag, digest, encode_fast
from authguard_r.core.facts import SiteFacts
from authguard_r.core.geometry import may_lie_in, must_lie_in
from authguard_r.core.provenance import Label
from authguard_r.core.quantities import Now


class Reading(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True):
    """One value of one variable.

    Args:
        value: an integer in the variable's unit, a truth value, or an identifier.
        label: where the estimator had it from; only `trusted_sensor` counts.
        age_ms: how old it was when the snapshot was made, in milliseconds.
        fence: the newest fence that the estimator had when it began to measure this; 0: none.
    """

    value: ids.Integer | bool | ids.Identifier
    label: Label
    age_ms: ids.Count
    fence: ids.Count = 0


class Pose(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True):
    """Where the robot is, with how much it may be wrong.

    Args:
        map: the map frame.
        floor: the floor.
        x_mm: position in millimeters.
        y_mm: position in millimeters.
        margin_mm: radius that holds the true position, in millimeters.
        label: as in `Reading`.
        age_ms: as in `Reading`.
        fence: as in `Reading`.
    """

    map: ids.Identifier
    floor: ids.Integer
    x_mm: ids.Integer
    y_mm: ids.Integer
    margin_mm: ids.Count
    label: Label
    age_ms: ids.Count
    fence: ids.Count = 0


class Snapshot(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True):
    """What an estimator signs: everything it knows at one moment.

    Args:
        robot: the robot it speaks of.
        epoch: grows with each start of the estimator.
        seq: grows with each snapshot of an epoch; a smaller or equal pair is a replay.
        pose: absent when the robot is not localized.
        readings: by variable.
    """

    robot: ids.RobotId
    epoch: ids.Count
    seq: ids.Count
    pose: Pose | None = None
    readings: dict[ids.VariableId, Reading] = {}


class AttestedState(Struct, frozen=True, kw_only=True):
    """A snapshot that the gate authenticated, with what every decision on it needs, once.

    Only `attest` makes one, so that bytes, digest and place are always this snapshot's.

    Args:
        snapshot: what was signed.
        data: its canonical bytes, which the log keeps with every decision.
        digest: their digest.
        place: every region that the pose may lie in; empty when it lies in none or is unknown.
        arrived_mono_ms: the gate's monotonic clock when it came in.
        fence: no decision rests on a value that was measured before the gate gave this number
            out, after the robot's last motion; 0: none is asked for, as while the robot moves.
    """

    snapshot: Snapshot
    data: bytes
    digest: ids.Digest
    place: frozenset[ids.RegionId]
    arrived_mono_ms: int
    fence: int = 0


def attest(snapshot: Snapshot, facts: SiteFacts, *, arrived_mono_ms: int) -> AttestedState:
    """Return the state that checks read; the caller has authenticated the snapshot."""
    data = encode_fast(snapshot)
    hashed, place = digest(Tag.STATE, data), place_of(snapshot, facts)
    return AttestedState(
        snapshot=snapshot, data=data, digest=hashed, place=place, arrived_mono_ms=arrived_mono_ms
    )


def place_of(snapshot: Snapshot, facts: SiteFacts) -> frozenset[ids.RegionId]:
    """Return every region that the robot may be in.

    A position inside a margin of two regions is in both, and passes only where both are allowed.
    Of a region and the one around it, only the inner counts once no doubt is left: granting the
    outer one grants nothing inside it.
    """
    pose = snapshot.pose
    if pose is None:
        return frozenset()
    point, margin = (pose.x_mm, pose.y_mm), pose.margin_mm
    near = {
        region: known
        for region, known in facts.regions.items()
        if (known.area.map, known.area.floor) == (pose.map, pose.floor)
        and may_lie_in(known.area, point, margin)
    }
    inner = (known for known in near.values() if must_lie_in(known.area, point, margin))
    return frozenset(near).difference(*(known.around for known in inner))


def age_ms(state: AttestedState, reading: Reading | Pose, now: Now) -> int:
    """Return how old a value is at `now`: its age when signed plus the time since it arrived."""
    return reading.age_ms + now.mono_ms - state.arrived_mono_ms
