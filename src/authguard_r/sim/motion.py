# SPDX-License-Identifier: Apache-2.0
"""How the symbolic robot moves from moment to moment: along a way, by a velocity, braking.

Braking is in closed form: where the robot comes to rest does not depend on how often one looks.
How-to: docs/howto/simulator.md
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from math import cos, sin

from msgspec import Struct

from authguard_r.core.identifiers import Integer, ParameterId
from authguard_r.core.standing import Outcome
from authguard_r.sim.state import WorldState
from authguard_r.sim.world import LATERAL, LINEAR, TURNING, Point, hypot_mm, path_length_mm

#: Longer than any braking.
_LONG_MS = 1 << 40


class Brake(Struct, frozen=True, kw_only=True):
    """Brakes that act.

    Args:
        speed_mm_s: when they began to.
        brake_mm_s2: deceleration.
        since_ms: simulated time when they began to.
        done_um: how much of the way was behind the robot then.
        outcome: how the action has ended once the robot stands.
    """

    speed_mm_s: int
    brake_mm_s2: int
    since_ms: int
    done_um: int
    outcome: Outcome


class Velocity(Struct, frozen=True, kw_only=True):
    """What a stream asks for, in the robot's own frame."""

    linear_mm_s: int = 0
    lateral_mm_s: int = 0
    turn_urad_s: int = 0

    @property
    def speed_mm_s(self) -> int:
        """How fast that is."""
        return hypot_mm(self.linear_mm_s, self.lateral_mm_s)


def speed_after(brake: Brake, passed_ms: int) -> int:
    """Return the speed after so long of braking; 0 only once the robot stands."""
    return max(0, brake.speed_mm_s - brake.brake_mm_s2 * passed_ms // 1_000)


def way_um(brake: Brake, passed_ms: int) -> int:
    """Return how far the robot has gone since it began to brake; v**2 / 2a in the end."""
    speed, rate = brake.speed_mm_s, brake.brake_mm_s2
    if rate * passed_ms >= speed * 1_000:
        return speed * speed * 1_000 // (2 * rate)
    return speed * passed_ms - rate * passed_ms * passed_ms // 2_000


def along(path: tuple[Point, ...], done_mm: int) -> Point:
    """Return the point `done_mm` along the way."""
    left = done_mm
    for a, b in pairwise(path):
        length = path_length_mm((a, b))
        if left < length:
            return (
                a[0] + (b[0] - a[0]) * left // length,
                a[1] + (b[1] - a[1]) * left // length,
            )
        left -= length
    return path[-1]


def drifted(
    state: WorldState, velocity: Velocity, rest_um: Point, tick_ms: int
) -> tuple[Point, Point]:
    """Return where a velocity leads in one tick, and what is left below a millimeter.

    Args:
        state: where the robot is and which way it looks.
        velocity: in the robot's frame.
        rest_um: what the tick before left.
        tick_ms: how long.
    """
    dx, dy = _step_um(velocity, state.heading_urad, tick_ms)
    x_um, y_um = rest_um[0] + dx, rest_um[1] + dy
    there = (state.x_mm + x_um // 1_000, state.y_mm + y_um // 1_000)
    return there, (x_um % 1_000, y_um % 1_000)


def straight_way(state: WorldState, velocity: Velocity, brake: Brake) -> tuple[Point, ...]:
    """Return the straight way on which a robot that goes by a velocity comes to rest."""
    here = (state.x_mm, state.y_mm)
    dx, dy = _step_um(velocity, state.heading_urad, 1_000)
    whole_mm = way_um(brake, _LONG_MS) // 1_000 + 1
    speed_um = max(1, velocity.speed_mm_s * 1_000)
    return (here, (here[0] + dx * whole_mm // speed_um, here[1] + dy * whole_mm // speed_um))


def asked_velocity(params: Mapping[ParameterId, Integer]) -> Velocity:
    """Return the velocity in the parameters of a `drive` or of a sample; absent is zero."""
    return Velocity(
        linear_mm_s=params.get(LINEAR, 0),
        lateral_mm_s=params.get(LATERAL, 0),
        turn_urad_s=params.get(TURNING, 0),
    )


def scaled(velocity: Velocity, permille: int) -> Velocity:
    """Return the real velocity of a robot that goes faster, or slower, than its command.

    Args:
        velocity: what was asked for.
        permille: real speed in thousandths of that.
    """
    return Velocity(
        linear_mm_s=velocity.linear_mm_s * permille // 1_000,
        lateral_mm_s=velocity.lateral_mm_s * permille // 1_000,
        turn_urad_s=velocity.turn_urad_s * permille // 1_000,
    )


def _step_um(velocity: Velocity, heading_urad: int, tick_ms: int) -> Point:
    """Return how far a velocity leads in the map's frame, in micrometers."""
    angle = heading_urad / 1_000_000
    ahead, aside = velocity.linear_mm_s * tick_ms, velocity.lateral_mm_s * tick_ms
    return (
        round(ahead * cos(angle) - aside * sin(angle)),
        round(ahead * sin(angle) + aside * cos(angle)),
    )
