# SPDX-License-Identifier: Apache-2.0
"""Every act that counts happens here: in the writer's turn, at a trusted time, with one record.

Trusted time never runs backwards: it is the wall clock or the last committed time plus what the
monotonic clock has counted since, whichever is later, and it is written with every commit. A wall
clock that is behind what was committed is a fault, not an excuse. An act that changes nothing
writes nothing. Spec page: docs/spec/store.md#time
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Container
from contextlib import suppress
from typing import TypeVar

from msgspec import Struct

from authguard_r.audit.record import Entry, LogRow, append
from authguard_r.core.encoding import b64, decode, encode_fast
from authguard_r.core.errors import ClockError, MalformedError, StoreError
from authguard_r.core.identifiers import Digest, MissionId, RobotId
from authguard_r.core.lifecycle import TERMINAL, Status
from authguard_r.core.ports import Clock, Store, Turn
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Standing
from authguard_r.store.refusals import Fold, LogSealer, RecordBatch, RefusalPolicy, Refusals
from authguard_r.wire.gate_limits import LIMITS

T = TypeVar("T")
#: Kind, key and value of something that the store holds.
Held = tuple[str, str, bytes]
#: An operator's stop that stands, until a `resume` that was signed after it.
STOP = ("stop", "operator")


class ClockWatermark(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What never runs backwards, written with every commit and read when a gate starts.

    Args:
        utc_ms: trusted time of the commit.
        mono_ms: the gate's monotonic clock at the commit.
        snapshot: epoch and seq of the newest snapshot that was taken in, (-1, -1) before any.
    """

    utc_ms: int
    mono_ms: int
    snapshot: tuple[int, int]


