# SPDX-License-Identifier: Apache-2.0
"""What a client needs of the machine: randomness, the clock, and how long it waits.

Spec page: docs/spec/gate-protocol.md#connections
"""

from __future__ import annotations

import os
from pathlib import Path
from time import time_ns

from authguard_r.client.handshake import Handshake
from authguard_r.client.session import ClientSession, unreachable
from authguard_r.core.encoding import b64
from authguard_r.core.errors import EnvironmentFault
from authguard_r.core.quantities import Now

#: Longest wait for an answer, in milliseconds, unless a client says otherwise.
TIMEOUT_MS = 10_000
#: Bytes that are read at once.
CHUNK = 1 << 16
#: What to do when no process could be reached.
_MENDS: dict[type[Exception], str] = {
    FileNotFoundError: "start one, or name the run folder of one that serves",
    ConnectionRefusedError: "the one that served there has ended: start it again",
    PermissionError: "this user may not reach it: check the permissions of the run folder",
    BlockingIOError: "too many wait there: try again",
}


def begin(handshake: Handshake) -> ClientSession:
    """Return the session of a new connection."""
    return ClientSession(handshake, nonce=fresh(), now=_wall)


def fresh() -> str:
    """Return a value that was never used: 16 random bytes, base64url."""
    return b64(os.urandom(16))


def late(timeout_ms: int | None) -> EnvironmentFault:
    """Return the error of an answer that did not come in time."""
    return unreachable(f"the gate did not answer within {timeout_ms} ms")


def unanswered(error: OSError | ValueError, path: Path) -> EnvironmentFault:
    """Return the error of a socket that could not be reached, with what to do about it."""
    why = getattr(error, "strerror", None) or str(error) or "its queue is full"
    mend = _MENDS.get(type(error), "look at the path")
    return unreachable(f"no gate answers: {why}; {mend}", str(path))


def _wall() -> Now:
    return Now(time_ns() // 1_000_000, 0)
