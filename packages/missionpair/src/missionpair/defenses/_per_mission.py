# SPDX-License-Identifier: Apache-2.0
"""What depends on a mission and its robot alone, made once and kept for the next trials."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import Generic, TypeVar

from authguard_r.core.identifiers import RobotId
from authguard_r.core.mission import Mission
from missionpair.stage import Stage

T = TypeVar("T")
_MOST = 64


class PerMission(Generic[T]):
    """Keeps what was made of the last few missions.

    A mission is known by being the very same object, which never changes: comparing two would cost
    more than making what is kept.

    Args:
        make: makes it of a stage; reads nothing of it but its mission, site and robot.
    """

    def __init__(self, make: Callable[[Stage], T]) -> None:
        self._make = make
        self._held: OrderedDict[tuple[int, RobotId], tuple[Mission, T]] = OrderedDict()

    def of(self, stage: Stage) -> T:
        """Return what belongs to the mission that a stage is about, and to its robot."""
        mission = stage.scene.mission
        key = (id(mission), stage.sim.robot.rid)
        held = self._held.get(key)
        if held is not None and held[0] is mission:
            return held[1]
        made = self._make(stage)
        self._held[key] = (mission, made)
        if len(self._held) > _MOST:
            self._held.popitem(last=False)
        return made
