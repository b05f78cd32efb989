# SPDX-License-Identifier: Apache-2.0
"""Whether what a robot's localization says is sound, sample by sample.

Every doubt is a reason to say nothing: a state that is not attested grows old, and the gate stops
the robot by itself. Free of ROS: its callers bring what messages say, and the time. Spec page:
docs/spec/ros-position.md#sound
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from enum import StrEnum

from msgspec import Struct

MS = 1_000_000
#: Samples that follow each other any later are a silence, in milliseconds.
SILENCE_MS = 1_000
#: So long, and for so many samples, nothing may be doubtful before anything is attested: longer
#: than the shipped missions let their place be old, so that a jump stops a robot that goes.
SETTLE_MS = 1_200
SETTLE_SAMPLES = 5
#: Stamps may run ahead of arrivals by so much: what the first of them was late by.
AHEAD_MS = 250
#: A publisher's clock may be slower than this machine's by one part in so many.
DRIFT = 1_000
#: A covariance's deviations that have to lie inside of the margin.
DEVIATIONS = 3
#: A robot that is higher or lower than this is on another floor, in meters.
HEIGHT_M = 1.0
#: No site is larger, in meters.
FAR_M = 1e6
#: Positions of so long ago are compared with, in milliseconds, and so far from each other.
WINDOW_MS = 1_000
SPACED_MS = 50
#: A speed is what was gone in so long at least, in milliseconds.
SPEED_MS = 200


class DoubtCause(StrEnum):
    """Why nothing is attested."""

    #: nothing was sound for long enough yet
    START = "start"
    #: nothing came for too long
    SILENCE = "silence"
    #: the position is in another frame
    FRAME = "frame"
    #: the position is another child's
    CHILD = "child"
    #: a NaN or an infinity
    NOT_FINITE = "not_finite"
    #: the orientation is not valid
    NOT_UNIT = "not_unit"
    #: the covariance is not valid, or says that the pose is worse than the margin
    COVARIANCE = "covariance"
    #: on another floor, or nowhere on earth
    HEIGHT = "height"
    FAR = "far"
    #: a stamp is before the one before
    BACK = "stamp_back"
    #: a stamp is that of the one before
    STILL = "stamp_still"
    #: stamps run faster than time
    AHEAD = "stamp_ahead"
    #: it took longer than the others by too much
    LATE = "late"
    #: no robot of this profile is so fast
    JUMP = "jump"
    #: two publishers, or one that took the place of the one before
    ANOTHER = "another_publisher"
    #: the middleware does not say who published
    UNNAMED = "unnamed_publisher"
    #: a publisher uses another type, or another version of it
    TYPE = "type"
    #: no transforms lead from the child to the frame
    NO_WAY = "no_way"
    #: transforms lead in a circle
    CYCLE = "cycle"
    #: more frames than are kept
    TOO_MUCH = "too_much"


class PositionSample(Struct, frozen=True, kw_only=True):
    """One position as one source says it.

    Args:
        x: in meters.
        y: in meters.
        z: in meters.
        who: names its publisher.
        newest_ns: when it was measured, on the monotonic clock.
        oldest_ns: when the oldest part of it was.
        speed: what is said of the speed, in m/s; None: the positions alone say it.
    """

    x: float
    y: float
    z: float
    who: bytes
    newest_ns: int
    oldest_ns: int
    speed: float | None = None


class Fix(Struct, frozen=True, kw_only=True):
    """What may be attested.

    Args:
        x_mm: to the nearest millimeter.
        y_mm: to the nearest millimeter.
        speed_mm_s: never less than what was said or seen.
        measured_ns: on the monotonic clock.
    """

    x_mm: int
    y_mm: int
    speed_mm_s: int
    measured_ns: int


class Stamps:
    """When something was measured, on the monotonic clock, by the stamps of one publisher.

    The publisher's clock is its own: only how it goes on counts. What took longer on its way than
    the fastest did is so much older.
    """

    def __init__(self) -> None:
        self._last_ns: int | None = None
        self._first_ns = self._least_ns = 0  # arrival less stamp: of the first, of the fastest
        self._began_ns = self._arrived_ns = 0

    def take(self, stamp_ns: int, arrived_ns: int) -> int | DoubtCause:
        """Return when it was measured, or why that is unknown."""
        apart = arrived_ns - stamp_ns
        if self._last_ns is None:
            self._first_ns = self._least_ns = apart
            self._began_ns = arrived_ns
        elif stamp_ns <= self._last_ns:
            return DoubtCause.STILL if stamp_ns == self._last_ns else DoubtCause.BACK
        else:
            self._least_ns += (arrived_ns - self._arrived_ns) // DRIFT
        # a clock that runs ahead little by little runs ahead too
        drift_ns = (arrived_ns - self._began_ns) // DRIFT
        if apart < self._first_ns - AHEAD_MS * MS - drift_ns:
            return DoubtCause.AHEAD
        self._last_ns, self._arrived_ns = stamp_ns, arrived_ns
        self._least_ns = min(self._least_ns, apart)
        late_ns = apart - self._least_ns
        return DoubtCause.LATE if late_ns >= SILENCE_MS * MS else arrived_ns - late_ns


def covariance_fault(values: Sequence[float], margin_mm: int) -> DoubtCause | None:
    """Return why a pose's covariance does not bear the margin; None: it does, or says nothing.

    Args:
        values: six rows of six: x, y, z and three angles; in square meters. Zeros say nothing.
        margin_mm: the radius that has to hold the true position.
    """
    if len(values) != 36:
        return DoubtCause.COVARIANCE
    if not all(math.isfinite(value) for value in values):
        return DoubtCause.NOT_FINITE
    a, b, other, c = values[0], values[1], values[6], values[7]
    # the longer axis of the ellipse that it is
    longest = (a + c) / 2 + math.hypot((a - c) / 2, b)
    is_one = a >= 0 and c >= 0 and b == other and b * b <= a * c * (1 + 1e-9)
    is_good = DEVIATIONS**2 * longest <= (margin_mm / 1_000) ** 2
    return None if is_one and is_good else DoubtCause.COVARIANCE


class PositionTrack:
    """One robot's positions: `fix` is what may be attested, None while anything is doubtful.

    Args:
        max_speed_mm_s: of the robot's profile.
        margin_mm: the radius that holds the true position.
    """

    def __init__(self, *, max_speed_mm_s: int, margin_mm: int) -> None:
        self.fix: Fix | None = None
        self.why: DoubtCause | None = DoubtCause.START
        self._max_speed = max_speed_mm_s / 1_000
        self._slack = 2 * margin_mm / 1_000
        self._kept: deque[PositionSample] = deque()
        self._last: PositionSample | None = None
        self._since_ns = 0
        self._count = 0
        self._doubted_ns: int | None = None

    @property
    def is_lost(self) -> bool:
        """True when the last word was a doubt: what comes next is compared with nothing."""
        return self._last is None

    def take(self, sample: PositionSample) -> None:
        """Take a position; a doubtful one ends what was sound before it."""
        last = self._last
        if last is not None and sample.newest_ns - last.newest_ns >= SILENCE_MS * MS:
            self.doubt(DoubtCause.SILENCE)
        fault = self.stranger(sample.who) or self._fault(sample)
        if fault is not None:
            self.doubt(fault)
            return
        self._keep(sample)
        self._count += 1
        is_settled = sample.newest_ns - self._since_ns >= SETTLE_MS * MS
        if self._count >= SETTLE_SAMPLES and is_settled:
            self.why, self.fix = None, self._fixed(sample)

    def stranger(self, who: bytes) -> DoubtCause | None:
        """Return why this source may not say where the robot is; None for the earlier source."""
        if not who:
            return DoubtCause.UNNAMED
        is_new = self._last is not None and who != self._last.who
        return DoubtCause.ANOTHER if is_new else None

    def doubt(self, why: DoubtCause) -> None:
        """Attest nothing, and forget what was before."""
        self.fix, self.why, self._last, self._count = None, why, None, 0
        self._doubted_ns = None
        self._kept.clear()

    def look(self, now_ns: int) -> None:
        """Look at the clock: what is too old is a silence, and a doubt that nothing follows is."""
        if self._last is not None:
            is_silent = now_ns - self._last.oldest_ns >= SILENCE_MS * MS
        elif self._doubted_ns is None:  # the first look after it
            self._doubted_ns, is_silent = now_ns, False
        else:
            is_said = self.why in {DoubtCause.START, DoubtCause.SILENCE}
            is_silent = not is_said and now_ns - self._doubted_ns >= SILENCE_MS * MS
        if is_silent:
            self.doubt(DoubtCause.SILENCE)

    def _fault(self, sample: PositionSample) -> DoubtCause | None:
        values = (sample.x, sample.y, sample.z, sample.speed or 0.0)
        if not all(math.isfinite(value) for value in values):
            return DoubtCause.NOT_FINITE
        if abs(sample.z) > HEIGHT_M:
            return DoubtCause.HEIGHT
        if any(abs(value) > FAR_M for value in values):
            return DoubtCause.FAR
        if sample.newest_ns - sample.oldest_ns >= SILENCE_MS * MS:
            return DoubtCause.SILENCE
        if self._least_speed(sample) > self._max_speed:
            return DoubtCause.JUMP
        return None

    def _least_speed(self, sample: PositionSample) -> float:
        """Return how fast a robot that was at the positions before is at least, in m/s."""
        least = 0.0
        last = () if self._last is None else (self._last,)  # the newest one is not always kept
        for other in (*self._kept, *last):
            gone = math.hypot(sample.x - other.x, sample.y - other.y) - self._slack
            took_s = (sample.newest_ns - other.newest_ns) / 1e9
            if gone > 0:
                least = max(least, gone / took_s if took_s > 0 else math.inf)
        return least

    def _keep(self, sample: PositionSample) -> None:
        if self._last is None:
            self._since_ns = sample.newest_ns
        self._last = sample
        kept = self._kept
        if not kept or sample.newest_ns - kept[-1].newest_ns >= SPACED_MS * MS:
            kept.append(sample)
        while sample.newest_ns - kept[0].newest_ns > WINDOW_MS * MS:
            kept.popleft()

    def _fixed(self, sample: PositionSample) -> Fix:
        seen = self._seen_speed(sample) if sample.speed is None else sample.speed
        speed = max(abs(seen), self._least_speed(sample))
        return Fix(
            x_mm=round(sample.x * 1_000),
            y_mm=round(sample.y * 1_000),
            speed_mm_s=math.ceil(speed * 1_000),
            measured_ns=sample.oldest_ns,
        )

    def _seen_speed(self, sample: PositionSample) -> float:
        """Return the speed that the positions show, in m/s; without taking off any margin."""
        other = self._kept[0]
        for kept in self._kept:
            if sample.newest_ns - kept.newest_ns >= SPEED_MS * MS:
                other = kept
        gone = math.hypot(sample.x - other.x, sample.y - other.y)
        return gone / ((sample.newest_ns - other.newest_ns) / 1e9)
