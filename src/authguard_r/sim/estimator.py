# SPDX-License-Identifier: Apache-2.0
"""The estimator as a process: raw values in, signed snapshots out, never fresher than they are.

A value's age is counted from when it was measured, so that a robot's process that is dead or slow
makes old snapshots. How-to: docs/howto/simulator.md
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

from authguard_r.client.attesting import Attester, AttestingEnd, Measurement
from authguard_r.client.handshake import GateVerifier
from authguard_r.client.link import ProcessLog, require_folder, run_all, until_signal, wall_now
from authguard_r.client.sensing import listen, read_raw
from authguard_r.core.identifiers import RobotId
from authguard_r.core.principals import Signer
from authguard_r.wire.frames import Frame


class Estimator:
    """What the sensors said last, and what is signed of it when (`client.attesting`).

    Args:
        robot: whose sensors these are.
        signer: the estimator's key.
        epoch: grows with each start; the wall clock in milliseconds does.
        rate_hz: most snapshots in a second.
    """

    def __init__(self, robot: RobotId, signer: Signer, *, epoch: int, rate_hz: int) -> None:
        self._robot = robot
        self.attester = Attester(signer, epoch=epoch, rate_hz=rate_hz)
        self.seen: Measurement | None = None

    def heard(self, item: Frame, now_ms: int) -> None:
        """Take raw values from the sensors.

        Raises:
            MalformedError: it is no snapshot of this robot.
        """
        self.seen = read_raw(item, now_ms, self._robot)


class EstimatorProcess:
    """The estimator between the sensors and the gate.

    Args:
        robot: whose state it attests.
        signer: its key.
        run: the folder with the sockets.
        trust: reads the trust root, for each connection anew.
        rate_hz: most snapshots in a second.
        ready: called once, when the gate has taken the first snapshot.
    """

    def __init__(
        self,
        robot: RobotId,
        signer: Signer,
        run: Path,
        *,
        trust: Callable[[], GateVerifier],
        rate_hz: int,
        ready: Callable[[], None],
    ) -> None:
        self._log = ProcessLog()
        self._run = run
        self._estimator = Estimator(robot, signer, epoch=wall_now().utc_ms, rate_hz=rate_hz)
        self._end = AttestingEnd(
            robot,
            self._estimator.attester,
            run,
            trust=trust,
            look=lambda _: self._estimator.seen,
            ready=ready,
            log=self._log,
        )

    async def serve(self, until: asyncio.Event) -> None:
        """Run until the event is set."""
        listening = listen(self._run, self._estimator.heard, self._log)
        await run_all((self._end.stay(), listening, self._end.sign()), until=until)


def run_estimator(
    robot: RobotId,
    signer: Signer,
    run: Path,
    *,
    trust: Callable[[], GateVerifier],
    rate_hz: int,
    ready: Callable[[], None],
) -> None:
    """Run the estimator's process until SIGTERM or SIGINT.

    Raises:
        EnvironmentFault: there is no such folder.
    """
    require_folder(run)
    process = EstimatorProcess(robot, signer, run, trust=trust, rate_hz=rate_hz, ready=ready)
    asyncio.run(until_signal(process.serve))
