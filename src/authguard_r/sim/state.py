# SPDX-License-Identifier: Apache-2.0
"""Everything that is true of the simulated world at one moment."""

from __future__ import annotations

from msgspec import Struct

from authguard_r.core.identifiers import ObjectId, RegionId, VariableId


class WorldState(Struct, frozen=True, kw_only=True):
    """Everything that is true of the world; only the estimator may speak of it to a gate.

    Args:
        x_mm: the robot's position.
        y_mm: the robot's position.
        map: the map it is on.
        floor: the floor it is on.
        region: the region it was last sent to or stands in.
        holding: object in the gripper, None when empty.
        places: where every other object lies.
        doors: by variable, whether it is open.
        battery_permille: charge.
        speed_mm_s: speed right now.
        human_distance_mm: distance to the nearest person.
        recorded_bytes: sensor data recorded so far.
        recordings: regions that were recorded, in order.
        heading_urad: which way it looks, microradian counterclockwise from the map's x axis.
        things: conditions of things, such as `open`; one that has none is absent.
        inside: for what was put in or on another thing, that thing.
        settings: last value of each of the robot's settings (`gait.gait_no`).
    """

    x_mm: int
    y_mm: int
    map: str
    floor: int
    region: RegionId
    holding: ObjectId | None
    places: dict[ObjectId, RegionId]
    doors: dict[VariableId, bool]
    battery_permille: int
    speed_mm_s: int
    human_distance_mm: int
    recorded_bytes: int = 0
    recordings: tuple[RegionId, ...] = ()
    heading_urad: int = 0
    things: dict[ObjectId, tuple[str, ...]] = {}
    inside: dict[ObjectId, ObjectId] = {}
    settings: dict[str, int] = {}
