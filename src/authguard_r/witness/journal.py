# SPDX-License-Identifier: Apache-2.0
"""The witness's structured log: one JSON object a line, for whoever runs the machine.

It never waits: a line that cannot be written at once is counted and dropped.
Spec page: docs/spec/witness.md#journal
"""

from __future__ import annotations

import os
import select
from typing import Any

import msgspec

#: Lines in a second; more of them are counted.
MOST_LINES = 50


class Journal:
    """Writes lines to a file descriptor.

    Args:
        descriptor: where.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._second = 0
        self._lines = 0
        self._dropped = 0

    def write(self, line: dict[str, Any], time_ms: int) -> None:
        """Write a line with its time, and how many were dropped before it."""
        if time_ms // 1_000 != self._second:
            self._second, self._lines = time_ms // 1_000, 0
        self._lines += 1
        stamped = {"time_ms": time_ms, **line}
        if self._dropped:
            stamped["dropped"] = self._dropped
        try:
            if self._lines > MOST_LINES or not select.select([], [self._descriptor], [], 0)[1]:
                raise BlockingIOError
            os.write(self._descriptor, msgspec.json.encode(stamped) + b"\n")
            self._dropped = 0
        except OSError:
            self._dropped += 1
