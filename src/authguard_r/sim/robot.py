# SPDX-License-Identifier: Apache-2.0
"""The symbolic robot: a controller, an estimator and a clock that share one simulated time.

Implements `core.ports.Controller`, `StateSource` and `Clock`. Time passes only when somebody
pauses, so a run of minutes takes milliseconds and is the same every time. Faults are injected, not
guessed: drift off the way, a failed grasp, an estimator that stopped looking.
How-to: docs/howto/simulator.md
"""

from __future__ import annotations

from itertools import pairwise

import msgspec
from msgspec import Struct

from authguard_r.core.action import Action
from authguard_r.core.encoding import Tag
from authguard_r.core.errors import ControllerError
from authguard_r.core.identifiers import Identifier, RegionId, RobotId, VariableId
from authguard_r.core.lease import Lease
from authguard_r.core.ports import Signer
from authguard_r.core.provenance import Label
from authguard_r.core.standing import Outcome, Spend
from authguard_r.core.state import Pose, Reading, Snapshot
from authguard_r.core.token import sign_object
from authguard_r.sim.state import WorldState
from authguard_r.sim.world import (
    DRIVEN,
    NOTHING,
    Point,
    delta,
    duration_ms,
    path_length_mm,
    plan_path,
    region_at,
    speed_of,
)
from authguard_r.site.model import Site

#: The estimator looks this often, in milliseconds.
ESTIMATE_MS = 50
MARGIN_MM = 150


class Faults(Struct, frozen=True, kw_only=True):
    """What goes wrong.

    Args:
        drift_to: the robot leaves its way for this region instead of its goal.
        grasp_fails: a grip closes on nothing.
        localization_stops_ms: after this much simulated time the pose only grows older.
        estimator_dies_ms: after this much simulated time no snapshot comes any more.
        controller_refuses: a command is not begun.
        overspeed_permille: real speed, in thousandths of what was asked for.
    """

    drift_to: RegionId | None = None
    grasp_fails: bool = False
    localization_stops_ms: int | None = None
    estimator_dies_ms: int | None = None
    controller_refuses: bool = False
    overspeed_permille: int = 1_000


class Executed(Struct, frozen=True, kw_only=True):
    """What the world saw: an action begun in a state at a time, and how it ended."""

    action: Action
    before: WorldState
    utc_ms: int
    outcome: Outcome | None


class SimFlight:
    """One action while it runs (`core.ports.Flight`)."""

    def __init__(self, robot: SymbolicRobot, action: Action) -> None:
        self._robot = robot
        self.action = action
        self.begun_ms = robot.elapsed_ms
        self.ended: Outcome | None = None
        self.moved_ms = 0
        self.waited_ms = 0
        self.recorded_bytes = 0

    def outcome(self) -> Outcome | None:
        """Return how it ended, or None while it runs."""
        return self.ended

    def used(self) -> Spend:
        """Return what it has used so far."""
        return Spend(
            motion_ms=self.moved_ms, wait_ms=self.waited_ms, recorded_bytes=self.recorded_bytes
        )


