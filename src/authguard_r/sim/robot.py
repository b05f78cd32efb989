# SPDX-License-Identifier: Apache-2.0
"""The symbolic robot: a controller, an estimator and a clock that share one simulated time.

Implements `core.ports.Controller`, `StateSource` and `Clock`. Time passes only in a pause, so a run
of minutes takes milliseconds and is the same every time; a process that pauses as real time passes
has a robot in real time. Faults are injected, not guessed: drift off the way, a failed grasp, an
estimator that stopped looking. How-to: docs/howto/simulator.md
"""

from __future__ import annotations

import msgspec
from msgspec import Struct

from authguard_r.core.action import Action
from authguard_r.core.encoding import Tag
from authguard_r.core.errors import ControllerError
from authguard_r.core.identifiers import RegionId, RobotId
from authguard_r.core.lease import Lease
from authguard_r.core.principals import Signer
from authguard_r.core.standing import Outcome, Spend
from authguard_r.core.state import Snapshot
from authguard_r.core.token import sign_object
from authguard_r.sim.motion import (
    Brake,
    Velocity,
    along,
    asked_velocity,
    drifted,
    scaled,
    speed_after,
    straight_way,
    way_um,
)
from authguard_r.sim.sight import snapshot_of
from authguard_r.sim.state import WorldState
from authguard_r.sim.world import (
    DRIVEN,
    DURATION,
    FULL_TURN_URAD,
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


class Faults(Struct, frozen=True, kw_only=True):
    """What goes wrong.

    Args:
        drift_to: the robot leaves its way for this region instead of its goal.
        grasp_fails: a grip closes on nothing.
        localization_stops_ms: after this much simulated time the pose only grows older.
        estimator_dies_ms: after this much simulated time no snapshot comes any more.
        controller_refuses: a command is not begun.
        overspeed_permille: real speed, in thousandths of what was asked for.
        ignores_stops: the controller's process carries out no stop, not even its own.
        answers_late_ms: the controller's process answers that much later.
    """

    drift_to: RegionId | None = None
    grasp_fails: bool = False
    localization_stops_ms: int | None = None
    estimator_dies_ms: int | None = None
    controller_refuses: bool = False
    overspeed_permille: int = 1_000
    ignores_stops: bool = False
    answers_late_ms: int = 0


class Executed(Struct, frozen=True, kw_only=True):
    """What the world saw: an action begun in a state at a time, and how it ended."""

    action: Action
    before: WorldState
    utc_ms: int
    outcome: Outcome | None


class SimulatedGoal:
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
        estimator: signs snapshots; a person's machine would keep this key elsewhere. None where
            another process signs them: then `latest` says nothing, and `sensed` what is seen.
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
        estimator: Signer | None,
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
        self._handle: SimulatedGoal | None = None
        self._path: tuple[Point, ...] = ()
        self._path_done_um = 0
        self._left_ms = 0
        self._brake: Brake | None = None
        self._velocity: Velocity | None = None
        self._rest_um: Point = (0, 0)
        self._token: bytes | None = None
        self._snapshot: Snapshot | None = None
        self._seen_ms = 0
        self.newest_fence = self._seen_fence = 0
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
        """Return the newest snapshot, signed when it is asked for."""
        if self._token is None and self._snapshot is not None and self._estimator is not None:
            self._token = sign_object(self._snapshot, Tag.STATE, self._estimator)
        return self._token

    def fence(self, number: int) -> None:
        """Look again, at once."""
        self.newest_fence = number
        self._observe()

    def sensed(self) -> Snapshot | None:
        """Return what the sensors see right now, unsigned; None when they are silent."""
        dies = self.faults.estimator_dies_ms
        if dies is not None and self.elapsed_ms >= dies:
            return None
        return self._seen(epoch=0, seq=0)

    # Controller

    def dispatch(self, action: Action, lease: Lease) -> SimulatedGoal:  # noqa: ARG002 - the gate watches
        """Begin the action.

        Raises:
            ControllerError: it cannot be begun.
        """
        return self.begin(action)

    def begin(self, action: Action) -> SimulatedGoal:
        """Begin an action that leads where its way leads, to its end.

        Raises:
            ControllerError: it cannot be begun.
        """
        self._require_idle()
        took = duration_ms(self.site, self.state, action)
        if took is None:
            raise ControllerError("the action cannot be carried out from here")
        handle = self._fly(action, took)
        self._path = plan_path(self.site, self.state, self._steered(action)) or ()
        if took == 0:
            self._finish(handle)
        return handle

    def begin_stream(self, action: Action) -> SimulatedGoal:
        """Begin to move by a velocity, which `steer` changes, for as long as the action says.

        It leads where it leads; a wall is the end of it.

        Raises:
            ControllerError: it cannot be begun.
        """
        self._require_idle()
        handle = self._fly(action, action.params.get(DURATION, 0))
        self._rest_um = (0, 0)
        self.steer(asked_velocity(action.params))
        return handle

    def steer(self, velocity: Velocity) -> None:
        """Change the velocity of the stream that runs; brakes that act are not let go for it."""
        if self._brake is None:
            self._velocity = scaled(velocity, self.faults.overspeed_permille)
            self._be_at((self.state.x_mm, self.state.y_mm), self._velocity.speed_mm_s)

    def brake(self, outcome: Outcome = Outcome.ABORTED) -> None:
        """Brake as the profile says: the action has ended once the robot stands.

        A robot whose profile does not say how it brakes stands at once.
        """
        handle, rate = self._handle, self.site.robots[self.rid].profile.brake_mm_s2
        if handle is None or handle.ended is not None or self._brake is not None:
            return
        speed = self.state.speed_mm_s
        if rate is None or speed == 0:
            self._end(handle, outcome)
            return
        brake = Brake(
            speed_mm_s=speed,
            brake_mm_s2=rate,
            since_ms=self.elapsed_ms,
            done_um=self._path_done_um,  # a stream has no way behind it
            outcome=outcome,
        )
        if self._velocity is not None:
            self._path = straight_way(self.state, self._velocity, brake)
        self._brake = brake

    def stop(self) -> None:
        """Stand and hold, at once: for a run in simulated time, whose gate waits for no brakes."""
        self.stops += 1
        handle = self._handle
        if handle is not None and handle.ended is None:
            self._end(handle, Outcome.ABORTED)
        self._handle = None
        self.state = msgspec.structs.replace(self.state, speed_mm_s=0)
        self._observe()

    def _require_idle(self) -> None:
        if self.faults.controller_refuses:
            raise ControllerError("the controller does not answer")
        if self._handle is not None and self._handle.ended is None:
            raise ControllerError("another action runs")

    def _fly(self, action: Action, took_ms: int) -> SimulatedGoal:
        self._handle = SimulatedGoal(self, action)
        self._left_ms, self._path_done_um, self._velocity = took_ms, 0, None
        self.trace.append(
            Executed(action=action, before=self.state, utc_ms=self.wall_ms(), outcome=None)
        )
        return self._handle

    # the world

    def _steered(self, action: Action) -> Action:
        """Return where the robot really goes: a drifting one leaves its way."""
        if self.faults.drift_to is None or action.type != "navigate":
            return action
        return msgspec.structs.replace(action, destination=self.faults.drift_to, route=())

    def _advance(self, tick_ms: int) -> None:
        handle = self._handle
        if handle is None or handle.ended is not None:
            return
        if self._brake is not None:
            self._slow_down(handle, self._brake, tick_ms)
            return
        self._left_ms -= tick_ms
        if self._velocity is not None:
            self._drift(handle, self._velocity, tick_ms)
        elif handle.action.type in DRIVEN:
            self._drive(handle, tick_ms)
        else:
            handle.waited_ms += tick_ms if handle.action.type == "wait" else 0
            if self._left_ms <= 0:
                self._finish(handle)

    def _drive(self, handle: SimulatedGoal, tick_ms: int) -> None:
        speed = speed_of(handle.action) * self.faults.overspeed_permille // 1_000
        handle.moved_ms += tick_ms
        self._path_done_um += speed * tick_ms
        timed = handle.action.type == "drive"
        if self._left_ms <= 0 if timed else self._is_at_the_end(self._path_done_um):
            self._finish(handle)
            return
        self._be_at(along(self._path, self._path_done_um // 1_000), speed)

    def _drift(self, handle: SimulatedGoal, velocity: Velocity, tick_ms: int) -> None:
        """Move by a velocity; what is left below a millimeter is kept for the next tick."""
        handle.moved_ms += tick_ms
        there, self._rest_um = drifted(self.state, velocity, self._rest_um, tick_ms)
        turned = velocity.turn_urad_s * tick_ms // 1_000
        heading = (self.state.heading_urad + turned) % FULL_TURN_URAD
        self.state = msgspec.structs.replace(self.state, heading_urad=heading)
        if not self._is_there_room(there):
            self._end(handle, Outcome.FAILED)
            return
        self._be_at(there, velocity.speed_mm_s)
        if self._left_ms <= 0:
            self._end(handle, Outcome.SUCCEEDED)

    def _slow_down(self, handle: SimulatedGoal, brake: Brake, tick_ms: int) -> None:
        handle.moved_ms += tick_ms
        passed = self.elapsed_ms - brake.since_ms
        done, speed = brake.done_um + way_um(brake, passed), speed_after(brake, passed)
        there = along(self._path, done // 1_000)
        stuck = self._velocity is not None and not self._is_there_room(there)
        if not stuck:
            self._be_at(there, speed)
        if stuck or speed == 0 or (self._velocity is None and self._is_at_the_end(done)):
            self._end(handle, brake.outcome)

    def _be_at(self, point: Point, speed_mm_s: int) -> None:
        self.state = msgspec.structs.replace(
            self.state, x_mm=point[0], y_mm=point[1], speed_mm_s=speed_mm_s
        )

    def _is_at_the_end(self, done_um: int) -> bool:
        return done_um // 1_000 >= path_length_mm(self._path)

    def _is_there_room(self, point: Point) -> bool:
        """True when the point is in a region: outside all of them there are walls."""
        return region_at(self.site, self.state, point) is not None

    def _finish(self, handle: SimulatedGoal) -> None:
        action = self._steered(handle.action)
        grips = handle.action.type in {"pick", "place"}
        after = delta(self.site, self.trace[-1].before, action)
        if after is None or (grips and self.faults.grasp_fails):
            self._end(handle, Outcome.FAILED)
            return
        handle.recorded_bytes = after.recorded_bytes - self.state.recorded_bytes
        self.state = msgspec.structs.replace(
            after, human_distance_mm=self.state.human_distance_mm, doors=self.state.doors
        )
        self._end(handle, Outcome.SUCCEEDED)

    def _end(self, handle: SimulatedGoal, outcome: Outcome) -> None:
        handle.ended = outcome
        self._brake = None
        self.trace[-1] = msgspec.structs.replace(self.trace[-1], outcome=outcome)
        region = self._region_here()
        self.state = msgspec.structs.replace(self.state, region=region, speed_mm_s=0)

    def _region_here(self) -> RegionId:
        here = (self.state.x_mm, self.state.y_mm)
        return region_at(self.site, self.state, here) or self.state.region

    # the estimator

    def _observe(self) -> None:
        """Sign what the sensors see, unless the estimator is dead."""
        dies = self.faults.estimator_dies_ms
        if dies is not None and self.elapsed_ms >= dies:
            return
        self._seq += 1
        self._token = None
        self._snapshot = self._seen(epoch=self._epoch, seq=self._seq)

    def _seen(self, *, epoch: int, seq: int) -> Snapshot:
        stops = self.faults.localization_stops_ms
        if stops is None or self.elapsed_ms < stops:
            self._seen_ms, self._seen_fence = self.elapsed_ms, self.newest_fence
        return snapshot_of(
            self.state,
            robot=self.rid,
            epoch=epoch,
            seq=seq,
            pose_age_ms=self.elapsed_ms - self._seen_ms,
            fence=self.newest_fence,
            pose_fence=self._seen_fence,
        )


__all__ = ["Executed", "Faults", "SimulatedGoal", "SymbolicRobot", "snapshot_of"]
