# SPDX-License-Identifier: Apache-2.0
"""Holds a store to its outside counter: compared at the start, counted before what has no undo.

A store that is ahead of its counter is one whose gate died in between, and is fine. One that is
behind, or beside it, was put there by somebody: then nothing is decided and nothing ordered until
a person accepts, signed, that this is the store to go on with.
Spec page: docs/spec/rollback.md
"""

from __future__ import annotations

import threading
from contextlib import suppress
from enum import StrEnum

from msgspec import Struct

from authguard_r.anchoring.counter import Counted, Counter, open_note, seal
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
from authguard_r.core.finding import Findings
from authguard_r.core.identifiers import Digest, RobotId
from authguard_r.core.lifecycle import Event
from authguard_r.core.ports import Signer, Turn, Verifier
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import advance
from authguard_r.ledger import Act, Ledger
from authguard_r.report import fault_finding

#: Where the store holds the number of a counter that it knows of.
KIND, KNOWN = "counter", "known"
#: What the alert and its record say.
WHAT = "the store was put back"


class Why(StrEnum):
    """What does not fit between a store and its counter."""

    BEHIND = "behind"
    REPLACED = "replaced"
    FORKED = "forked"
    COUNTER_MISSING = "counter_missing"
    COUNTER_BEHIND = "counter_behind"
    COUNTER_FOREIGN = "counter_foreign"
    COUNTER_UNREADABLE = "counter_unreadable"
    COUNTER_NOT_NAMED = "counter_not_named"


_SAID = {
    Why.BEHIND: "the log has fewer records than were counted: an older copy was put back",
    Why.REPLACED: "another store was counted: this one is new, or not this robot's last",
    Why.FORKED: "the log is not the one that was counted: a copy of it went on elsewhere",
    Why.COUNTER_MISSING: "the store was counted, and the counter is gone",
    Why.COUNTER_BEHIND: "the counter is older than the store knows: it was put back",
    Why.COUNTER_FOREIGN: "the counter is damaged, or not written by this robot's gate",
    Why.COUNTER_UNREADABLE: "the counter cannot be read",
    Why.COUNTER_NOT_NAMED: "the store was counted, and no counter was named",
}


class Reading(Struct, frozen=True):
    """What a counter held when the gate started.

    Args:
        counted: what its note says; None without an authentic one.
        why: what is wrong with it.
    """

    counted: Counted | None = None
    why: Why | None = None

    @property
    def time_ms(self) -> int:
        """Time is not before this: it was when the note was written."""
        return 0 if self.counted is None else self.counted.time_ms


def read_counter(counter: Counter | None, *, verifier: Verifier) -> Reading:
    """Return what the counter holds; whatever is wrong with it is part of the answer."""
    if counter is None:
        return Reading()
    try:
        note = counter.read()
        return Reading() if note is None else Reading(open_note(note, verifier=verifier))
    except EnvironmentFault:
        return Reading(why=Why.COUNTER_UNREADABLE)
    except (MalformedError, AuthenticityError):
        return Reading(why=Why.COUNTER_FOREIGN)


class _Place(Struct, frozen=True):
    """Where a log ends."""

    size: int
    head: bytes


