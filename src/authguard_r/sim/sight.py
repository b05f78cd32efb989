# SPDX-License-Identifier: Apache-2.0
"""What the sensors say of the world: values and a pose, unsigned."""

from __future__ import annotations

from authguard_r.core.identifiers import Identifier, RobotId, VariableId
from authguard_r.core.provenance import Label
from authguard_r.core.state import Pose, Reading, Snapshot
from authguard_r.sim.state import WorldState
from authguard_r.sim.world import NOTHING

#: Radius that holds the robot's true position, in millimeters.
MARGIN_MM = 150
_TRUSTED = Label.TRUSTED_SENSOR


def snapshot_of(
    state: WorldState,
    *,
    robot: RobotId,
    epoch: int,
    seq: int,
    pose_age_ms: int = 0,
    fence: int = 0,
    pose_fence: int = 0,
) -> Snapshot:
    """Return what an estimator says of the world, each value with the fence it was seen after."""
    values: dict[str, int | bool | Identifier] = {
        "battery_permille": state.battery_permille,
        "holding": state.holding or NOTHING,
        "human_distance_mm": state.human_distance_mm,
        "speed_mm_s": state.speed_mm_s,
        **{str(name): is_open for name, is_open in state.doors.items()},
        **{f"{thing}.{c}": True for thing, held in state.things.items() for c in held},
    }
    return Snapshot(
        robot=robot,
        epoch=epoch,
        seq=seq,
        pose=Pose(
            map=state.map,
            floor=state.floor,
            x_mm=state.x_mm,
            y_mm=state.y_mm,
            margin_mm=MARGIN_MM,
            label=_TRUSTED,
            age_ms=pose_age_ms,
            fence=pose_fence,
        ),
        readings={
            VariableId(name): Reading(value=value, label=_TRUSTED, age_ms=0, fence=fence)
            for name, value in sorted(values.items())
        },
    )
