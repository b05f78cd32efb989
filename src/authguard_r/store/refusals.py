# SPDX-License-Identifier: Apache-2.0
"""Refusals wait for another commit, and repeats are counted, so that a flood costs little.

The first refusal of a client for a reason at a place is a record of its own; the same again within
a window is one number in memory and one digest, written as one record when the window ends.
Nothing else ever waits: no accept, outcome, stop, alert or order.
Spec page: docs/spec/enforcement.md#refusals
"""

from __future__ import annotations

import threading
from collections import Counter, deque
from collections.abc import Callable
from hashlib import sha256
from typing import Protocol

from msgspec import Struct, structs

from authguard_r.audit.record import Entry, LogRow, append, ends_motion
from authguard_r.core.encoding import Tag, b64, encode_fast
from authguard_r.core.ports import Turn
from authguard_r.wire.gate_limits import LIMITS

#: Client, reason code and place: what makes two refusals the same.
Fold = tuple[str, str, str]
_ANYTHING = "*"


class LogSealer(Protocol):
    """Seals what is written into a log, and opens what it sealed itself."""

    def append(self, turn: Turn, entry: Entry, *, salts: Callable[[int], bytes]) -> int:
        """Append the entry to the log in this turn, sealed; return its number."""
        ...

    def opened(self, row: LogRow) -> LogRow:
        """Return a row as it would be had nothing been sealed, as far as that can be said."""
        ...

    def forget(self, mid: str) -> None:
        """Forget a mission's keys: what comes next has others."""


class RefusalPolicy(Struct, frozen=True, kw_only=True):
    """How refusals are recorded; the default records each of them at once.

    Args:
        delay_ms: 0 records in a commit of its own. Otherwise refusals wait for the next commit,
            and the ledger's owner flushes at least this often.
        fold_ms: how long repeats are counted before they are one record; 0 counts none.
        users: how many users may be refused. Each has an equal share of the windows, under all its
            names, and one share is common: no number of clients takes away another's.
    """

    delay_ms: int = 0
    fold_ms: int = 0
    users: int = 1

    @property
    def most_of_user(self) -> int:
        """Windows of one user at once."""
        return LIMITS.windows // (max(self.users, 1) + 1)


class PendingEntry(Struct, frozen=True):
    """An entry that waits, with its place in the order of the decisions."""

    number: int
    entry: Entry


class _Window:
    """What is counted of refusals that are not recorded one by one.

    Args:
        cause: `repeated`, `crowded` (too many different ones) or `no room` (on the disk).
        ends_ms: monotonic clock at its end.
    """

    __slots__ = ("cause", "digest", "ends_ms", "first_ms", "last_ms", "reasons", "repeats")

    def __init__(self, cause: str, ends_ms: int) -> None:
        self.cause = cause
        self.ends_ms = ends_ms
        self.repeats = 0
        self.first_ms = self.last_ms = 0
        self.reasons: set[str] = set()
        self.digest = sha256(Tag.RAW.prefix)

    def count(self, entry: Entry, data: bytes, reason: str) -> None:
        """Count one refusal; its bytes go into the digest, so that they can be shown later."""
        self.first_ms = self.first_ms if self.repeats else entry.time_ms
        self.last_ms = entry.time_ms
        self.repeats += 1
        self.reasons.add(reason)
        self.digest.update(data)

    def entry(self, client: str, place: str, time_ms: int) -> Entry:
        """Return the record of everything that was counted."""
        return Entry(
            kind="refusal",
            time_ms=time_ms,
            decision="counted",
            open={
                "client": client,
                "reasons": sorted(self.reasons),
                "repeats": self.repeats,
                "cause": self.cause,
                "first_ms": self.first_ms,
                "last_ms": self.last_ms,
            },
            sealed={"where": place, "entries": b64(self.digest.digest())},
        )


