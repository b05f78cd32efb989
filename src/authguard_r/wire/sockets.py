# SPDX-License-Identifier: Apache-2.0
"""Connect to a Unix socket whose queue may be full."""

from __future__ import annotations

import asyncio
import socket
from pathlib import Path

#: A socket whose queue is full is tried again after this long, in seconds.
AGAIN_S = 0.005


async def reach(wire: socket.socket, path: Path) -> None:
    """Connect to a Unix socket; one whose queue is full is tried again, until canceled.

    The event loop's own way takes a full queue for a connection.

    Raises:
        OSError: no process listens there.
        ValueError: the path cannot be a socket's.
    """
    wire.settimeout(0)
    while True:
        try:
            wire.connect(str(path))
        except BlockingIOError:
            await asyncio.sleep(AGAIN_S)
        else:
            return
