# SPDX-License-Identifier: Apache-2.0
"""What came on the thread of ROS and waits for the event loop: so much, and no more.

Spec page: docs/spec/ros.md#threads
"""

from __future__ import annotations

import asyncio
from collections import deque
from typing import Generic, TypeVar

from authguard_r.integrations.ros.nodes.loop import Spinner

T = TypeVar("T")


class ThreadInbox(Generic[T]):
    """A queue from the thread to the loop; a flood never makes it longer.

    Args:
        spinner: both.
        most: that wait.
        is_newest: what is too much takes the place of the oldest; else it is shed, and counted.
    """

    def __init__(self, spinner: Spinner, most: int, *, is_newest: bool) -> None:
        self._spinner, self._most, self._is_newest = spinner, most, is_newest
        self._items: deque[T] = deque(maxlen=most)
        self._news = asyncio.Event()
        self._is_called = False
        self._shed = self._said = 0

    def put(self, item: T) -> None:
        """Let something wait; on the thread of ROS."""
        if self._is_newest or len(self._items) < self._most:
            self._items.append(item)
        else:
            self._shed += 1
        if not self._is_called:  # one call for any number: the loop's own queue stays short, too
            self._is_called = True
            self._spinner.soon(self._call)

    async def take(self) -> T:
        """Return the next; in the event loop."""
        while not self._items:
            await self._news.wait()
            self._news.clear()
        return self._items.popleft()

    def clear(self) -> None:
        """Let nothing of what came until now wait any longer; in the event loop."""
        self._items.clear()

    def shed(self) -> int:
        """Return how many were shed since this was asked before; in the event loop."""
        shed = self._shed - self._said
        self._said += shed
        return shed

    def _call(self) -> None:
        self._is_called = False
        self._news.set()
