# SPDX-License-Identifier: Apache-2.0
"""The symbolic robot as a process: its world in real time, its gate, its stop process, its sensors.

It calls the gate and the stop process; nothing can call it. How-to: docs/howto/simulator.md
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

from authguard_r.client.driver import TICK_S, Driver
from authguard_r.client.handshake import GateVerifier
from authguard_r.client.link import ProcessLog, mono_ms, require_folder, run_all, until_signal
from authguard_r.sim.body import SymbolicBody
from authguard_r.sim.robot import SymbolicRobot
from authguard_r.sim.sensors import LOOK_MS, SensorServer

SENSORS = "sensors.sock"


class RobotProcess:
    """One robot with its controller.

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
        body = SymbolicBody(robot, speed_up=speed_up)
        self.driver = Driver(body, run, trust=trust, log=ProcessLog(), ready=ready)
        self._sensors = SensorServer(run / SENSORS, robot.sensed, clock=mono_ms)

    async def serve(self, until: asyncio.Event) -> None:
        """Run until the event is set.

        Raises:
            EnvironmentFault: the sensors' socket cannot be made.
        """
        await self._sensors.open()
        try:
            await run_all((self.driver.stay(), self._look()), until=until)
        finally:
            await self._sensors.close()

    async def _look(self) -> None:
        look_ms = mono_ms()
        while True:
            now = mono_ms()
            if now >= look_ms:
                self._sensors.look()
                look_ms = max(look_ms + LOOK_MS, now)
            await asyncio.sleep(TICK_S)


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
    asyncio.run(until_signal(process.serve))
