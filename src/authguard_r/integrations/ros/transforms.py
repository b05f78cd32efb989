# SPDX-License-Identifier: Apache-2.0
"""Transforms between frames: the last one of each child, and the way from a child to a frame.

Free of ROS: its caller brings what messages say. Spec page: docs/spec/ros-position.md#transforms
"""

from __future__ import annotations

import math
from typing import NamedTuple

from msgspec import Struct

from authguard_r.integrations.ros.position import DoubtCause, Stamps

#: Most frames that are kept, and most transforms of one message: a robot has some dozens.
MAX_FRAMES = 256
#: A quaternion's length may be so far from 1.
UNIT = 1e-3


class Vector(NamedTuple):
    """A position, in meters."""

    x: float
    y: float
    z: float


class Quaternion(NamedTuple):
    """An orientation; its length is 1."""

    x: float
    y: float
    z: float
    w: float


class Placed(NamedTuple):
    """Where a frame is in another one."""

    at: Vector
    turned: Quaternion


class ChildTransform(Struct, frozen=True, kw_only=True):
    """The last transform of a child.

    Args:
        parent: the frame that it is in.
        placed: where it is there.
        who: names its publisher; empty of one that never changes.
        measured_ns: when, on the monotonic clock; None: it never changes.
    """

    parent: str
    placed: Placed
    who: bytes = b""
    measured_ns: int | None = None


class FramePath(Struct, frozen=True):
    """Where a child is in a frame.

    Args:
        at: its position.
        oldest_ns: when the oldest transform on the way was measured.
        newest_ns: when the newest was.
    """

    at: Vector
    oldest_ns: int
    newest_ns: int


def fault_of(placed: Placed) -> DoubtCause | None:
    """Return why this is no place at all; None: it is one."""
    if not all(math.isfinite(value) for part in placed for value in part):
        return DoubtCause.NOT_FINITE
    return None if is_unit(placed.turned) else DoubtCause.NOT_UNIT


def is_unit(turned: Quaternion) -> bool:
    """Return True of an orientation that is one: its length is 1, by `UNIT`."""
    return abs(math.hypot(*turned) - 1.0) <= UNIT


class Frames:
    """The last transform of each child; nothing is interpolated or extrapolated."""

    def __init__(self) -> None:
        self._links: dict[str, ChildTransform] = {}
        self._stamps: dict[str, Stamps] = {}

    def put_static(self, child: str, parent: str, placed: Placed) -> DoubtCause | None:
        """Take a transform that never changes; return why it cannot be."""
        known = self._links.get(child)
        fault = fault_of(placed) or self._crowd(child)
        if fault is not None:
            return fault
        if known is not None and (known.parent, known.placed) != (parent, placed):
            del self._links[child]  # two that never change: neither is trusted
            return DoubtCause.ANOTHER
        self._links[child] = ChildTransform(parent=parent, placed=placed)
        return None

    def put(
        self,
        child: str,
        parent: str,
        placed: Placed,
        *,
        who: bytes,
        stamp_ns: int,
        arrived_ns: int,
    ) -> DoubtCause | None:
        """Take a transform that changes; return why it cannot be.

        One that was said before, by its stamp, is passed over: it makes nothing fresh.

        Args:
            child: the frame that it places.
            parent: in which one.
            placed: where.
            who: names its publisher.
            stamp_ns: what its publisher says of the time, by a clock of its own.
            arrived_ns: the monotonic clock when it came.
        """
        known = self._links.get(child)
        if known is not None and known.measured_ns is None:
            return DoubtCause.ANOTHER
        if known is not None and (known.who, known.parent) != (who, parent):
            self._drop(child)
            return DoubtCause.ANOTHER
        fault = fault_of(placed) or self._crowd(child)
        if fault is not None:
            self._drop(child)
            return fault
        taken = self._stamps.setdefault(child, Stamps()).take(stamp_ns, arrived_ns)
        if taken is DoubtCause.STILL and known is not None and known.placed == placed:
            return None
        if isinstance(taken, DoubtCause):
            self._drop(child)
            return taken
        self._links[child] = ChildTransform(
            parent=parent, placed=placed, who=who, measured_ns=taken
        )
        return None

    def way(self, frame: str, child: str) -> FramePath | DoubtCause:
        """Return where the child is in the frame, or why that is unknown."""
        at, name, times = Vector(0.0, 0.0, 0.0), child, list[int]()
        seen: set[str] = set()
        while name != frame:
            link = self._links.get(name)
            if link is None:
                return DoubtCause.NO_WAY
            if name in seen:
                return DoubtCause.CYCLE
            seen.add(name)
            at = _moved(link.placed, at)
            if link.measured_ns is not None:
                times.append(link.measured_ns)
            name = link.parent
        if not times:  # a part that moves says so
            return DoubtCause.NO_WAY
        return FramePath(at, min(times), max(times))

    def on_way(self, frame: str, child: str) -> frozenset[str]:
        """Return the frames that are on the way, as far as there is one."""
        seen, name = set[str](), child
        while name != frame and name not in seen:
            seen.add(name)
            link = self._links.get(name)
            if link is None:
                break
            name = link.parent
        return frozenset(seen)

    def _crowd(self, child: str) -> DoubtCause | None:
        is_full = len(self._links) >= MAX_FRAMES and child not in self._links
        return DoubtCause.TOO_MUCH if is_full else None

    def _drop(self, child: str) -> None:
        """Forget a child: what comes next is its first."""
        self._links.pop(child, None)
        self._stamps.pop(child, None)


def _moved(placed: Placed, at: Vector) -> Vector:
    """Return a point of a frame in the frame that it is placed in."""
    x, y, z, w = placed.turned
    # v + 2 u x (u x v + w v), for a unit quaternion (u, w)
    tx, ty, tz = (
        y * at.z - z * at.y + w * at.x,
        z * at.x - x * at.z + w * at.y,
        x * at.y - y * at.x + w * at.z,
    )
    return Vector(
        placed.at.x + at.x + 2 * (y * tz - z * ty),
        placed.at.y + at.y + 2 * (z * tx - x * tz),
        placed.at.z + at.z + 2 * (x * ty - y * tx),
    )
