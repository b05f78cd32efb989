# SPDX-License-Identifier: Apache-2.0
"""Compares a store with what is kept outside: at the start, and before a step without undo.

Outside are a counter and witnesses; the doubt of one is enough. A store that is ahead of them is
one whose gate died in between, and is fine. A store that is behind them, or does not contain them,
was replaced: the gate decides nothing and takes no order until a person signs that this is the
store to continue with. Spec page: docs/spec/rollback.md
"""

from __future__ import annotations

import threading
from contextlib import suppress

from msgspec import Struct

from authguard_r.anchoring.checkpoint_scheduler import CheckpointScheduler
from authguard_r.anchoring.counter import Counter, CounterNote, open_note, seal
from authguard_r.anchoring.evidence import BY_COUNTER, SAID, Discrepancy, Doubt
from authguard_r.audit.record import NONE, Entry
from authguard_r.core.encoding import b64
from authguard_r.core.errors import (
    AuthenticityError,
    AuthGuardError,
    EnvironmentFault,
    MalformedError,
    RefusedError,
    StoreError,
)
from authguard_r.core.finding import Findings, fault_finding
from authguard_r.core.identifiers import Digest, RobotId
from authguard_r.core.lifecycle import Event
from authguard_r.core.ports import Turn
from authguard_r.core.principals import Signer, Verifier
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import advance
from authguard_r.store.transactions import Ledger, Transaction

#: Where the store holds the number of a counter that it knows of.
KIND, KNOWN = "counter", "known"
#: What the alert and its record say.
WHAT = "the store was rolled back"
#: What the alert of witnesses that confirm nothing says.
SILENT = "the witnesses are silent"


class CounterReading(Struct, frozen=True):
    """What a counter held when the gate started.

    Args:
        counted: what its note says; None without an authentic one.
        why: what is wrong with it.
    """

    counted: CounterNote | None = None
    why: Discrepancy | None = None

    @property
    def time_ms(self) -> int:
        """Time is not before this: it was when the note was written."""
        return 0 if self.counted is None else self.counted.time_ms


def read_counter(counter: Counter | None, *, verifier: Verifier) -> CounterReading:
    """Return what the counter holds; a fault of the counter is part of the answer."""
    if counter is None:
        return CounterReading()
    try:
        note = counter.read()
        return (
            CounterReading() if note is None else CounterReading(open_note(note, verifier=verifier))
        )
    except EnvironmentFault:
        return CounterReading(why=Discrepancy.COUNTER_UNREADABLE)
    except (MalformedError, AuthenticityError):
        return CounterReading(why=Discrepancy.COUNTER_FOREIGN)


class AnchorNotice(Struct, frozen=True):
    """A message for people.

    Args:
        what: the alert.
        details: its details.
        recorded: the log has it already.
        over: it is over, and no alert.
    """

    what: str
    details: dict[str, object]
    recorded: bool = False
    over: bool = False


class _Place(Struct, frozen=True):
    """Where a log ends."""

    size: int
    head: bytes


