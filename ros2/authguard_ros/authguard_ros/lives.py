# SPDX-License-Identifier: Apache-2.0
"""How often a process may end before nobody starts it again."""

from collections import deque


class Lives:
    """Counts the ends of one process.

    Args:
        most: so many ends are one too many,
        within_s: within so many seconds.
    """

    def __init__(self, most: int, within_s: float) -> None:
        self._most, self._within_s = most, within_s
        self._ends: deque[float] = deque(maxlen=most)

    def end(self, now_s: float) -> bool:
        """Take note of an end; return True when it cannot be held up.

        Args:
            now_s: the monotonic clock.
        """
        self._ends.append(now_s)
        return len(self._ends) == self._most and now_s - self._ends[0] <= self._within_s
