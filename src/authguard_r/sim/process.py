# SPDX-License-Identifier: Apache-2.0
"""The symbolic robot as a process: its world in real time, its gate, its stop lane, its sensors.

It calls the gate and the lane; nothing can call it. How-to: docs/howto/simulator.md
"""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Callable
from pathlib import Path

from authguard_r.client.greeting import GateVerifier
from authguard_r.core.identifiers import MAX_INTEGER, Identifier
from authguard_r.sim.controller import Channel, ControllerDesk, Sent
from authguard_r.sim.link import Caller, Log, mono_ms, require_folder, run_all, until_told
from authguard_r.sim.proof import Proven
from authguard_r.sim.robot import SymbolicRobot
from authguard_r.sim.sensors import LOOK_MS, SensorServer
from authguard_r.wire.frames import Frame, frame
from authguard_r.wire.messages import ClientRole, Kind

#: Time between two ticks of the world, in seconds.
TICK_S = 0.01
SOCKETS = {Channel.GATE: "gate.sock", Channel.STOP: "stop.sock"}
SENSORS = "sensors.sock"
#: Longest body of what a gate may send to a controller, in bytes.
BOUNDS = {
    Kind.DISPATCH: 1 << 16,
    Kind.RENEW: 1 << 12,
    Kind.HALT: 1 << 12,
    Kind.FORWARD: 1 << 12,
    Kind.CLOSE: 1 << 12,
    Kind.REPLY: 1 << 16,
    Kind.ERROR: 1 << 16,
    Kind.EVENT: 1 << 16,
}


class RobotProcess:
    """One controller between its connections.

    Args:
        robot: body and world; signs nothing.
        run: the folder with the sockets.
        trust: reads the trust root, for each connection anew.
        speed_up: how often faster than real time the world runs.
        ready: called once, when a gate has proved itself for the first time.
    """

    def __init__(
        self,
        robot: SymbolicRobot,
        run: Path,
        *,
        trust: Callable[[], GateVerifier],
        speed_up: int,
        ready: Callable[[], None],
    ) -> None:
        # not a time: a clock that was set back must not make a number of before
        life = secrets.randbelow(MAX_INTEGER) + 1
        self.desk = ControllerDesk(robot, life=life, now_ms=mono_ms(), speed_up=speed_up)
        self.log = Log()
        self._ready: Callable[[], None] | None = ready
        self._sensors = SensorServer(run / SENSORS, robot.sensed, clock=mono_ms)
        self._callers = {
            channel: Caller(
                run / name,
                role=ClientRole.CONTROLLER,
                client=Identifier(f"controller-{robot.rid}"[:64]),
                robot=robot.rid,
                trust=trust,
                bounds=BOUNDS,
                listener=_Ear(self, channel),
                log=self.log,
                allow_shadow=channel is Channel.STOP,  # a stop counts, whoever drives it
            )
            for channel, name in SOCKETS.items()
        }

    async def serve(self, until: asyncio.Event) -> None:
        """Run until the event is set.

        Raises:
            EnvironmentFault: the sensors' socket cannot be made.
        """
        await self._sensors.open()
        callers = [caller.stay() for caller in self._callers.values()]
        try:
            await run_all((*callers, self._pass_time()), until=until)
        finally:
            await self._sensors.close()

    def send(self, messages: tuple[Sent, ...]) -> None:
        """Send what the desk wants to be sent."""
        for sent in messages:
            self._callers[sent.channel].send(frame(sent.kind, sent.id, sent.body))

    def is_ready(self) -> None:
        """Say once that a gate is there."""
        if self._ready is not None:
            self._ready()
            self._ready = None

    async def _pass_time(self) -> None:
        look_ms = mono_ms()
        while True:
            now = mono_ms()
            self.send(self.desk.tick(now))
            if now >= look_ms:
                self._sensors.look()
                look_ms = max(look_ms + LOOK_MS, now)
            await asyncio.sleep(TICK_S)


class _Ear:
    """Brings what one connection says to the desk."""

    def __init__(self, process: RobotProcess, channel: Channel) -> None:
        self._process = process
        self._channel = channel

    def opened(self, proven: Proven) -> None:
        process = self._process
        process.send(process.desk.opened(self._channel, proven, mono_ms()))
        if self._channel is Channel.GATE:
            process.is_ready()

    def heard(self, item: Frame) -> None:
        process = self._process
        process.send(process.desk.handle(self._channel, item, mono_ms()))

    def closed(self) -> None:
        process = self._process
        process.send(process.desk.closed(self._channel, mono_ms()))


def run_robot(
    robot: SymbolicRobot,
    run: Path,
    *,
    trust: Callable[[], GateVerifier],
    speed_up: int = 1,
    ready: Callable[[], None],
) -> None:
    """Run the robot's process until SIGTERM or SIGINT.

    Raises:
        EnvironmentFault: the folder or the sensors' socket cannot be used.
    """
    require_folder(run)
    process = RobotProcess(robot, run, trust=trust, speed_up=speed_up, ready=ready)
    asyncio.run(until_told(process.serve))
