# SPDX-License-Identifier: Apache-2.0
"""An estimator's end of the gate: signs what was measured, never fresher than it is.

Where the values come from, its owner knows: the symbolic robot's sensors, a robot's odometry.
Spec page: docs/spec/state.md#snapshot
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

from msgspec import Struct
from msgspec.structs import replace

from authguard_r.client.handshake import GateVerifier
from authguard_r.client.link import PersistentConnection, ProcessLog, mono_ms
from authguard_r.client.proof import Proven
from authguard_r.core.encoding import Tag
from authguard_r.core.errors import AuthGuardError
from authguard_r.core.identifiers import Identifier, RobotId
from authguard_r.core.principals import Signer
from authguard_r.core.state import Pose, Reading, Snapshot
from authguard_r.core.token import sign_object
from authguard_r.wire.faults import from_fault
from authguard_r.wire.frames import Frame, frame, read_body
from authguard_r.wire.messages import Attest, ClientRole, Fault, Fence, Kind

#: A snapshot without an answer for this long ends the connection, in milliseconds.
ANSWER_MS = 2_000
TICK_S = 0.005
GATE = "gate.sock"
BOUNDS = {Kind.REPLY: 1 << 16, Kind.ERROR: 1 << 16, Kind.EVENT: 1 << 16}
#: The id of a frame has so many bits.
_IDS = 1 << 32


class Measurement(Struct, frozen=True):
    """What was measured last, not signed yet.

    Args:
        snapshot: the values.
        measured_ms: when, on the machine's monotonic clock.
        path_ms: how much earlier it may have been measured, where the time of measurement is not
            given.
    """

    snapshot: Snapshot
    measured_ms: int
    path_ms: int = 0


class Attester:
    """What is signed when: at most one snapshot on its way, always of the newest values.

    Args:
        signer: the estimator's key.
        epoch: grows with each start; the wall clock in milliseconds does.
        rate_hz: most snapshots in a second.
    """

    def __init__(self, signer: Signer, *, epoch: int, rate_hz: int) -> None:
        self._signer = signer
        self._epoch = epoch
        self._period_ms = max(1, 1_000 // rate_hz)
        self._seq = 0
        self._asked_ms: int | None = None
        self._due_ms = 0
        #: The gate's newest fence, and when it came, on the monotonic clock.
        self._fence = self._fenced_ms = 0

    def fence(self, number: int, now_ms: int) -> None:
        """Take a fence from the gate: what is measured from now on carries its number."""
        self._fence, self._fenced_ms = number, now_ms

    def due(self, seen: Measurement | None, now_ms: int) -> bytes | None:
        """Return the next snapshot's frame.

        Args:
            seen: what is to be signed, older by the time since; None: nothing is.
            now_ms: the monotonic clock.

        Returns:
            None when there is nothing, none is due, or one is on its way.
        """
        if seen is None or self._asked_ms is not None or now_ms < self._due_ms:
            return None
        following = self._due_ms + self._period_ms
        self._due_ms = following if following > now_ms else now_ms + self._period_ms
        self._asked_ms = now_ms
        self._seq += 1
        fenced = since(seen, self._fence, self._fenced_ms)
        snapshot = aged(fenced, now_ms - seen.measured_ms)
        signed = replace(snapshot, epoch=self._epoch, seq=self._seq)
        token = sign_object(signed, Tag.STATE, self._signer)
        return frame(Kind.SNAPSHOT, self._seq % _IDS, Attest(token=token))

    def answered(self, item: Frame) -> AuthGuardError | None:
        """Take the gate's answer; return its refusal, if it is one."""
        self._asked_ms = None
        return from_fault(read_body(item.body, Fault)) if item.kind is Kind.ERROR else None

    def is_overdue(self, now_ms: int) -> bool:
        """True when the gate has left a snapshot unanswered for too long."""
        return self._asked_ms is not None and now_ms - self._asked_ms > ANSWER_MS

    def hung_up(self) -> None:
        """Forget what was on its way, and the fence: the connection is gone."""
        self._asked_ms = None
        self._fence = 0


def since(seen: Measurement, fence: int, fenced_ms: int) -> Snapshot:
    """Return the snapshot with the fence on every value that was measured after it came.

    One clock counts: the machine's monotonic one, on which the sensors say when they measured. A
    value of the same millisecond counts as before.
    """
    begun_ms = seen.measured_ms - seen.path_ms

    def number(value: Reading | Pose) -> int:
        return fence if begun_ms - value.age_ms > fenced_ms else 0

    snapshot, pose = seen.snapshot, seen.snapshot.pose
    return replace(
        snapshot,
        pose=None if pose is None else replace(pose, fence=number(pose)),
        readings={
            name: replace(reading, fence=number(reading))
            for name, reading in snapshot.readings.items()
        },
    )


def aged(snapshot: Snapshot, by_ms: int) -> Snapshot:
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


class AttestingEnd:
    """An estimator's connection to its gate.

    Args:
        robot: whose state it attests.
        attester: signs it.
        run: the folder with the gate's socket.
        trust: reads the trust root, for each connection anew.
        look: returns what there is to be signed; called with the monotonic clock.
        ready: called once, when the gate has taken the first snapshot.
        log: says what happens.
    """

    def __init__(
        self,
        robot: RobotId,
        attester: Attester,
        run: Path,
        *,
        trust: Callable[[], GateVerifier],
        look: Callable[[int], Measurement | None],
        ready: Callable[[], None],
        log: ProcessLog,
    ) -> None:
        self._attester = attester
        self._look = look
        self._log = log
        self._ready: Callable[[], None] | None = ready
        self._is_connected = False
        self._refused: AuthGuardError | None = None
        self._gate = PersistentConnection(
            run / GATE,
            role=ClientRole.ESTIMATOR,
            client=Identifier(f"estimator-{robot}"[:64]),
            robot=robot,
            trust=trust,
            bounds=BOUNDS,
            listener=self,
            log=log,
        )

    async def stay(self) -> None:
        """Keep the connection until this is canceled."""
        await self._gate.stay()

    async def sign(self) -> None:
        """Send what is due until this is canceled."""
        while True:
            now = mono_ms()
            if self._is_connected:
                data = self._attester.due(self._look(now), now)
                if data is not None:
                    self._gate.send(data)
                elif self._attester.is_overdue(now):
                    self._log.say("no answer", GATE)
                    self._gate.hang_up()
            await asyncio.sleep(TICK_S)

    # client.link.Listener

    def opened(self, proven: Proven) -> None:  # noqa: ARG002 - its proof is all that was asked
        """Begin to send."""
        self._is_connected = True

    def heard(self, item: Frame) -> None:
        """Take the gate's answer, or a fence."""
        if item.kind is Kind.EVENT:
            self._attester.fence(read_body(item.body, Fence).fence, mono_ms())
            return
        refusal = self._attester.answered(item)
        before, self._refused = self._refused, refusal
        if refusal is not None:
            # once, not for each snapshot that is refused for the same
            if before is None or (before.reason, before.where) != (refusal.reason, refusal.where):
                self._log.fault(GATE, refusal)
        elif self._ready is not None:
            self._ready()
            self._ready = None

    def closed(self) -> None:
        """Send nothing until there is a gate again."""
        self._is_connected = False
        self._attester.hung_up()