#: What a log's first record says of where its decisions are made.
_PLACE = ("site", "profile")


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
        refusals: what waits and what is counted; the default records each refusal at once.
        marks: what every record says in its open part: that it is of a shadow run.
        since_ms: time is not before this, also when wall clock and store are.
        sealer: seals fields of the log; None: all of it is readable.
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
        refusals: RefusalPolicy = RefusalPolicy(),  # noqa: B008 - frozen
        marks: dict[str, str] | None = None,
        since_ms: int = 0,
        sealer: LogSealer | None = None,
    ) -> None:
        self.store = store
        self.sealer = sealer
        self._clock = clock
        self._salts = salts
        self.robot = robot
        self._open_marks = marks or {}
        self._mono_base, self._mono_start = 0, clock.mono_ms()
        self._high, self._behind = Now(since_ms, 0), False
        self.snapshot = (-1, -1)
        #: Raised at each end of a motion. It begins with the time of the start in ms, so it is
        #: greater than every number that a gate gave before on this store.
        self.fence = 0
        self._fenced: Callable[[int], None] = lambda _: None
        self._fencing = threading.Lock()
        #: How many missions have come to an end since the start.
        self.endings = 0
        self._standings: dict[MissionId, tuple[int, Standing]] = {}
        self._decoded: dict[MissionId, tuple[bytes, Standing]] = {}
        self._turns = 0
        self._mirror = threading.Lock()
        self.refusals = Refusals(refusals, restore=store.restore, mono_ms=self.mono_ms)
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
        if wall < self._high.utc_ms - LIMITS.skew_ms:
            self._behind = True
            raise ClockError(
                f"the wall clock is {self._high.utc_ms - wall} ms behind the last committed time"
            )
        if self._behind:  # it has caught up: the time that it was wrong for is not added to it
            self._behind, self._high = False, Now(self._high.utc_ms, mono)
            self.raise_fence(wall)  # a start before it had no time of its own
        return Now(max(wall, self._high.utc_ms + mono - self._high.mono_ms), mono)

    def run(self, job: Callable[[Transaction], T], *, essential: bool = False) -> T:
        """Run one act in the writer's turn; its effects and records are on disk on return.

        An act that held and recorded nothing costs no fsync.

        Args:
            job: the act; may be run again from the start when the disk was full.
            essential: an outcome, a stop, an alert or an order: may use the store's reserve.

        Raises:
            ClockError: nothing was done.
            StoreError: nothing was committed.
        """

        def turn_job(page: RecordBatch) -> tuple[T, Transaction]:
            self._turns += 1  # in the order of the turns, which is the order of the log
            act = Transaction(
                page, self.now(), self.refusals, order=self._turns, decoded=self._decoded
            )
            result = job(act)
            if act.changed:
                page.turn.put("clock", "high", self._marks(act.now))
            return result, act

        result, act = self._in_turn(turn_job, essential=essential)
        with self._mirror:
            self._remember(act)
        return result

    def _in_turn(self, job: Callable[[RecordBatch], T], *, essential: bool = False) -> T:
        """Run in the writer's turn; refusals that waited are written in front of its records."""
        tries: list[RecordBatch] = []

        def turn_job(turn: Turn) -> T:
            for page in tries:  # the disk was full: what is left is not for refusals
                page.undo()
                self.refusals.out_of_room()
            more, fence = (self._salts, self._open_marks, self.sealer), self.raise_fence
            tries.append(RecordBatch(turn, self.refusals, *more, fence=fence))
            return job(tries[-1])

        try:
            return self.store.run(turn_job, essential=essential)
        except BaseException:
            for page in tries:
                page.undo()
            raise

    def when_fenced(self, call: Callable[[int], None]) -> None:
        """Call a function with the fence now, and each time that it is raised."""
        self._fenced = call
        call(self.fence)

    def raise_fence(self, at_ms: int = 0) -> None:
        """Require state from now on: a motion has ended, or the time was not known before."""
        with self._fencing:
            self.fence = max(self.fence + 1, at_ms)
            self._fenced(self.fence)

    def _marks(self, now: Now) -> bytes:
        high = ClockWatermark(utc_ms=now.utc_ms, mono_ms=now.mono_ms, snapshot=self.snapshot)
        return encode_fast(high)

    def standing(self, mid: MissionId) -> Standing | None:
        """Return the standing as last committed, without waiting for a turn."""
        known = self._standings.get(mid)
        return None if known is None else known[1]

    def peek(self, job: Callable[[Turn], T]) -> T:
        """Read in a turn that needs no clock and changes nothing.

        Raises:
            StoreError: the store cannot be read.
        """
        return self.store.read(job)

    def opened(self, row: tuple[int, bytes, bytes, bytes]) -> LogRow:
        """Return a row of the log as it would be had nothing of it been sealed.

        What was sealed before this start stays closed: its keys are only its readers'.

        Raises:
            StoreError: it is not what was sealed.
        """
        try:
            return LogRow(*row) if self.sealer is None else self.sealer.opened(LogRow(*row))
        except MalformedError as error:
            raise StoreError(
                error.message, where=error.where, reason=Reason.STORE_CORRUPT
            ) from error

    def latest(self) -> Now:
        """Return trusted time; while the clock is behind, what it would be had it gone on.

        For what may not wait for a clock; nothing that a mission grants is decided at it.
        """
        try:
            return self.now()
        except ClockError:
            mono = self.mono_ms()
            return Now(self._high.utc_ms + mono - self._high.mono_ms, mono)

    def note(
        self, entry: Callable[[int], Entry], *, essential: bool = False, held: Held | None = None
    ) -> int:
        """Record something that needs no trustworthy clock: a stop, an alert, an emergency.

        Args:
            entry: makes the entry from the last trusted time.
            essential: see `run`.
            held: kind, key and value of what is held with the record, in the same commit.

        Raises:
            StoreError: it was not recorded.
        """
        time_ms = self.last_ms()

        def turn_job(page: RecordBatch) -> int:
            if held is not None:
                page.turn.put(*held)
            return page.record(entry(time_ms))

        return self._in_turn(turn_job, essential=essential)

    def refuse(self, entry: Callable[[int], Entry], *, dedup_key: Fold) -> int | None:
        """Record a refusal that no act decided, now or later as the policy says.

        Args:
            entry: makes the entry from the last trusted time.
            dedup_key: client, reason and place; repeats of all three are counted.

        Returns:
            Its number in the log; None when it waits or was only counted.

        Raises:
            StoreError: it was to be recorded now, and was not.
        """
        if self.refusals.at_once(dedup_key):
            seq = self.note(entry)
            self.refusals.recorded(dedup_key)
            return seq
        self.refusals.take(entry(self.last_ms()), dedup_key)
        return None

    def flush(self, *, everything: bool = False) -> bool:
        """Write the refusals that wait and the counts that are over.

        To be called at least every `delay_ms` of the policy, by the one who chose it.

        Args:
            everything: the counts that go on, too, if need be from the store's reserve: nothing
                comes after.

        Raises:
            StoreError: they were not written, and go on waiting.
        """

        def turn_job(page: RecordBatch) -> None:
            page.record_waiting()
            self._raise_marks(page.turn)

        if self.refusals.end_windows(self.last_ms(), everything=everything):
            self._in_turn(turn_job, essential=everything)
        return True

    def close(self) -> None:
        """Write what waits, if possible, and close the store."""
        with suppress(StoreError):
            self.flush(everything=True)
        self.store.close()

    def _raise_marks(self, turn: Turn) -> None:
        """Commit the time and the snapshot of acts that only refused: neither comes again."""
        if self._high.utc_ms > last_commit_ms(turn):
            turn.put("clock", "high", self._marks(self._high))

    def last_ms(self) -> int:
        """Return a time that is not before anything committed; for what needs no right clock."""
        return max(self._high.utc_ms, self._clock.wall_ms())

    def _remember(self, act: Transaction) -> None:
        """Mirror what was committed; threads may come back in another order than they committed."""
        now, high = act.now, self._high
        if (now.utc_ms, now.mono_ms) > (high.utc_ms, high.mono_ms):
            self._high = now
        for mid, standing in act.held.items():
            known = self._standings.get(mid)
            if known is None or known[0] < act.order:
                over = known is not None and known[1].status in TERMINAL
                self.endings += standing.status in TERMINAL and not over
                self._standings[mid] = (act.order, standing)
        for entry, dedup_key, seq in act.refused:
            if seq is None:
                self.refusals.take(entry, dedup_key)
            else:
                self.refusals.recorded(dedup_key)

    def _open(self, turn: Turn, genesis: dict[str, object], inputs: dict[str, object]) -> None:
        held = turn.get("clock", "high")
        if held is not None:
            high = read_held(held, ClockWatermark, "clock")
            self._high = Now(max(high.utc_ms, self._high.utc_ms), high.mono_ms)
            self._mono_base, self.snapshot = high.mono_ms, high.snapshot
        if turn.head()[0] == 0:
            entry = Entry(
                kind="genesis",
                time_ms=self.last_ms(),
                decision="genesis",
                open={"format": 1, "robot": self.robot, **genesis, **self._open_marks},
                sealed=inputs,
            )
            append(turn, entry, salts=self._salts(16 * len(inputs)))
            turn.put("log", "robot", self.robot.encode("ascii"))
            turn.put("log", "place", _place(genesis))
        elif turn.get("log", "robot") != self.robot.encode("ascii"):
            raise StoreError(
                f"expected the store of `{self.robot}`", where="store", reason=Reason.ROBOT_MISMATCH
            )
        elif turn.get("log", "place") != _place(genesis):
            self._move(turn, genesis, inputs)
        # it is unknown what the robot did while no gate ran: more than was ever given before
        self.fence = self.last_ms() + turn.head()[0] + 1

    def _move(self, turn: Turn, genesis: dict[str, object], inputs: dict[str, object]) -> None:
        """Record that the gate has another site or profile now: later decisions are made on it."""
        place = {name: genesis[name] for name in _PLACE if name in genesis}
        told = {"verb": "site", "robot": self.robot, **place, **self._open_marks}
        entry = Entry(
            kind="management", time_ms=self.last_ms(), decision="site", open=told, sealed=inputs
        )
        append(turn, entry, salts=self._salts(16 * len(inputs)))
        turn.put("log", "place", _place(genesis))


