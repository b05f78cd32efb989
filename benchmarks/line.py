# SPDX-License-Identifier: Apache-2.0
"""A client's raw line to a gate, and what it proposes; quick to import, for client processes."""

from __future__ import annotations

import socket
import struct
from itertools import count
from pathlib import Path
from typing import Any

import msgspec

from authguard_r.client.start import fresh
from authguard_r.wire.frames import frame
from authguard_r.wire.messages import PROTOCOL, ClientRole, Hello, Kind, Propose

#: Looking around is over at once and changes nothing, so nothing but decisions takes time.
ACCEPTED = b'{"plan": [{"tool": "scan", "arguments": {}}]}'
#: No grant of the mission lets this planner speak.
REFUSED = b'{"plan": [{"tool": "say", "arguments": {"text": "come here"}}]}'
#: A second of standing still: simulated time passes.
SECOND = b'{"plan": [{"tool": "wait", "arguments": {"seconds": 1, "reason": "soak"}}]}'
HEADER = struct.Struct(">IBI")


class Line:
    """A planner's connection, frame by frame, with nothing between the clock and the socket."""

    def __init__(self, path: Path, name: str, role: ClientRole = ClientRole.PLANNER) -> None:
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.socket.connect(str(path))
        self._held = b""
        self._numbers = count(1)
        self.socket.sendall(frame(Kind.HELLO, 0, Hello(protocol=PROTOCOL, role=role, client=name)))
        kind, _, body = self.next()
        if kind != Kind.WELCOME:
            raise RuntimeError(f"the gate does not take `{name}`: {body!r}")

    def proposal(self, plan: bytes) -> bytes:
        """Return the frame of a new proposal."""
        return frame(Kind.PROPOSE, next(self._numbers), Propose(key=fresh(), plan=plan))

    def next(self) -> tuple[int, int, bytes]:
        """Return the kind, number and body of the next frame."""
        while True:
            if len(self._held) >= HEADER.size:
                length, kind, number = HEADER.unpack_from(self._held)
                end = HEADER.size + length
                if len(self._held) >= end:
                    body, self._held = self._held[HEADER.size : end], self._held[end:]
                    return kind, number, body
            data = self.socket.recv(1 << 16)
            if not data:
                raise RuntimeError("the gate closed the connection")
            self._held += data

    def close(self) -> None:
        self.socket.close()


def said(body: bytes) -> dict[str, Any]:
    """Return what a frame's body says."""
    told: dict[str, Any] = msgspec.json.decode(body)
    return told
