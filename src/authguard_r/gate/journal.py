# SPDX-License-Identifier: Apache-2.0
"""The gate's structured log, for whoever runs the machine: one JSON object a line.

It says that things happen, not what a mission holds: codes, counts, clients, no places, no things,
no words of a plan. It never waits: a line that cannot be written at once is counted and dropped,
and so is what comes too often; who comes and goes takes no place of anything else.
The audit log is another thing. Spec page: docs/spec/gate-protocol.md#journal
"""

from __future__ import annotations

import os
import time
from collections import Counter
from typing import Any

import msgspec

#: What of an event may be written.
_KEPT = frozenset(
    {"event", "what", "client", "role", "here", "by", "act", "stood_ms", "silent_ms", "refusals"}
    | {"why", "robot", "mode", "pid", "status", "unclean"}
)
#: Lines in a second about who comes and goes, and as many about all else; more are counted.
MOST_LINES = 50
#: Told once in this time, in milliseconds, if they changed.
COUNTS_MS = 10_000


class Journal:
    """Writes lines to a file descriptor.

    Args:
        descriptor: where; it is made non-blocking.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._dropped = 0
        self._told: Counter[str] = Counter()
        self._due_ms = 0
        self._second = 0
        self._lines: Counter[bool] = Counter()
        os.set_blocking(descriptor, False)

    def event(self, event: dict[str, Any]) -> None:
        """Write one event; decisions and outcomes are only counted."""
        if event.get("event") not in {"decision", "outcome"}:
            self._write({key: value for key, value in event.items() if key in _KEPT})

    def counts(self, counted: Counter[str], now_ms: int) -> None:
        """Write the counts if they changed and it is time."""
        if now_ms < self._due_ms or counted == self._told:
            return
        self._due_ms = now_ms + COUNTS_MS
        self._told = Counter(counted)
        self._write({"event": "counts", **counted})

    def _write(self, line: dict[str, Any]) -> None:
        now_ms = time.time_ns() // 1_000_000
        if now_ms // 1_000 != self._second:
            self._second, self._lines = now_ms // 1_000, Counter()
        # whoever may connect can do so without end: it must not hide an alert or a recovery
        knocks = line.get("event") == "client"
        self._lines[knocks] += 1
        stamped = {"time_ms": now_ms, **line}
        if self._dropped:
            stamped["dropped"] = self._dropped
        try:
            if self._lines[knocks] > MOST_LINES:
                raise BlockingIOError
            os.write(self._descriptor, msgspec.json.encode(stamped) + b"\n")
            self._dropped = 0
        except OSError:
            self._dropped += 1
