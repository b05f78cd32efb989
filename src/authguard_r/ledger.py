# SPDX-License-Identifier: Apache-2.0
"""Every act that counts happens here: in the writer's turn, at a trusted time, with one record.

Trusted time never runs backwards: it is the wall clock or the last committed time plus what the
monotonic clock has counted since, whichever is later, and it is written with every commit. A wall
clock that is behind what was committed is a fault, not an excuse.
Spec page: docs/spec/store.md#time
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TypeVar

from msgspec import Struct

from authguard_r.audit.record import Entry, append
from authguard_r.core.encoding import decode, encode_fast
from authguard_r.core.errors import ClockError, MalformedError, StoreError
from authguard_r.core.identifiers import Digest, MissionId, RobotId
from authguard_r.core.ports import Clock, Store, Turn
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Standing

T = TypeVar("T")
#: How far the wall clock may be behind the last committed time, in milliseconds.
SKEW_MS = 2_000


class High(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What never runs backwards, written with every commit and read when a gate starts.

    Args:
        utc_ms: trusted time of the commit.
        mono_ms: the gate's monotonic clock at the commit.
        snapshot: epoch and seq of the newest snapshot that was taken in, (-1, -1) before any.
    """

    utc_ms: int
    mono_ms: int
    snapshot: tuple[int, int]


class Ledger:
    """One robot's store, clock and source of salts.

    `snapshot` is the epoch and seq of the newest snapshot, set by the intake and held with every
    commit, so that a restart does not take an old one for new.

    Args:
        store: durable before it answers.
        clock: the only source of time.
        robot: whose ledger this is.
        salts: returns that many fresh random bytes.
        genesis: what the log's first record says of the gate and its site.
        inputs: what replaying a decision needs beside the decision's own record.
    """

    def __init__(
        self,
        store: Store,
        clock: Clock,
        *,
        robot: RobotId,
        salts: Callable[[int], bytes],
        genesis: dict[str, object],
        inputs: dict[str, object] | None = None,
    ) -> None:
        self.store = store
        self._clock = clock
        self._salts = salts
        self.robot = robot
        self._mono_base = 0
        self._mono_start = clock.mono_ms()
        self._high = Now(0, 0)
        self.snapshot = (-1, -1)
        self._standings: dict[MissionId, tuple[int, Standing]] = {}
        self._decoded: dict[MissionId, tuple[bytes, Standing]] = {}
        self._turns = 0
        self._mirror = threading.Lock()
        store.run(lambda turn: self._open(turn, genesis, inputs or {}))

    def mono_ms(self) -> int:
        """Return the monotonic clock, which goes on across restarts of the gate."""
        return self._mono_base + self._clock.mono_ms() - self._mono_start

    def now(self) -> Now:
        """Return trusted time.

        Raises:
            ClockError: the wall clock is behind what was committed.
        """
        wall, mono = self._clock.wall_ms(), self.mono_ms()
        if wall < self._high.utc_ms - SKEW_MS:
            raise ClockError(
                f"the wall clock is {self._high.utc_ms - wall} ms behind the last committed time"
            )
        return Now(max(wall, self._high.utc_ms + mono - self._high.mono_ms), mono)

    def run(self, job: Callable[[Act], T]) -> T:
        """Run one act in the writer's turn; its effects and records are on disk on return.

        Raises:
            ClockError: nothing was done.
            StoreError: nothing was committed.
        """

        def turn_job(turn: Turn) -> tuple[T, Act]:
            self._turns += 1  # in the order of the turns, which is the order of the log
            act = Act(turn, self.now(), self._salts, order=self._turns, decoded=self._decoded)
            result = job(act)
            turn.put("clock", "high", self._marks(act.now))
            return result, act

        result, act = self.store.run(turn_job)
        with self._mirror:
            self._remember(act)
        return result

    def _marks(self, now: Now) -> bytes:
        return encode_fast(High(utc_ms=now.utc_ms, mono_ms=now.mono_ms, snapshot=self.snapshot))

    def standing(self, mid: MissionId) -> Standing | None:
        """Return the standing as last committed, without waiting for a turn."""
        known = self._standings.get(mid)
        return None if known is None else known[1]

    def note(self, entry: Callable[[int], Entry]) -> int:
        """Record something that needs no trustworthy clock: a refusal, a stop, an alert.

        Args:
            entry: makes the entry from the last trusted time.

        Raises:
            StoreError: it was not recorded.
        """
        time_ms = max(self._high.utc_ms, self._clock.wall_ms())

        def turn_job(turn: Turn) -> int:
            made = entry(time_ms)
            return append(turn, made, salts=self._salts(16 * len(made.sealed)))

        return self.store.run(turn_job)

    def _remember(self, act: Act) -> None:
        """Mirror what was committed; threads may come back in another order than they committed."""
        now, high = act.now, self._high
        if (now.utc_ms, now.mono_ms) > (high.utc_ms, high.mono_ms):
            self._high = now
        for mid, standing in act.held.items():
            known = self._standings.get(mid)
            if known is None or known[0] < act.order:
                self._standings[mid] = (act.order, standing)

    def close(self) -> None:
        """Let go of the store."""
        self.store.close()

    def _open(self, turn: Turn, genesis: dict[str, object], inputs: dict[str, object]) -> None:
        held = turn.get("clock", "high")
        if held is not None:
            high = read_held(held, High, "clock")
            self._high = Now(high.utc_ms, high.mono_ms)
            self._mono_base, self.snapshot = high.mono_ms, high.snapshot
        if turn.head()[0] == 0:
            entry = Entry(
                kind="genesis",
                time_ms=self._clock.wall_ms(),
                decision="genesis",
                open={"format": 1, "robot": self.robot, **genesis},
                sealed=inputs,
            )
            append(turn, entry, salts=self._salts(16 * len(inputs)))
            turn.put("log", "robot", self.robot.encode("ascii"))
        elif turn.get("log", "robot") != self.robot.encode("ascii"):
            raise StoreError(
                f"expected the store of `{self.robot}`",
                where="store",
                reason=Reason.ROBOT_MISMATCH,
            )