class SymbolicRobot:
    """One robot in one simulated world.

    Args:
        site: the world's shape.
        rid: who the robot is.
        state: where everything is at first.
        estimator: signs snapshots; a person's machine would keep this key elsewhere.
        start_ms: simulated wall clock at the start, milliseconds since 1970.
        faults: what goes wrong.
        epoch: the estimator's start counter.
    """

    def __init__(
        self,
        site: Site,
        rid: RobotId,
        state: WorldState,
        *,
        estimator: Signer,
        start_ms: int,
        faults: Faults = Faults(),  # noqa: B008 - frozen
        epoch: int = 1,
    ) -> None:
        self.site = site
        self.rid = rid
        self.state = state
        self.faults = faults
        self.elapsed_ms = 0
        self.trace: list[Executed] = []
        self.stops = 0
        self._estimator = estimator
        self._start_ms = start_ms
        self._epoch = epoch
        self._seq = 0
        self._flight: SimFlight | None = None
        self._path: tuple[Point, ...] = ()
        self._path_done_mm = 0
        self._left_ms = 0
        self._token: bytes | None = None
        self._snapshot: Snapshot | None = None
        self._seen_ms = 0
        self._observe()

    # Clock

    def wall_ms(self) -> int:
        """Return the simulated wall clock."""
        return self._start_ms + self.elapsed_ms

    def mono_ms(self) -> int:
        """Return simulated time since the start."""
        return self.elapsed_ms

    def pause(self, duration_ms: int) -> None:
        """Let simulated time pass; the robot moves and the estimator looks."""
        left = duration_ms
        while left > 0:
            tick = min(left, ESTIMATE_MS - self.elapsed_ms % ESTIMATE_MS)
            self.elapsed_ms += tick
            left -= tick
            self._advance(tick)
            if self.elapsed_ms % ESTIMATE_MS == 0:
                self._observe()

    # StateSource

    def latest(self) -> bytes | None:
        """Return the newest snapshot, signed when somebody asks for it."""
        if self._token is None and self._snapshot is not None:
            self._token = sign_object(self._snapshot, Tag.STATE, self._estimator)
        return self._token

    # Controller

    def dispatch(self, action: Action, lease: Lease) -> SimFlight:  # noqa: ARG002 - the gate watches
        """Begin the action.

        Raises:
            ControllerError: it cannot be begun.
        """
        if self.faults.controller_refuses:
            raise ControllerError("the controller does not answer")
        if self._flight is not None and self._flight.ended is None:
            raise ControllerError("another action runs")
        took = duration_ms(self.site, self.state, action)
        if took is None:
            raise ControllerError("the action cannot be carried out from here")
        flight = SimFlight(self, action)
        self._flight, self._left_ms = flight, took
        self._path = plan_path(self.site, self.state, self._steered(action)) or ()
        self._path_done_mm = 0
        self.trace.append(
            Executed(action=action, before=self.state, utc_ms=self.wall_ms(), outcome=None)
        )
        if took == 0:
            self._finish(flight)
        return flight

    def stop(self) -> None:
        """Brake and hold."""
        self.stops += 1
        flight = self._flight
        if flight is not None and flight.ended is None:
            self._end(flight, Outcome.ABORTED)
        self._flight = None
        self.state = msgspec.structs.replace(self.state, speed_mm_s=0)
        self._observe()

    # the world

    def _steered(self, action: Action) -> Action:
        """Return where the robot really goes: a drifting one leaves its way."""
        if self.faults.drift_to is None or action.type != "navigate":
            return action
        return msgspec.structs.replace(action, destination=self.faults.drift_to, route=())

    def _advance(self, tick_ms: int) -> None:
        flight = self._flight
        if flight is None or flight.ended is not None:
            return
        self._left_ms -= tick_ms
        if flight.action.type in DRIVEN:
            self._drive(flight, tick_ms)
            return
        if flight.action.type == "wait":
            flight.waited_ms += tick_ms
        if self._left_ms <= 0:
            self._finish(flight)

    def _drive(self, flight: SimFlight, tick_ms: int) -> None:
        speed = speed_of(flight.action) * self.faults.overspeed_permille // 1_000
        flight.moved_ms += tick_ms
        self._path_done_mm += speed * tick_ms // 1_000
        timed = flight.action.type == "drive"
        if self._left_ms <= 0 if timed else self._path_done_mm >= path_length_mm(self._path):
            self._finish(flight)
            return
        x, y = _along(self._path, self._path_done_mm)
        self.state = msgspec.structs.replace(self.state, x_mm=x, y_mm=y, speed_mm_s=speed)

    def _finish(self, flight: SimFlight) -> None:
        action = self._steered(flight.action)
        grips = flight.action.type in {"pick", "place"}
        after = delta(self.site, self.trace[-1].before, action)
        if after is None or (grips and self.faults.grasp_fails):
            self._end(flight, Outcome.FAILED)
            return
        flight.recorded_bytes = after.recorded_bytes - self.state.recorded_bytes
        self.state = msgspec.structs.replace(
            after, human_distance_mm=self.state.human_distance_mm, doors=self.state.doors
        )
        self._end(flight, Outcome.SUCCEEDED)

    def _end(self, flight: SimFlight, outcome: Outcome) -> None:
        flight.ended = outcome
        self.trace[-1] = msgspec.structs.replace(self.trace[-1], outcome=outcome)
        region = self._region_here()
        self.state = msgspec.structs.replace(self.state, region=region, speed_mm_s=0)

    def _region_here(self) -> RegionId:
        here = (self.state.x_mm, self.state.y_mm)
        return region_at(self.site, self.state, here) or self.state.region

    # the estimator

    def _observe(self) -> None:
        """Sign what the sensors see, unless the estimator is dead."""
        dies, stops = self.faults.estimator_dies_ms, self.faults.localization_stops_ms
        if dies is not None and self.elapsed_ms >= dies:
            return
        lost = stops is not None and self.elapsed_ms >= stops
        if not lost:
            self._seen_ms = self.elapsed_ms
        self._seq += 1
        self._token = None
        self._snapshot = snapshot_of(
            self.state,
            robot=self.rid,
            epoch=self._epoch,
            seq=self._seq,
            pose_age_ms=self.elapsed_ms - self._seen_ms,
        )


def snapshot_of(
    state: WorldState, *, robot: RobotId, epoch: int, seq: int, pose_age_ms: int = 0
) -> Snapshot:
    """Return what an estimator says of the world."""
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
            label=Label.TRUSTED_SENSOR,
            age_ms=pose_age_ms,
        ),
        readings={
            VariableId(name): Reading(value=value, label=Label.TRUSTED_SENSOR, age_ms=0)
            for name, value in sorted(values.items())
        },
    )


def _along(path: tuple[Point, ...], done_mm: int) -> Point:
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
