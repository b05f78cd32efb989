# SPDX-License-Identifier: Apache-2.0
"""The gate's structured log for administrators: one JSON object for each line.

It says that things happen, not what a mission holds: codes, counts, clients, no places, no things,
no words of a plan. Arrivals and departures have a bound of their own: a client can connect without
end, and must not hide an alert or a recovery. The audit log is another thing. Spec page:
docs/spec/gate-protocol.md#journal
"""

from __future__ import annotations

from collections import Counter
from typing import Any

from authguard_r.wire.gate_limits import LIMITS
from authguard_r.wire.json_log import Lines

#: What of an event may be written.
_KEPT = frozenset(
    {"event", "what", "client", "role", "here", "by", "act", "stood_ms", "silent_ms", "refusals"}
    | {"why", "robot", "mode", "pid", "status", "unclean"}
)


class EventLog:
    """Writes lines to a file descriptor.

    Args:
        descriptor: where.
    """

    def __init__(self, descriptor: int) -> None:
        self._lines = Lines(descriptor)
        self._told: Counter[str] = Counter()
        self._due_ms = 0

    def event(self, event: dict[str, Any]) -> None:
        """Write one event; decisions and outcomes are only counted."""
        if event.get("event") not in {"decision", "outcome"}:
            self._write({key: value for key, value in event.items() if key in _KEPT})

    def counts(self, counted: Counter[str], now_ms: int) -> None:
        """Write the counts if they changed and it is time."""
        if now_ms < self._due_ms or counted == self._told:
            return
        self._due_ms = now_ms + LIMITS.counts_ms
        self._told = Counter(counted)
        self._write({"event": "counts", **counted})

    def _write(self, line: dict[str, Any]) -> None:
        self._lines.write(line, kind="client" if line.get("event") == "client" else "")