class Refusals:
    """Refusals that are not on disk yet: those that wait, and those that are only counted.

    Args:
        policy: what waits and what is counted.
        restore: asks the store for room (`core.ports.Store.restore`).
        mono_ms: the monotonic clock.
    """

    def __init__(
        self, policy: RefusalPolicy, *, restore: Callable[[], bool], mono_ms: Callable[[], int]
    ) -> None:
        self.policy = policy
        self._restore = restore
        self._mono_ms = mono_ms
        self._lock = threading.Lock()
        self._waiting: deque[PendingEntry] = deque()
        # in the order in which they end: all of them last equally long
        self._windows: dict[Fold, _Window] = {}
        self._of_client: Counter[str] = Counter()
        self._of_user: Counter[str] = Counter()
        self._unwritten: _Window | None = None
        self._number = 0
        self._looked_ms: int | None = None
        self._has_room = True
        self._is_last = False

    @property
    def only_counts(self) -> bool:
        """True while what is refused is counted and not recorded, for want of room."""
        return self._unwritten is not None

    def may_write(self) -> bool:
        """True while refusals may be written; asks the disk at most once a second.

        The last flush before a clean end writes in any case: nothing comes after it.
        """
        if self._is_last:
            return True
        mono_ms = self._mono_ms()
        if self._looked_ms is None or mono_ms - self._looked_ms >= LIMITS.room_ms:
            self._looked_ms = mono_ms
            self._has_room = self._restore()
        return self._has_room

    def out_of_room(self) -> None:
        """Write no refusals until the disk was asked again: an essential job had no room."""
        self._looked_ms = self._mono_ms()
        self._has_room = False

    def at_once(self, dedup_key: Fold) -> bool:
        """True when this one is to be recorded now: it does not wait, and it is no repeat."""
        if self.policy.delay_ms > 0 or not self.may_write():
            return False
        with self._lock:
            return self._opens(_cut(dedup_key))

    def recorded(self, dedup_key: Fold) -> None:
        """Count what repeats this one, which was recorded, from now on."""
        with self._lock:
            if self.policy.fold_ms > 0 and self._opens(_cut(dedup_key)):
                self._open(_cut(dedup_key), "repeated")

    def take(self, entry: Entry, dedup_key: Fold) -> None:
        """Let a refusal wait, or count it when it is a repeat or there is no room for it."""
        has_room = self.may_write()
        key = _cut(dedup_key)
        # what cannot be spelled fails here, not in front of another commit
        data = encode_fast(entry)
        with self._lock:
            if not has_room:
                self._unwritten = self._unwritten or _Window("no room", 0)
                self._unwritten.count(entry, data, key[1])
            elif self._opens(key) and len(self._waiting) < LIMITS.waiting_refusals:
                self._queue(entry)
                if self.policy.fold_ms > 0:
                    self._open(key, "repeated")
            else:
                self._window_of(key).count(entry, data, key[1])

    def end_windows(self, time_ms: int, *, everything: bool = False) -> bool:
        """Let the records of windows that are over wait too; return whether anything waits.

        Args:
            time_ms: for the records of what was counted.
            everything: end every window, over or not: the gate stops.
        """
        self._is_last = everything
        if not self.may_write():
            return False
        mono_ms = self._mono_ms()
        with self._lock:
            if self._unwritten is not None:
                self._queue(self._unwritten.entry(_ANYTHING, _ANYTHING, time_ms))
                self._unwritten = None
            over = [
                key
                for key, window in self._windows.items()
                if everything or window.ends_ms <= mono_ms
            ]
            for key in over if everything else over[: LIMITS.ended_windows]:
                self._end(key, time_ms)
            return bool(self._waiting)

    def take_waiting(self) -> list[PendingEntry]:
        """Return what waits, for a turn that writes it or gives it back."""
        if not self._waiting or not self.may_write():
            return []
        with self._lock:
            taken, self._waiting = list(self._waiting), deque()
        return taken

    def give_back(self, taken: list[PendingEntry]) -> None:
        """Let what a turn could not write wait again, in the order of the decisions."""
        with self._lock:
            every = [*taken, *self._waiting]
            self._waiting = deque(sorted(every, key=lambda waiting: waiting.number))

    def _queue(self, entry: Entry) -> None:
        self._number += 1
        self._waiting.append(PendingEntry(self._number, entry))

    def _opens(self, key: Fold) -> bool:
        """True when this refusal is the first of a window that there is place for."""
        if self.policy.fold_ms == 0:
            return True
        crowded = (
            len(self._windows) >= LIMITS.windows
            or self._of_client[key[0]] >= LIMITS.windows_of_client
            or self._of_user[_user(key)] >= self.policy.most_of_user
        )
        return key not in self._windows and not crowded

    def _open(self, key: Fold, cause: str) -> _Window:
        window = self._windows[key] = _Window(cause, self._mono_ms() + self.policy.fold_ms)
        self._of_client[key[0]] += 1
        self._of_user[_user(key)] += 1
        return window

    def _window_of(self, key: Fold) -> _Window:
        """Return the window that counts a refusal: its own, its client's, or the common one."""
        if key in self._windows:
            return self._windows[key]
        theirs = (key[0], _ANYTHING, _ANYTHING)
        if self._of_user[_user(key)] >= self.policy.most_of_user and theirs not in self._windows:
            theirs = (_user(key), _ANYTHING, _ANYTHING)
        if len(self._windows) >= LIMITS.windows and theirs not in self._windows:
            theirs = (_ANYTHING, _ANYTHING, _ANYTHING)
        return self._windows.get(theirs) or self._open(theirs, "crowded")

    def _end(self, key: Fold, time_ms: int) -> None:
        window = self._windows.pop(key)
        self._of_user[_user(key)] -= 1
        if not self._of_user[_user(key)]:
            del self._of_user[_user(key)]
        self._of_client[key[0]] -= 1
        if not self._of_client[key[0]]:
            del self._of_client[key[0]]
        if window.repeats:
            self._queue(window.entry(key[0], key[2], time_ms))


