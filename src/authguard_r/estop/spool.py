# SPDX-License-Identifier: Apache-2.0
"""What a stop process leaves behind in files: stops that no gate has recorded, and its own name.

The files are for stops made while no gate runs: they are written after the answer, never synced,
and emptied once a gate has recorded all that they hold. Losing one loses records, never a stop.
Spec page: docs/spec/gate-protocol.md#stop-lane
"""

from __future__ import annotations

import os
import re
from contextlib import suppress
from pathlib import Path

import msgspec

from authguard_r.wire.messages import StopHeard
from authguard_r.wire.stop_limits import LIMITS

_ENCODER = msgspec.json.Encoder()
_DECODER = msgspec.json.Decoder(StopHeard)
_APPEND = os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC | os.O_NOFOLLOW
_WRITE = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW
_EPOCH = re.compile(rb"[0-9]{1,15}")


class Spool:
    """A file beside the stop process's socket: one JSON line for each stop.

    A world that does not let us write is no reason not to stop: nothing here raises.

    Args:
        path: the file; readable by its owner alone.
        most: longest file, in bytes.
    """

    def __init__(self, path: Path, *, most: int = LIMITS.spool_bytes) -> None:
        self._file = -1
        self._size = 0
        self._most = most
        self.retry_ms = 0
        self.known: tuple[StopHeard, ...] = ()
        try:
            self._file = os.open(path, _APPEND, 0o600)
            os.fchmod(self._file, 0o600)
            self._take_over(os.pread(self._file, most, 0))
        except OSError:
            self.close()

    @property
    def is_open(self) -> bool:
        """True when there is a file."""
        return self._file >= 0

    @property
    def is_used(self) -> bool:
        """True when there is something in it."""
        return self._size > 0

    def write(self, stops: list[StopHeard]) -> bool:
        """Append stops; false when the disk does not take them, and then none was written."""
        data = b"".join(_ENCODER.encode(stop) + b"\n" for stop in stops)
        if not self.is_open or self._size + len(data) > self._most:
            return False
        try:
            if os.write(self._file, data) == len(data):
                self._size += len(data)
                return True
            os.ftruncate(self._file, self._size)
        except OSError:
            return False
        return False

    def clear(self) -> None:
        """Empty the file: a gate has recorded everything in it."""
        if self._size and self.is_open:
            try:
                os.ftruncate(self._file, 0)
            except OSError:
                return
            self._size = 0

    def close(self) -> None:
        """Let go of the file; a second call does nothing."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1

    def _take_over(self, data: bytes) -> None:
        """Read what an earlier stop process left, and cut the line that it did not finish."""
        whole = data[: data.rfind(b"\n") + 1]
        os.ftruncate(self._file, len(whole))
        self._size = len(whole)
        self.known = _stops(whole.splitlines())


def left_by(*spools: Spool) -> tuple[StopHeard, ...]:
    """Return every stop that an earlier stop process left, in the order in which they came."""
    return tuple(sorted((s for spool in spools for s in spool.known), key=lambda stop: stop.n))


def next_epoch(path: Path, wall_ms: int, known: tuple[StopHeard, ...]) -> int:
    """Return a stop process's name, larger than every earlier one's here, and write it down.

    A wall clock that was set back gives no name that a gate takes for one that it knows.

    Args:
        path: holds the last name; one that cannot be used is done without.
        wall_ms: milliseconds since 1970.
        known: what an earlier stop process left.
    """
    last = max((stop.epoch for stop in known), default=-1)
    epoch = max(wall_ms, last + 1)
    with suppress(OSError):
        file = os.open(path, _WRITE, 0o600)
        try:
            said = os.pread(file, 64, 0)
            if _EPOCH.fullmatch(said):
                epoch = max(epoch, int(said) + 1)
            data = str(epoch).encode()
            os.pwrite(file, data, 0)  # as many digits as before, or more: never a smaller number
            os.ftruncate(file, len(data))
        finally:
            os.close(file)
    return epoch


def _stops(lines: list[bytes]) -> tuple[StopHeard, ...]:
    """Return the stops in the lines; of one that was written again, what was written last."""
    stops: dict[int, StopHeard] = {}
    for line in lines:
        try:
            stop = _DECODER.decode(line)
        except (msgspec.DecodeError, UnicodeDecodeError):
            continue
        stops[stop.n] = stop
    return tuple(stops.values())
