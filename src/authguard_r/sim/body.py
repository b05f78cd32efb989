# SPDX-License-Identifier: Apache-2.0
"""The symbolic robot as the body behind a controller's state machine (`client.controller.Body`)."""

from __future__ import annotations

from collections.abc import Mapping

from authguard_r.core.action import Action
from authguard_r.core.identifiers import Digest, ParameterId
from authguard_r.core.standing import Outcome
from authguard_r.sim.motion import asked_velocity
from authguard_r.sim.robot import SimulatedGoal, SymbolicRobot
from authguard_r.sim.world import DURATION, LATERAL, LINEAR, TURNING

_STREAM = "drive"


class SymbolicBody:
    """A symbolic robot whose world goes on as time passes.

    Args:
        robot: body and world.
        speed_up: how often faster than the clock the world runs; 1 but for demonstrations.
    """

    sampled: frozenset[str] = frozenset({LINEAR, LATERAL, TURNING, DURATION})

    def __init__(self, robot: SymbolicRobot, *, speed_up: int = 1) -> None:
        self.robot = robot
        self.rid = robot.rid
        self._speed_up = speed_up

    @property
    def obeys(self) -> bool:
        """Carries out stops."""
        return not self.robot.faults.ignores_stops

    @property
    def late_ms(self) -> int:
        """Answers that much later."""
        return self.robot.faults.answers_late_ms

    @property
    def stands(self) -> bool:
        """It stands once its action has ended."""
        return True

    def has_room(self, action: Action) -> bool:  # noqa: ARG002 - the port's
        """Return False: it does one action at a time."""
        return False

    def begin(self, action: Action, ticket: Digest) -> SimulatedGoal:  # noqa: ARG002 - the port's
        """Begin an action.

        Raises:
            ControllerError: it cannot be begun.
        """
        begin = self.robot.begin_stream if self.streams(action) else self.robot.begin
        handle = begin(action)
        del self.robot.trace[:-1]  # a process lives long
        return handle

    def streams(self, action: Action) -> bool:
        """Return True for a velocity."""
        return action.type == _STREAM

    def steer(self, ticket: Digest, params: Mapping[str, int]) -> None:  # noqa: ARG002
        """Go on with this velocity; what it does not name is zero."""
        named = {ParameterId(name): value for name, value in params.items()}
        self.robot.steer(asked_velocity(named))

    def close(self, ticket: Digest) -> None:  # noqa: ARG002 - there is one
        """Brake; the stream has succeeded."""
        self.robot.brake(Outcome.SUCCEEDED)

    def brake(self) -> None:
        """Brake as the profile says."""
        self.robot.brake()

    def pass_time(self, ms: int) -> None:
        """Let the world go on."""
        self.robot.pause(ms * self._speed_up)
