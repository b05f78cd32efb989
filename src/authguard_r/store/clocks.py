# SPDX-License-Identifier: Apache-2.0
"""The machine's clocks, a store's simulated one, and what a store's file says of time.

Spec page: docs/spec/store.md#time
"""

from __future__ import annotations

import time
from pathlib import Path

from authguard_r.audit.record import read_record
from authguard_r.core.encoding import decode
from authguard_r.core.errors import MalformedError, StoreError
from authguard_r.core.ports import Clock
from authguard_r.store.sqlite import read_held, read_rows
from authguard_r.store.transactions import ClockWatermark

#: What the first record of a log with simulated time says of its clock.
SIMULATED = "simulated"


class SystemClock:
    """The machine's clocks (`core.ports.Clock`)."""

    def wall_ms(self) -> int:
        """Return the wall clock."""
        return time.time_ns() // 1_000_000

    def mono_ms(self) -> int:
        """Return the monotonic clock."""
        return time.monotonic_ns() // 1_000_000

    def pause(self, duration_ms: int) -> None:
        """Sleep."""
        time.sleep(duration_ms / 1_000)


def committed_ms(store: Path) -> int:
    """Return the last committed time of a store that no gate holds, 0 when it does not say."""
    high = _high(store)
    return 0 if high is None else high.utc_ms


class _SimulatedSince:
    """A clock for a store whose time is simulated: never behind what was committed there."""

    def __init__(self, high_ms: int) -> None:
        self._high_ms = high_ms
        self._system = SystemClock()

    def wall_ms(self) -> int:
        """Return the wall clock, or the simulated time when that is ahead."""
        return max(self._system.wall_ms(), self._high_ms)

    def mono_ms(self) -> int:
        """Return the monotonic clock."""
        return self._system.mono_ms()

    def pause(self, duration_ms: int) -> None:
        """Sleep."""
        self._system.pause(duration_ms)


def store_clock(store: Path) -> Clock:
    """Return the clock that a store's times were taken from: the machine's, or a simulated one.

    Only a log that says so in its first record has simulated time; `authguard run` writes such.
    """
    if not store.is_file() or store.stat().st_size == 0:
        return SystemClock()
    try:
        first = next(iter(read_rows(store)), None)
        high = read_held(store, "clock", "high")
        if first is None or high is None:
            return SystemClock()
        if read_record(first.record, where="record 0").open.get("clock") != SIMULATED:
            return SystemClock()
        return _SimulatedSince(decode(high, ClockWatermark, where="store.clock").utc_ms)
    except (StoreError, MalformedError):
        return SystemClock()  # opening the store says what is wrong with it


def last_epoch(store: Path) -> int:
    """Return the epoch of the last snapshot that a gate took in, -1 before any."""
    high = _high(store)
    return -1 if high is None else high.snapshot[0]


def _high(store: Path) -> ClockWatermark | None:
    if not store.is_file() or store.stat().st_size == 0:
        return None
    try:
        held = read_held(store, "clock", "high")
        return None if held is None else decode(held, ClockWatermark, where="store.clock")
    except (StoreError, MalformedError):
        return None  # opening the store says what is wrong with it