def _place(genesis: dict[str, object]) -> bytes:
    """Return what a gate's decisions are made on, as its store holds it."""
    return " ".join(str(genesis.get(name, "-")) for name in _PLACE).encode("ascii")


def last_commit_ms(turn: Turn) -> int:
    """Return the trusted time of the last commit, 0 for a store that was never used."""
    held = turn.get("clock", "high")
    return 0 if held is None else read_held(held, ClockWatermark, "clock").utc_ms


class Transaction:
    """One act inside the writer's turn: what it reads, holds and records.

    Args:
        page: the writer's turn, and the log in it.
        now: read once for the whole act.
        refusals: what waits and what is counted.
        order: number of the turn; a later turn has a greater one.
        decoded: the last bytes of each standing with what they say; the bytes are always read.
    """

    def __init__(
        self,
        page: RecordBatch,
        now: Now,
        refusals: Refusals,
        *,
        order: int,
        decoded: dict[MissionId, tuple[bytes, Standing]],
    ) -> None:
        self.order = order
        self._decoded = decoded
        self._page, self._turn = page, page.turn
        self._refusals = refusals
        self.now = now
        self.held: dict[MissionId, Standing] = {}
        self.changed = False
        self.refused: list[tuple[Entry, Fold, int | None]] = []

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
        """Hold a mission's new standing, and since when it is suspended."""
        was, status = self.standing(standing.mid), standing.status
        if status is Status.SUSPENDED and (was is None or was.status is not status):
            self.put("suspended", standing.mid, str(self.now.utc_ms).encode("ascii"))
        held = encode_fast(standing)
        self.put("standing", standing.mid, held)
        self._decoded[standing.mid] = (held, standing)
        self.held[standing.mid] = standing

    def active(self) -> MissionId | None:
        """Return the one mission that is active on this robot."""
        held = self._turn.get("active", "mission")
        return None if not held else MissionId(held.decode("ascii", "replace"))

    def make_active(self, mid: MissionId | None) -> None:
        """Make a mission the active one, or none."""
        self.put("active", "mission", (mid or "").encode("ascii"))

    def token(self, digest: Digest) -> bytes | None:
        """Return the token of a mission version by its digest."""
        return self._turn.get("token", digest) or None

    @property
    def seals(self) -> bool:
        """True where fields of the log are sealed."""
        return self._page.seals

    def drop_token(self, digest: Digest) -> None:
        """Keep the token of a mission version no longer."""
        if self._turn.get("token", digest):
            self.put("token", digest, b"")

    def keep_token(self, digest: Digest, token: bytes) -> None:
        """Keep a token, so that replay and restart have the very bytes."""
        self.put("token", digest, token)

    def get(self, kind: str, key: str) -> bytes | None:
        """Return any other held value."""
        return self._turn.get(kind, key)

    def put(self, kind: str, key: str, value: bytes) -> None:
        """Hold any other value."""
        self.changed = True
        self._turn.put(kind, key, value)

    def head(self) -> tuple[int, bytes]:
        """Return the log's size and last link."""
        return self._turn.head()

    def rows(self, first: int, count: int) -> tuple[tuple[int, bytes, bytes, bytes], ...]:
        """Return at most `count` rows of the log from `first` on: seq, record, sealed, link."""
        return self._turn.rows(first, count)

    def salt(self) -> str:
        """Return fresh random bytes, so that hashed values cannot be guessed."""
        return b64(self._page.salts(16))

    def forget(self, seq: int, names: Container[str]) -> None:
        """Let the values of these names beside a record go; its commitments to them stay."""
        self.changed = True
        self._turn.forget(seq, names)

    def forget_keys(self, mid: str) -> None:
        """Forget the keys that a mission's records are sealed with: what comes next has others."""
        self._page.forget_keys(mid)

    def record_waiting(self) -> None:
        """Append the refusals that waited: what comes next is behind them."""
        self._page.record_waiting()

    def record(self, entry: Entry) -> int:
        """Append one record to the log, behind the refusals that waited."""
        self.changed = True
        return self._page.record(entry)

    def refuse(self, entry: Entry, *, dedup_key: Fold) -> int | None:
        """Record a refusal, now or later as the policy says.

        One that changed something in this act, before this call, is recorded with the change.

        Args:
            entry: its record.
            dedup_key: client, reason and place; repeats of all three are counted.

        Returns:
            Its number in the log; None when it waits or was only counted.
        """
        seq = self.record(entry) if self.changed or self._refusals.at_once(dedup_key) else None
        self.refused.append((entry, dedup_key, seq))
        return seq


def stop_stands(turn: Turn | Transaction) -> bool:
    """True while an operator's stop stands, for every mission."""
    return bool(turn.get(*STOP))


def read_held(data: bytes, kind: type[T], what: str) -> T:
    """Return a value that was held; what the store itself cannot spell is its corruption.

    Raises:
        StoreError: the bytes are not valid.
    """
    try:
        return decode(data, kind, where=f"store.{what}")
    except MalformedError as error:
        raise StoreError(error.message, where=error.where, reason=Reason.STORE_CORRUPT) from error
