# SPDX-License-Identifier: Apache-2.0
"""Stops that no gate has recorded yet, in memory.

An operator's stop suspends the mission, so that another stop may not delay or displace its record:
it has a queue of its own, which is sent first. Files: `spool`. Spec page:
docs/spec/gate-protocol.md#stop-lane
"""

from __future__ import annotations

from itertools import islice

from msgspec.structs import replace

from authguard_r.wire.messages import SUSPENDING, ClientRole, StopHeard
from authguard_r.wire.stop_limits import LIMITS


class Queue:
    """Stops of some roles, in order, until a gate has recorded each of them.

    Args:
        window: most of them that are sent ahead of the gate's answer.
    """

    def __init__(self, window: int) -> None:
        self._window = window
        self._sent: dict[int, StopHeard] = {}
        self._unsent: dict[int, StopHeard] = {}
        self._fresh: dict[int, StopHeard] = {}

    def __len__(self) -> int:
        return len(self._sent) + len(self._unsent)

    @property
    def is_fresh(self) -> bool:
        """True while stops are in memory alone."""
        return bool(self._fresh)

    @property
    def is_told(self) -> bool:
        """True when the gate was sent all of them."""
        return not self._unsent

    def is_unsent(self, n: int) -> bool:
        """True when the gate does not know of this stop."""
        return n in self._unsent

    def keep(self, stop: StopHeard, *, is_fresh: bool) -> None:
        """Keep a stop; a fresh one is not in the file."""
        self._unsent[stop.n] = stop
        if is_fresh:
            self._fresh[stop.n] = stop

    def dedup_key(self, n: int, later: StopHeard, *, is_fresh: bool) -> None:
        """Count a later stop with one that was not sent; what is said is true of both."""
        first = self._unsent[n]
        is_confirmed = first.stood_ms is not None and later.stood_ms is not None
        both = replace(
            first,
            more=first.more + 1 + later.more,
            stood_ms=max(first.stood_ms or 0, later.stood_ms or 0) if is_confirmed else None,
            stops=first.stops if later.stops is None else later.stops,
            life=first.life if later.stops is None else later.life,
        )
        self.keep(both, is_fresh=is_fresh)

    def last(self) -> int:
        """Return the number of the last stop that was not sent."""
        return next(reversed(self._unsent))

    def begin(self) -> None:
        """Send all of them again: another gate listens."""
        self._unsent = self._sent | self._unsent
        self._sent = {}

    def to_send(self) -> list[StopHeard]:
        """Return what the gate may receive now; it counts as sent."""
        room = max(self._window - len(self._sent), 0)
        sent = list(islice(self._unsent.values(), room))
        for stop in sent:
            self._sent[stop.n] = self._unsent.pop(stop.n)
        return sent

    def heard(self, n: int) -> None:
        """Forget a stop that was sent."""
        if self._sent.pop(n, None) is not None:
            self._fresh.pop(n, None)

    def to_spool(self) -> list[StopHeard]:
        """Return the first stops that are in memory alone, as many as one write may take."""
        return list(islice(self._fresh.values(), LIMITS.batch))

    def spooled(self, stops: list[StopHeard]) -> None:
        """Note that these are in the file now."""
        for stop in stops:
            del self._fresh[stop.n]


class Backlog:
    """The stops that are not recorded: the suspending ones, and the others.

    Args:
        epoch: this stop process's name, larger than every earlier stop process's.
        known: what an earlier stop process left, in order; numbers go on after them.
    """

    def __init__(self, epoch: int, known: tuple[StopHeard, ...] = ()) -> None:
        self.epoch = epoch
        self.first = Queue(LIMITS.first_window)
        self.others = Queue(LIMITS.window)
        self._folds: dict[tuple[int, ClientRole], int] = {}
        self._last = known[-1].n if known else 0
        for stop in known:
            self._take(stop, is_fresh=False)
        self._folds.clear()  # the file has each by itself: they would be counted twice

    def __len__(self) -> int:
        return len(self.first) + len(self.others)

    @property
    def next_n(self) -> int:
        """The number of the next stop."""
        return self._last + 1

    @property
    def is_told(self) -> bool:
        """True when the gate was sent every suspending stop."""
        return self.first.is_told

    def add(self, stop: StopHeard) -> None:
        """Keep a stop, or count it with one of the same user and role."""
        self._last = stop.n
        self._take(stop, is_fresh=True)

    def begin(self) -> None:
        """Start anew: another gate listens."""
        self.first.begin()
        self.others.begin()

    def to_send(self) -> list[StopHeard]:
        """Return what the gate may receive now, suspending stops first; it counts as sent."""
        sent = self.first.to_send()
        if self.first.is_told:
            sent += self.others.to_send()
            # what a gate was sent under a name stays what it was
            self._folds = {k: n for k, n in self._folds.items() if self.others.is_unsent(n)}
        return sent

    def heard(self, n: int) -> bool:
        """Forget one stop; false when it was never sent."""
        if n > self._last or self.first.is_unsent(n) or self.others.is_unsent(n):
            return False
        self.first.heard(n)
        self.others.heard(n)
        return True

    def _take(self, stop: StopHeard, *, is_fresh: bool) -> None:
        if stop.role in SUSPENDING:
            self._take_first(stop, is_fresh=is_fresh)
            return
        who = (stop.uid, stop.role)
        if len(self.others) < LIMITS.window:
            self.others.keep(stop, is_fresh=is_fresh)
        elif who in self._folds:
            self.others.dedup_key(self._folds[who], stop, is_fresh=is_fresh)
        else:
            self._folds[who] = stop.n
            self.others.keep(stop, is_fresh=is_fresh)

    def _take_first(self, stop: StopHeard, *, is_fresh: bool) -> None:
        if len(self.first) < LIMITS.first_stops:
            self.first.keep(stop, is_fresh=is_fresh)
        else:
            self.first.dedup_key(self.first.last(), stop, is_fresh=is_fresh)