class StoreAnchor:
    """One store and what is outside of it.

    Args:
        ledger: the store.
        robot: whose it is.
        counter: outside of the store; None when there is none, and then nothing is compared.
        signer: the gate's own key; needed with a counter.
        reading: what the counter held before the store was touched.
        scheduler: makes the log's checkpoints and has them witnessed; None makes none.
    """

    def __init__(
        self,
        ledger: Ledger,
        *,
        robot: RobotId,
        counter: Counter | None = None,
        signer: Signer | None = None,
        reading: CounterReading = CounterReading(),  # noqa: B008 - frozen
        scheduler: CheckpointScheduler | None = None,
    ) -> None:
        if (counter is None) is not (signer is None):
            raise TypeError("a counter needs the gate's own signer, and nothing else does")
        self._ledger = ledger
        self._robot = robot
        self._outside = None if counter is None or signer is None else (counter, signer)
        self._counted = reading.counted
        self._lock = threading.Lock()
        self._store, self._known, self._place = ledger.peek(self._look)
        self._opened = self._place.size
        self._number = max(self.number, self._known or 0)
        self._scheduler = scheduler
        why = ledger.peek(lambda turn: self._compare(turn, reading))
        size = None if self._counted is None else self._counted.size
        self._doubt = None if why is None else Doubt(why, BY_COUNTER, size)
        if self._doubt is None and scheduler is not None:
            self._doubt = scheduler.compare()

    @property
    def why(self) -> Discrepancy | None:
        """Why nothing goes on with this store; None when it does."""
        return None if self._doubt is None else self._doubt.why

    @property
    def number(self) -> int:
        """The number that the counter was read with; 0 without an authentic one."""
        return 0 if self._counted is None else self._counted.number

    def begin(self) -> None:
        """Show the log to its witnesses and count the start, or record that it was put back.

        A place that cannot be reached is reported when it is needed: only a step that cannot be
        undone waits for it.
        """
        if self._doubt is None and self._scheduler is not None:
            with suppress(AuthGuardError):
                self._doubt = self._scheduler.begin()
        if self._doubt is not None:
            self._record(self._doubt)
        elif self._outside is not None:
            with suppress(EnvironmentFault):
                self.count()
                self._know()

    def tick(self) -> tuple[AnchorNotice, ...]:
        """Make a due checkpoint and take in what witnesses say; return the messages for people.

        For the one thread that holds the store, between its turns.
        """
        if self._scheduler is None or self._doubt is not None:
            return ()
        try:
            self._doubt = self._scheduler.tick()
            if self._doubt is not None:
                self._record(self._doubt)
                return self.put_back()
            began = self._scheduler.silence()
        except AuthGuardError:
            return ()  # the store cannot be written: nothing is released, and an alert is raised
        if began is None:
            return ()
        return (AnchorNotice(SILENT, {"records": self._scheduler.unwitnessed}, over=not began),)

    def end(self) -> None:
        """Make a last checkpoint, show it to the witnesses, and count, if that can be done."""
        if self._doubt is None and self._scheduler is not None:
            self._scheduler.end()
        with suppress(AuthGuardError):
            self.count()

    def put_back(self) -> tuple[AnchorNotice, ...]:
        """Return the notices of a store that was put back; else nothing."""
        if self._doubt is None:
            return ()
        details: dict[str, object] = {"why": str(self._doubt.why), "by": self._doubt.by}
        return (AnchorNotice(WHAT, details, recorded=True),)

    def require(self) -> None:
        """Refuse until a person has accepted this store.

        Raises:
            RefusedError: it was put back (`ROLLED_BACK`).
        """
        if self._doubt is not None:
            raise RefusedError(SAID[self._doubt.why], reason=Reason.ROLLED_BACK, where="store")

    def count(self) -> None:
        """Write how far the log has come; it is kept when this returns. Not inside a turn.

        Raises:
            RefusedError: the store was rolled back, and what is known of it is not overwritten.
            EnvironmentFault: the counter cannot be written.
        """
        self.require()
        if self._outside is None:
            return
        place = self._ledger.peek(lambda turn: _Place(*turn.head()))
        with self._lock:
            if place.size > self._place.size:  # of two at once, the later may come first
                self._place = place
            self._write(*self._outside)

    def ready(self, *, irreversible: bool) -> None:
        """Make sure, before it is committed, that a step that cannot be undone could be reported.

        In the writer's turn: nothing of the turn is written, for it is not on disk yet.

        Raises:
            EnvironmentFault: too few witnesses have confirmed this store since the start, or the
                counter cannot be written; nothing was consumed.
        """
        if irreversible and self._scheduler is not None:
            self._scheduler.require()
        if irreversible and self._outside is not None:
            with self._lock:
                self._write(*self._outside)

    def covered(self, *, irreversible: bool) -> Findings:
        """Put what was just committed into a checkpoint and count it, when it cannot be undone.

        Returns:
            Why that failed.
        """
        try:
            if irreversible:
                if self._scheduler is not None:
                    self._scheduler.make()
                self.count()
        except AuthGuardError as error:
            return (fault_finding(error),)
        return ()

    def accepted(self) -> None:
        """Go on with this store, from what was committed: the operator's order was.

        Raises:
            EnvironmentFault: the counter cannot be written; nothing goes on.
        """
        doubt, self._doubt = self._doubt, None
        try:
            if doubt is not None and self._scheduler is not None:
                self._scheduler.accepted(doubt.why)
            self.count()
            self._know()
        except BaseException:
            self._doubt = doubt
            raise

    def fits(self, *, store: Digest, size: int, number: int) -> bool:
        """True when these are this store's, seen since the gate started, and its counter's."""
        return (store, number) == (self._store, self.number) and size >= self._opened

    def shown(self) -> dict[str, object]:
        """Return what `status` says: what an operator has to sign, when a signature is needed."""
        state, doubt = "uncounted" if self._outside is None else "counted", self._doubt
        told: dict[str, object] = {
            "state": state if doubt is None else "put_back",
            "store": self._store,
            "number": self._number if doubt is None else self.number,
            **({} if self._scheduler is None else self._scheduler.shown()),
        }
        if doubt is None:
            return told
        said = {"why": str(doubt.why), "message": SAID[doubt.why]}
        return {**told, **said, "by": doubt.by, "counted": doubt.size, "opened": self._opened}

    def _look(self, turn: Turn) -> tuple[Digest, int | None, _Place]:
        """Return which store this is, the counter that it knows of, and where its log ends."""
        first = turn.rows(0, 1)
        if not first:  # pragma: no cover - a ledger that was opened has its first record
            raise StoreError("the log has no first record", reason=Reason.STORE_CORRUPT)
        number = known_number(turn.get(KIND, KNOWN))
        return Digest(b64(first[0][3])), number, _Place(*turn.head())

    def _compare(self, turn: Turn, reading: CounterReading) -> Discrepancy | None:
        if self._outside is None:
            return None if self._known is None else Discrepancy.COUNTER_NOT_NAMED
        counted = reading.counted
        if counted is None:
            missing = None if self._known is None else Discrepancy.COUNTER_MISSING
            return reading.why or missing
        if counted.robot != self._robot:
            return Discrepancy.COUNTER_FOREIGN
        if counted.store != self._store:
            return Discrepancy.REPLACED
        row = turn.rows(counted.size - 1, 1)
        if not row:
            return Discrepancy.BEHIND
        if b64(row[0][3]) != counted.head:
            return Discrepancy.FORKED
        return Discrepancy.COUNTER_BEHIND if counted.number < (self._known or 0) else None

    def _write(self, counter: Counter, signer: Signer) -> None:
        """Write the place that is known; the lock is held."""
        # before it is written: two notes of one number must not exist, even if this one is lost
        self._number += 1
        counted = CounterNote(
            robot=self._robot,
            store=self._store,
            number=self._number,
            size=self._place.size,
            head=Digest(b64(self._place.head)),
            time_ms=self._ledger.last_ms(),
        )
        counter.write(seal(counted, signer))

    def _know(self) -> None:
        """Let the store know of its counter, once that is there: never the other way round."""
        known = b"" if self._outside is None else str(self._number).encode("ascii")
        self._ledger.store.run(lambda turn: turn.put(KIND, KNOWN, known), essential=True)

    def _record(self, doubt: Doubt) -> None:
        told: dict[str, object] = {"what": WHAT, "why": str(doubt.why), "by": doubt.by}
        told |= {"size": self._opened}
        told |= {} if doubt.size is None else {"counted": doubt.size}
        told |= {} if self._counted is None else {"number": self._counted.number}

        def entry(at: int, mid: str = NONE) -> Entry:
            return Entry(kind="alert", time_ms=at, decision="alert", mid=mid, open=told)

        def suspended(act: Transaction) -> None:
            mid = act.active()
            standing = None if mid is None else act.standing(mid)
            held = None if standing is None else advance(standing, Event.SUSPEND)
            if held is not None:
                act.hold(held)
            act.record(entry(act.now.utc_ms, mid or NONE))

        try:
            self._ledger.run(suspended, essential=True)
        except AuthGuardError:  # a clock that is behind: refused is everything all the same
            with suppress(AuthGuardError):
                self._ledger.note(entry, essential=True)


def known_number(known: bytes | None) -> int | None:
    """Return the number of the counter that a store knows of; None when it knows of none.

    Raises:
        StoreError: what it holds is no number: the store is damaged.
    """
    if not known:
        return None
    if not known.isdigit():
        raise StoreError("expected a number", where="store.counter", reason=Reason.STORE_CORRUPT)
    return int(known)


__all__ = [
    "SILENT",
    "WHAT",
    "AnchorNotice",
    "CounterReading",
    "Discrepancy",
    "StoreAnchor",
    "read_counter",
]
