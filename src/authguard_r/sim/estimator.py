# SPDX-License-Identifier: Apache-2.0
"""The estimator as a process: raw values in, signed snapshots out, never fresher than they are.

A value's age is counted from when it was measured, so that a robot's process that is dead or slow
makes old snapshots. How-to: docs/howto/simulator.md
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

from msgspec import Struct
from msgspec.structs import replace

from authguard_r.client.greeting import GateVerifier
from authguard_r.client.link import (
    FIRST_PAUSE_S,
    LONGEST_PAUSE_S,
    Caller,
    Log,
    mono_ms,
    require_folder,
    run_all,
    until_told,
    wall_now,
)
from authguard_r.client.proof import Proven
from authguard_r.core.encoding import Tag
from authguard_r.core.errors import AuthGuardError, MalformedError
from authguard_r.core.identifiers import Identifier, RobotId
from authguard_r.core.ports import Signer
from authguard_r.core.state import Snapshot
from authguard_r.core.token import sign_object
from authguard_r.sim.sensors import ID_MODULUS
from authguard_r.wire.faults import from_fault
from authguard_r.wire.frames import Frame, FrameReader, frame, read_body
from authguard_r.wire.messages import BOUND, Attest, ClientRole, Fault, Kind

#: A snapshot that nobody answers for so long ends the connection, in milliseconds.
ANSWER_MS = 2_000
TICK_S = 0.005
GATE, SENSORS = "gate.sock", "sensors.sock"
BOUNDS = {Kind.REPLY: 1 << 16, Kind.ERROR: 1 << 16, Kind.EVENT: 1 << 16}


class _Heard(Struct, frozen=True):
    """What the sensors said last, and when it was measured."""

    snapshot: Snapshot
    measured_ms: int


class Estimator:
    """What is signed when: at most one snapshot on its way, always of the newest values.

    Args:
        robot: whose sensors these are.
        signer: the estimator's key.
        epoch: grows with each start; the wall clock in milliseconds does.
        rate_hz: most snapshots in a second.
    """

    def __init__(self, robot: RobotId, signer: Signer, *, epoch: int, rate_hz: int) -> None:
        self._robot = robot
        self._signer = signer
        self._epoch = epoch
        self._period_ms = max(1, 1_000 // rate_hz)
        self._seq = 0
        self._heard: _Heard | None = None
        self._asked_ms: int | None = None
        self._due_ms = 0

    def heard(self, item: Frame, now_ms: int) -> None:
        """Take raw values from the sensors.

        Raises:
            MalformedError: it is no snapshot of this robot.
        """
        snapshot = read_body(item.body, Snapshot)
        if snapshot.robot != self._robot:
            raise MalformedError(
                f"expected values of `{self._robot}`, got `{snapshot.robot}`'s", where="robot"
            )
        # what claims to be of the future counts as very old
        age = (now_ms - item.id) % ID_MODULUS
        self._heard = _Heard(snapshot, now_ms - age)

    def due(self, now_ms: int) -> bytes | None:
        """Return the next snapshot's frame, None when none is due or one is on its way."""
        if self._heard is None or self._asked_ms is not None or now_ms < self._due_ms:
            return None
        following = self._due_ms + self._period_ms
        self._due_ms = following if following > now_ms else now_ms + self._period_ms
        self._asked_ms = now_ms
        self._seq += 1
        snapshot = _aged(self._heard.snapshot, now_ms - self._heard.measured_ms)
        signed = replace(snapshot, epoch=self._epoch, seq=self._seq)
        token = sign_object(signed, Tag.STATE, self._signer)
        return frame(Kind.SNAPSHOT, self._seq % ID_MODULUS, Attest(token=token))

    def answered(self, item: Frame) -> AuthGuardError | None:
        """Take the gate's answer; return its refusal, if it is one."""
        if item.kind is Kind.EVENT:
            return None
        self._asked_ms = None
        return from_fault(read_body(item.body, Fault)) if item.kind is Kind.ERROR else None

    def is_overdue(self, now_ms: int) -> bool:
        """True when the gate has left a snapshot unanswered for too long."""
        return self._asked_ms is not None and now_ms - self._asked_ms > ANSWER_MS

    def hung_up(self) -> None:
        """Forget what was on its way: the connection is gone."""
        self._asked_ms = None


