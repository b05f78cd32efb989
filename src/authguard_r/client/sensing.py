# SPDX-License-Identifier: Apache-2.0
"""The connection of an estimator to a robot's sensors: raw values, never fresher than they are.

How-to: docs/howto/simulator.md
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

from authguard_r.client.attesting import Measurement
from authguard_r.client.link import FIRST_PAUSE_S, LONGEST_PAUSE_S, ProcessLog, mono_ms
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import RobotId
from authguard_r.core.state import Snapshot
from authguard_r.wire.frames import Frame, FrameReader, read_body
from authguard_r.wire.messages import BOUND, Kind

SENSORS = "sensors.sock"
#: A frame's id is the machine's monotonic clock when it was measured, in so many bits.
ID_MODULUS = 1 << 32


def read_raw(item: Frame, now_ms: int, robot: RobotId) -> Measurement:
    """Return what the sensors say, and when it was measured.

    What claims to be of the future counts as very old.

    Raises:
        MalformedError: it is no snapshot of this robot.
    """
    snapshot = read_body(item.body, Snapshot)
    if snapshot.robot != robot:
        raise MalformedError(
            f"expected values of `{robot}`, got `{snapshot.robot}`'s", where="robot"
        )
    return Measurement(snapshot, now_ms - (now_ms - item.id) % ID_MODULUS)


class _SensorLink(asyncio.Protocol):
    """The connection to the sensors; it says nothing."""

    def __init__(self, take: Callable[[Frame, int], None], log: ProcessLog) -> None:
        self.over = asyncio.Event()
        self._take = take
        self._log = log
        self._reader = FrameReader(lambda kind: BOUND[Kind.SNAPSHOT] if kind == Kind.EVENT else 0)
        self._transport: asyncio.BaseTransport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = transport
        self._log.say("connected", SENSORS)

    def data_received(self, data: bytes) -> None:
        try:
            for item in self._reader.feed(data):
                self._take(item, mono_ms())
        except MalformedError as error:
            self._log.fault(SENSORS, error)
            self.hang_up()

    def connection_lost(self, exc: Exception | None) -> None:  # noqa: ARG002 - gone is gone
        self.over.set()

    def hang_up(self) -> None:
        if isinstance(self._transport, asyncio.Transport):
            self._transport.abort()


async def listen(run: Path, take: Callable[[Frame, int], None], log: ProcessLog) -> None:
    """Keep the connection to the sensors until this is canceled.

    Args:
        run: the folder with their socket.
        take: takes a frame and the monotonic clock; it raises `MalformedError` at a frame that is
            not of this robot's sensors, and the connection is made anew.
        log: says what happens.
    """
    pause, path = FIRST_PAUSE_S, str(run / SENSORS)
    while True:
        link = _SensorLink(take, log)
        if await _is_open(link, path, log):
            pause = FIRST_PAUSE_S
        await asyncio.sleep(pause)
        pause = min(pause * 2, LONGEST_PAUSE_S)


async def _is_open(link: _SensorLink, path: str, log: ProcessLog) -> bool:
    """Listen while the connection lasts; return whether there was one."""
    try:
        await asyncio.get_running_loop().create_unix_connection(lambda: link, path)
        await link.over.wait()
    except OSError as error:
        log.say("unreachable", SENSORS, message=error.strerror or str(error))
        return False
    finally:
        link.hang_up()
    log.say("disconnected", SENSORS)
    return True