class RecordBatch:
    """Where one act's records are written, behind the refusals that waited for a commit.

    Args:
        turn: the writer's turn.
        refusals: what waits.
        salts: returns that many fresh random bytes.
        marks: what every record says in its open part.
        sealer: seals fields of what is written; None: no field is sealed.
        fence: called after a record that ends a motion, before it is committed.
    """

    def __init__(
        self,
        turn: Turn,
        refusals: Refusals,
        salts: Callable[[int], bytes],
        marks: dict[str, str],
        sealer: LogSealer | None,
        *,
        fence: Callable[[], None],
    ) -> None:
        self.turn = turn
        self._fence = fence
        self._sealer = sealer
        self._marks = marks
        self._refusals = refusals
        self.salts = salts
        self._taken: list[PendingEntry] = []

    def record(self, entry: Entry) -> int:
        """Append what waited, then this; return its number."""
        self.record_waiting()
        return self._append(entry)

    def record_waiting(self) -> None:
        """Append what waited."""
        taken = self._refusals.take_waiting()
        self._taken += taken
        for waiting in taken:
            self._append(waiting.entry)

    def undo(self) -> None:
        """Let what waited wait again: nothing of this turn was committed."""
        taken, self._taken = self._taken, []
        self._refusals.give_back(taken)

    @property
    def seals(self) -> bool:
        """True where fields of the log are sealed."""
        return self._sealer is not None

    def forget_keys(self, mid: str) -> None:
        """Forget the keys of a mission's records, even if this turn fails."""
        if self._sealer is not None:
            self._sealer.forget(mid)

    def _append(self, entry: Entry) -> int:
        if self._marks:
            entry = structs.replace(entry, open={**entry.open, **self._marks})
        if self._sealer is not None:
            seq = self._sealer.append(self.turn, entry, salts=self.salts)
        else:
            seq = append(self.turn, entry, salts=self.salts(16 * len(entry.sealed)))
        if ends_motion(entry.kind, entry.decision):
            self._fence()
        return seq


def _user(dedup_key: Fold) -> str:
    """Return whose client it is: what stands in front of its own name."""
    return dedup_key[0].partition(".")[0]


def _cut(dedup_key: Fold) -> Fold:
    return dedup_key[0], dedup_key[1], dedup_key[2][: LIMITS.place_characters]