def _aged(snapshot: Snapshot, by_ms: int) -> Snapshot:
    """Return the snapshot with every value so much older."""
    pose = snapshot.pose
    return replace(
        snapshot,
        pose=None if pose is None else replace(pose, age_ms=pose.age_ms + by_ms),
        readings={
            name: replace(reading, age_ms=reading.age_ms + by_ms)
            for name, reading in snapshot.readings.items()
        },
    )


class _SensorLink(asyncio.Protocol):
    """The connection to the sensors; it says nothing."""

    def __init__(self, process: EstimatorProcess) -> None:
        self.over = asyncio.Event()
        self._process = process
        self._reader = FrameReader(lambda kind: BOUND[Kind.SNAPSHOT] if kind == Kind.EVENT else 0)
        self._transport: asyncio.BaseTransport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = transport
        self._process.log.say("connected", SENSORS)

    def data_received(self, data: bytes) -> None:
        try:
            for item in self._reader.feed(data):
                self._process.estimator.heard(item, mono_ms())
        except MalformedError as error:
            self._process.log.fault(SENSORS, error)
            self.hang_up()

    def connection_lost(self, exc: Exception | None) -> None:  # noqa: ARG002 - gone is gone
        self.over.set()

    def hang_up(self) -> None:
        if isinstance(self._transport, asyncio.Transport):
            self._transport.abort()


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
        self.log = Log()
        epoch = wall_now().utc_ms
        self.estimator = Estimator(robot, signer, epoch=epoch, rate_hz=rate_hz)
        self._run = run
        self._ready: Callable[[], None] | None = ready
        self._is_connected = False
        self._gate = Caller(
            run / GATE,
            role=ClientRole.ESTIMATOR,
            client=Identifier(f"estimator-{robot}"[:64]),
            robot=robot,
            trust=trust,
            bounds=BOUNDS,
            listener=self,
            log=self.log,
        )

    async def serve(self, until: asyncio.Event) -> None:
        """Run until the event is set."""
        await run_all((self._gate.stay(), self._listen(), self._sign()), until=until)

    # client.link.Listener

    def opened(self, proven: Proven) -> None:  # noqa: ARG002 - its proof is all that was asked
        """Begin to send."""
        self._is_connected = True

    def heard(self, item: Frame) -> None:
        """Take the gate's answer."""
        refusal = self.estimator.answered(item)
        if refusal is not None:
            self.log.fault(GATE, refusal)
        elif self._ready is not None:
            self._ready()
            self._ready = None

    def closed(self) -> None:
        """Send nothing until there is a gate again."""
        self._is_connected = False
        self.estimator.hung_up()

    async def _sign(self) -> None:
        while True:
            now = mono_ms()
            if self._is_connected:
                data = self.estimator.due(now)
                if data is not None:
                    self._gate.send(data)
                elif self.estimator.is_overdue(now):
                    self.log.say("no answer", GATE)
                    self._gate.hang_up()
            await asyncio.sleep(TICK_S)

    async def _listen(self) -> None:
        """Keep the connection to the sensors until this is canceled."""
        pause, path = FIRST_PAUSE_S, str(self._run / SENSORS)
        while True:
            link = _SensorLink(self)
            if await self._is_open(link, path):
                pause = FIRST_PAUSE_S
            await asyncio.sleep(pause)
            pause = min(pause * 2, LONGEST_PAUSE_S)

    async def _is_open(self, link: _SensorLink, path: str) -> bool:
        """Listen while the connection lasts; return whether there was one."""
        try:
            await asyncio.get_running_loop().create_unix_connection(lambda: link, path)
            await link.over.wait()
        except OSError as error:
            self.log.say("unreachable", SENSORS, message=error.strerror or str(error))
            return False
        finally:
            link.hang_up()
        self.log.say("disconnected", SENSORS)
        return True


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
    asyncio.run(until_told(process.serve))