class Anchor:
    """One store and its counter.

    Args:
        ledger: the store.
        robot: whose it is.
        counter: outside of the store; None where there is none, and then nothing is compared.
        signer: the gate's own key; needed with a counter.
        reading: what the counter held before the store was touched.
    """

    def __init__(
        self,
        ledger: Ledger,
        *,
        robot: RobotId,
        counter: Counter | None = None,
        signer: Signer | None = None,
        reading: Reading = Reading(),  # noqa: B008 - frozen
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
        self.why = ledger.peek(lambda turn: self._compare(turn, reading))

    @property
    def number(self) -> int:
        """The number that the counter was read with; 0 without an authentic one."""
        return 0 if self._counted is None else self._counted.number

    def begin(self) -> None:
        """Count the start, or record that the store was put back and suspend what is active.

        A counter that cannot be written is told of when it is needed: only what cannot be undone
        waits for it.
        """
        if self.why is not None:
            self._record(self.why)
        elif self._outside is not None:
            with suppress(EnvironmentFault):
                self.count()
                self._know()

    def require(self) -> None:
        """Refuse while nobody has accepted this store.

        Raises:
            RefusedError: it was put back (`ROLLED_BACK`).
        """
        if self.why is not None:
            raise RefusedError(_SAID[self.why], reason=Reason.ROLLED_BACK, where="store")

    def count(self) -> None:
        """Write how far the log has come; it is kept when this returns. Not inside a turn.

        Raises:
            RefusedError: the store was put back, and what is known of it is not overwritten.
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
        """Make sure, before it is committed, that what cannot be undone could be counted.

        In the writer's turn: nothing of the turn is written, for it is not on disk yet.

        Raises:
            EnvironmentFault: the counter cannot be written, and nothing was consumed.
        """
        if irreversible and self._outside is not None:
            with self._lock:
                self._write(*self._outside)

    def covered(self, *, irreversible: bool) -> Findings:
        """Count what was just committed, when it cannot be undone; return why that failed."""
        try:
            if irreversible:
                self.count()
        except AuthGuardError as error:
            return (fault_finding(error),)
        return ()

    def accepted(self) -> None:
        """Go on with this store, from what was committed: the operator's order was.

        Raises:
            EnvironmentFault: the counter cannot be written; nothing goes on.
        """
        why, self.why = self.why, None
        try:
            self.count()
            self._know()
        except BaseException:
            self.why = why
            raise

    def fits(self, *, store: Digest, size: int, number: int) -> bool:
        """True when these are this store's, seen since the gate started, and its counter's."""
        return (store, number) == (self._store, self.number) and size >= self._opened

    def shown(self) -> dict[str, object]:
        """Return what `status` says: what an operator has to sign, where he has to."""
        state = "uncounted" if self._outside is None else "counted"
        told: dict[str, object] = {
            "state": state if self.why is None else "put_back",
            "store": self._store,
            "number": self.number if self.why is not None else self._number,
        }
        if self.why is None:
            return told
        counted = None if self._counted is None else self._counted.size
        return {**told, "why": str(self.why), "message": _SAID[self.why], "counted": counted}

    def _look(self, turn: Turn) -> tuple[Digest, int | None, _Place]:
        """Return which store this is, the counter that it knows of, and where its log ends."""
        first = turn.rows(0, 1)
        if not first:  # pragma: no cover - a ledger that was opened has its first record
            raise StoreError("the log has no first record", reason=Reason.STORE_CORRUPT)
        known = turn.get(KIND, KNOWN)
        number = _number(known) if known else None
        return Digest(b64(first[0][3])), number, _Place(*turn.head())

    def _compare(self, turn: Turn, reading: Reading) -> Why | None:
        if self._outside is None:
            return None if self._known is None else Why.COUNTER_NOT_NAMED
        counted = reading.counted
        if counted is None:
            missing = None if self._known is None else Why.COUNTER_MISSING
            return reading.why or missing
        if counted.robot != self._robot:
            return Why.COUNTER_FOREIGN
        if counted.store != self._store:
            return Why.REPLACED
        row = turn.rows(counted.size - 1, 1)
        if not row:
            return Why.BEHIND
        if b64(row[0][3]) != counted.head:
            return Why.FORKED
        return Why.COUNTER_BEHIND if counted.number < (self._known or 0) else None

    def _write(self, counter: Counter, signer: Signer) -> None:
        """Write the place that is known; the lock is held."""
        # before it is written: two notes of one number must not exist, whatever becomes of this one
        self._number += 1
        counted = Counted(
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

    def _record(self, why: Why) -> None:
        counted = self._counted
        told = {"what": WHAT, "why": str(why), "size": self._opened}
        told |= {} if counted is None else {"counted": counted.size, "number": counted.number}

        def entry(at: int, mid: str = NONE) -> Entry:
            return Entry(kind="alert", time_ms=at, decision="alert", mid=mid, open=told)

        def suspended(act: Act) -> None:
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


def _number(known: bytes) -> int:
    """Return the number that a store holds; what is none is a damaged store."""
    if not known.isdigit():
        raise StoreError("expected a number", where="store.counter", reason=Reason.STORE_CORRUPT)
    return int(known)