class Act:
    """One act inside the writer's turn: what it reads, holds and records.

    Args:
        turn: the writer's turn.
        now: read once for the whole act.
        salts: returns that many fresh random bytes.
        order: number of the turn; a later turn has a greater one.
        decoded: the last bytes of each standing with what they say; the bytes are always read.
    """

    def __init__(
        self,
        turn: Turn,
        now: Now,
        salts: Callable[[int], bytes],
        *,
        order: int,
        decoded: dict[MissionId, tuple[bytes, Standing]],
    ) -> None:
        self.order = order
        self._decoded = decoded
        self._turn = turn
        self._salts = salts
        self.now = now
        self.held: dict[MissionId, Standing] = {}

    def standing(self, mid: MissionId) -> Standing | None:
        """Return the registry's entry for a mission; read once in a turn."""
        if mid in self.held:
            return self.held[mid]
        held = self._turn.get("standing", mid)
        if held is None:
            return None
        known = self._decoded.get(mid)
        if known is None or known[0] != held:
            known = self._decoded[mid] = (held, read_held(held, Standing, "standing"))
        self.held[mid] = known[1]
        return known[1]

    def hold(self, standing: Standing) -> None:
        """Hold a mission's new standing."""
        held = encode_fast(standing)
        self._turn.put("standing", standing.mid, held)
        self._decoded[standing.mid] = (held, standing)
        self.held[standing.mid] = standing

    def active(self) -> MissionId | None:
        """Return the one mission that is active on this robot."""
        held = self._turn.get("active", "mission")
        return None if not held else MissionId(held.decode("ascii", "replace"))

    def make_active(self, mid: MissionId | None) -> None:
        """Make a mission the active one, or none."""
        self._turn.put("active", "mission", (mid or "").encode("ascii"))

    def token(self, digest: Digest) -> bytes | None:
        """Return the token of a mission version by its digest."""
        return self._turn.get("token", digest)

    def keep_token(self, digest: Digest, token: bytes) -> None:
        """Keep a token, so that replay and restart have the very bytes."""
        self._turn.put("token", digest, token)

    def get(self, kind: str, key: str) -> bytes | None:
        """Return any other held value."""
        return self._turn.get(kind, key)

    def put(self, kind: str, key: str, value: bytes) -> None:
        """Hold any other value."""
        self._turn.put(kind, key, value)

    def head(self) -> tuple[int, bytes]:
        """Return the log's size and last link."""
        return self._turn.head()

    def record(self, entry: Entry) -> int:
        """Append one record to the log."""
        return append(self._turn, entry, salts=self._salts(16 * len(entry.sealed)))


def read_held(data: bytes, kind: type[T], what: str) -> T:
    """Return a value that was held; what the store itself cannot spell is its corruption.

    Raises:
        StoreError: the bytes are none.
    """
    try:
        return decode(data, kind, where=f"store.{what}")
    except MalformedError as error:
        raise StoreError(error.message, where=error.where, reason=Reason.STORE_CORRUPT) from error
