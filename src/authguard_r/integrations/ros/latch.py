# SPDX-License-Identifier: Apache-2.0
"""Whether who commands a robot is alive: judged by what was heard and when, by nothing else.

Once stopped, it stays stopped until one publisher alone was heard for a while, without a gap, and
asked for nothing but standing. Free of ROS: its callers bring samples, events and the time.
Spec page: docs/spec/ros-stopping.md#the-latch
"""

from __future__ import annotations

from enum import StrEnum

MS = 1_000_000


class LatchCause(StrEnum):
    """Why nothing may go."""

    #: nothing was heard since the start
    START = "start"
    #: DDS missed a sample
    DEADLINE = "deadline"
    #: DDS says that the publisher is not alive
    LIVELINESS = "liveliness"
    #: the own watch missed a sample
    SILENCE = "silence"
    #: the last publisher is gone
    GONE = "publisher_gone"
    #: another one publishes beside the one that was heard, or in its place
    ANOTHER = "another_publisher"
    #: a velocity is not a finite number
    NOT_FINITE = "not_finite"
    #: the robot's own driver failed
    DRIVER = "driver"
    #: its owner has closed it
    CLOSED = "closed"


class Latch:
    """Open while one publisher is heard all the time; closed it stays until a fresh lease.

    A fresh lease is: after the stop, samples of one publisher and of no other, none of them later
    than `silence_ms` after the one before, each of them neutral, for `settle_ms`.

    Args:
        silence_ms: longest time between two samples.
        settle_ms: how long only neutral samples have to come before it opens.
    """

    def __init__(self, *, silence_ms: int, settle_ms: int) -> None:
        self.why: LatchCause | None = LatchCause.START
        self._silence_ns = silence_ms * MS
        self._settle_ns = settle_ms * MS
        self._who = b""
        self._heard_ns: int | None = None
        self._neutral_ns: int | None = None  # since when nothing else came

    @property
    def is_open(self) -> bool:
        """True while something may go."""
        return self.why is None

    def hear(self, who: bytes, now_ns: int, *, is_neutral: bool) -> LatchCause | None:
        """Take a sample, and return why it may not go on; None: it may.

        Args:
            who: names its publisher; two publishers have two names.
            now_ns: the monotonic clock, when it was taken.
            is_neutral: it asks for nothing but standing.
        """
        is_same = who == self._who
        is_next = is_same and not self._is_silent(now_ns)
        if not is_next:
            self.stop(LatchCause.SILENCE if is_same else LatchCause.ANOTHER)
        self._who, self._heard_ns = who, now_ns
        if self.why is None:
            return None
        if not is_neutral:
            self._neutral_ns = None
        elif self._neutral_ns is None:
            self._neutral_ns = now_ns
        elif now_ns - self._neutral_ns >= self._settle_ns:
            self.why = self._neutral_ns = None
        return self.why

    def stop(self, why: LatchCause) -> bool:
        """Close it, and begin to wait for a fresh lease anew; return True if it was open."""
        self._neutral_ns = None
        was_open = self.is_open
        if was_open:
            self.why = why
        return was_open

    def look(self, now_ns: int) -> bool:
        """Close it if nothing was heard for too long; return True if that closed it."""
        return self.is_open and self._is_silent(now_ns) and self.stop(LatchCause.SILENCE)

    def _is_silent(self, now_ns: int) -> bool:
        return self._heard_ns is None or now_ns - self._heard_ns >= self._silence_ns
