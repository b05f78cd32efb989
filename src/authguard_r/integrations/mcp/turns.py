# SPDX-License-Identifier: Apache-2.0
"""Whose call is next: one at a time, and sessions take turns, however many calls each has waiting.

Spec page: docs/spec/mcp.md#front
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager


class Turns:
    """A queue of queues."""

    def __init__(self) -> None:
        self._waiting: dict[str | None, deque[asyncio.Future[None]]] = {}
        self._is_taken = False

    @asynccontextmanager
    async def turn(self, session: str | None) -> AsyncIterator[None]:
        """Wait for a session's turn, and have it until the end of the block."""
        await self._wait(session)
        try:
            yield
        finally:
            self._give()

    async def _wait(self, session: str | None) -> None:
        if not self._is_taken:
            self._is_taken = True
            return
        mine = asyncio.get_running_loop().create_future()
        queue = self._waiting.setdefault(session, deque())
        queue.append(mine)
        try:
            await mine
        except asyncio.CancelledError:
            if not mine.cancelled():  # it was given the turn just now
                self._give()
            else:
                queue.remove(mine)
                if not queue:
                    del self._waiting[session]
            raise

    def _give(self) -> None:
        """Give the turn to the session that waited longest since its last one."""
        for session, queue in tuple(self._waiting.items()):
            # one that was canceled takes itself away in a moment
            waits = next((one for one in queue if not one.done()), None)
            if waits is None:
                continue
            queue.remove(waits)
            del self._waiting[session]
            if queue:
                self._waiting[session] = queue
            waits.set_result(None)
            return
        self._is_taken = False
