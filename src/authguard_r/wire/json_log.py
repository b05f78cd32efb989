# SPDX-License-Identifier: Apache-2.0
"""The administrator's log: one JSON object in a line, never so many that they fill a disk.

Of each kind so many are written in a second; the others are counted. Nothing waits: a line that
cannot be written at once is counted and dropped, too. Spec page: docs/spec/listeners.md#log
"""

from __future__ import annotations

import os
import select
import time
from collections import Counter
from typing import Any

import msgspec

#: Where a process writes its log, independent of `sys.stderr`.
STDERR = 2
#: Lines of one kind in a second.
MOST_LINES = 50
#: What a pipe takes at once when it says that it takes something, in bytes.
_FITS = 4_096


class Lines:
    """Writes lines to a file descriptor.

    Args:
        descriptor: where.
        most: lines of one kind in a second.
    """

    def __init__(self, descriptor: int = STDERR, most: int = MOST_LINES) -> None:
        self._descriptor = descriptor
        self._most = most
        self._poll = select.poll()
        self._poll.register(descriptor, select.POLLOUT)
        self._second = 0
        self._lines: Counter[str] = Counter()
        self._dropped = 0

    def write(
        self, line: dict[str, Any], *, kind: str | None = "", most: int | None = None
    ) -> None:
        """Write a line with its time, and how many were dropped before it.

        Args:
            line: what is said.
            kind: what shares a bound: what strangers can cause must not hide what they cannot. None
                has no bound: its causer is known.
            most: lines of this kind in a second, if fewer.
        """
        now_ms = time.time_ns() // 1_000_000
        if now_ms // 1_000 != self._second:
            self._second, self._lines = now_ms // 1_000, Counter()
        if kind is not None:
            self._lines[kind] += 1
        stamped = {"time_ms": now_ms, **line}
        if self._dropped:
            stamped["dropped"] = self._dropped
        data = msgspec.json.encode(stamped) + b"\n"
        is_many = kind is not None and self._lines[kind] > (self._most if most is None else most)
        try:
            if is_many or len(data) > _FITS or not self._is_ready:
                raise BlockingIOError
            os.write(self._descriptor, data)
            self._dropped = 0
        except OSError:
            self._dropped += 1

    @property
    def _is_ready(self) -> bool:
        """True when a line fits."""
        return any(events & select.POLLOUT for _, events in self._poll.poll(0))
