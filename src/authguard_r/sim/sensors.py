# SPDX-License-Identifier: Apache-2.0
"""The symbolic robot's sensors: raw snapshots for every process that may open the socket.

They are unsigned, and nothing is read from a listener. A frame's id is the machine's monotonic
clock when it was measured, so that what waited in a buffer is known to be old. How-to:
docs/howto/simulator.md
"""

from __future__ import annotations

import asyncio
import os
import socket
from collections.abc import Callable
from pathlib import Path

from authguard_r.client.sensing import ID_MODULUS
from authguard_r.core.errors import EnvironmentFault
from authguard_r.core.reasons import Reason
from authguard_r.core.state import Snapshot
from authguard_r.wire.frames import frame
from authguard_r.wire.messages import Kind

#: Time between two snapshots, in milliseconds.
LOOK_MS = 50
#: Listeners at a time; one more is not served.
MAX_LISTENERS = 64
#: Bytes that a listener may leave unread before it misses snapshots.
MAX_UNREAD = 1 << 16


def reading_frame(seen: Snapshot, measured_ms: int) -> bytes:
    """Return the bytes of one raw snapshot.

    Args:
        seen: epoch and seq are 0.
        measured_ms: the monotonic clock.
    """
    return frame(Kind.EVENT, measured_ms % ID_MODULUS, seen)


class _Listener(asyncio.Protocol):
    """One who listens; who speaks here is let go."""

    def __init__(self, all_of_them: set[asyncio.Transport]) -> None:
        self._all = all_of_them
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        if isinstance(transport, asyncio.Transport):
            self._transport = transport
            if len(self._all) < MAX_LISTENERS:
                self._all.add(transport)
            else:
                transport.abort()

    def data_received(self, data: bytes) -> None:  # noqa: ARG002 - sensors take no orders
        if self._transport is not None:
            self._transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:  # noqa: ARG002 - gone is gone
        if self._transport is not None:
            self._all.discard(self._transport)


class SensorServer:
    """Serves snapshots on a socket that user and group may open.

    Args:
        path: where the socket is made; a dead one is replaced.
        look: what the sensors see now, None while they are silent.
        clock: the monotonic clock in milliseconds.
    """

    def __init__(
        self, path: Path, look: Callable[[], Snapshot | None], *, clock: Callable[[], int]
    ) -> None:
        self._path = path
        self._look = look
        self._clock = clock
        self._listeners: set[asyncio.Transport] = set()
        self._server: asyncio.Server | None = None

    async def open(self) -> None:
        """Begin to listen.

        Raises:
            EnvironmentFault: another robot's process serves this socket, or it cannot be made.
        """
        _require_free(self._path)
        loop = asyncio.get_running_loop()
        before = os.umask(0o117)  # 0660 from the first moment on
        try:
            self._server = await loop.create_unix_server(
                lambda: _Listener(self._listeners), str(self._path)
            )
        except OSError as error:
            raise _unusable(self._path, error.strerror or str(error)) from error
        finally:
            os.umask(before)

    def look(self) -> None:
        """Send what is seen now to every listener that keeps up."""
        now_ms = self._clock()  # before the look: nothing is said to be newer than it is
        seen = self._look()
        if seen is None:
            return
        data = reading_frame(seen, now_ms)
        for listener in tuple(self._listeners):
            if listener.get_write_buffer_size() <= MAX_UNREAD:
                listener.write(data)

    async def close(self) -> None:
        """End every connection and remove the socket."""
        if self._server is None:
            return
        self._server.close()
        for listener in tuple(self._listeners):
            listener.abort()
        await asyncio.sleep(0)
        self._path.unlink(missing_ok=True)


def _require_free(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as probe:
        try:
            probe.connect(str(path))
        except OSError:
            return  # no process answers there
    raise _unusable(path, "a robot's process is running already")


def _unusable(path: Path, why: str) -> EnvironmentFault:
    return EnvironmentFault(
        f"cannot serve `{path}`: {why}", reason=Reason.SERVICE_UNAVAILABLE, where=str(path)
    )
