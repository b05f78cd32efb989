# SPDX-License-Identifier: Apache-2.0
"""Says whether a loop of asyncio still runs its callbacks."""

from __future__ import annotations

import asyncio
import time

from authguard_r.integrations.ros.latch import MS
from authguard_r.integrations.ros.nodes.heartbeat import TURN_MS


class LoopWatch:
    """Says whether an asyncio loop runs its callbacks; any thread may ask, as often as it likes.

    Args:
        loop: which.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._is_asked = False
        self._turned_ns: int | None = None

    def __call__(self) -> bool:
        """Return whether a callback ran within `TURN_MS`; False on the first call."""
        if not self._is_asked:
            self._is_asked = True
            try:
                self._loop.call_soon_threadsafe(self._turned)
            except RuntimeError:  # the loop is closed
                self._turned_ns = None
        turned_ns = self._turned_ns
        return turned_ns is not None and time.monotonic_ns() - turned_ns < TURN_MS * MS

    def _turned(self) -> None:
        self._turned_ns = time.monotonic_ns()
        self._is_asked = False
