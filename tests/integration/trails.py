# SPDX-License-Identifier: Apache-2.0
"""Where a robot was and when, by its own sensors: how long it went on, and how far, after a fault.

Times are of the machine's monotonic clock as the robot's process read it, not of who listens.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress
from itertools import pairwise
from math import hypot
from types import TracebackType
from typing import Self

from msgspec import Struct

from authguard_r.core.state import Snapshot
from authguard_r.wire.frames import read_body
from fixtures.gate_process import RunningGate, until
from integration.scripted_gate import Sensors


class Seen(Struct, frozen=True):
    """One look of the robot's sensors."""

    at_ms: int
    speed_mm_s: int
    x_mm: int
    y_mm: int


class Rest(Struct, frozen=True):
    """How a robot came to rest after a moment.

    Args:
        took_ms: from that moment to the first look at speed 0.
        way_mm: how far it went meanwhile.
        braking_mm: how far it went after the last look at full speed.
        gap_ms: the longest time between two looks meanwhile.
    """

    took_ms: int
    way_mm: int
    braking_mm: int
    gap_ms: int


class Trail:
    """Listens from the start to the end of the block; a context manager."""

    def __init__(self, gate: RunningGate) -> None:
        self._sensors = Sensors(gate.run / "sensors.sock")
        self._seen: list[Seen] = []
        self._thread = threading.Thread(target=self._listen, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        until(lambda: self._seen, "a first look of the sensors")
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._sensors.close()
        self._thread.join(30)

    @property
    def last(self) -> Seen:
        """The newest look."""
        return self._seen[-1]

    def first(self, holds: Callable[[Seen], bool], what: str) -> Seen:
        """Return the first look of which something holds, once there is one."""
        found: Seen = until(lambda: next(filter(holds, tuple(self._seen)), None), what)
        return found

    def rest(self, since_ms: int) -> Rest:
        """Wait until the robot stands after a moment; return how it came to that."""

        def standing() -> Seen | None:
            return next((s for s in tuple(self._seen) if s.at_ms >= since_ms and _stands(s)), None)

        end: Seen = until(standing, "a robot that stands")
        seen = tuple(self._seen)
        before = [s for s in seen if s.at_ms <= end.at_ms]
        began = max((s for s in before if s.at_ms <= since_ms), default=before[0], key=_at)
        full = max(s.speed_mm_s for s in before if s.at_ms >= began.at_ms)
        fast = max((s for s in before if s.speed_mm_s == full), default=began, key=_at)
        looks = [s.at_ms for s in before if s.at_ms >= began.at_ms]
        return Rest(
            took_ms=end.at_ms - since_ms,
            way_mm=_between(began, end),
            braking_mm=_between(fast, end),
            gap_ms=max((b - a for a, b in pairwise(looks)), default=0),
        )

    def stays(self, looks: int = 5) -> None:
        """Require that the robot goes on standing where it is, for some looks."""
        count, here = len(self._seen), self.last
        until(lambda: len(self._seen) > count + looks, "more looks of the sensors")
        assert all(_between(here, s) == 0 and _stands(s) for s in self._seen[count:])

    def _listen(self) -> None:
        with suppress(OSError, AssertionError):  # closed, or the robot's process is gone
            while True:
                data = self._sensors.link.recv(1 << 16)
                if not data:
                    return
                for item in self._sensors.reader.feed(data):
                    self._seen.append(_seen(item.id, read_body(item.body, Snapshot)))


def _seen(at_ms: int, snapshot: Snapshot) -> Seen:
    pose, speed = snapshot.pose, snapshot.readings["speed_mm_s"].value
    assert pose is not None
    assert isinstance(speed, int)
    return Seen(at_ms, speed, pose.x_mm, pose.y_mm)


def _at(seen: Seen) -> int:
    return seen.at_ms


def _stands(seen: Seen) -> bool:
    return seen.speed_mm_s == 0


def _between(a: Seen, b: Seen) -> int:
    return round(hypot(b.x_mm - a.x_mm, b.y_mm - a.y_mm))
