# SPDX-License-Identifier: Apache-2.0
"""Strangers at a port: many connections that say little, and are made again when they are ended.

    python crowd.py KIND HOST PORT CONNECTIONS SECONDS

`idle` says nothing, `half` begins a request, `noise` says what is no request, `asks` sends whole
requests without a token, one after the other, `broken` goes on with nonsense after an answer.
Connections, time and bytes are bounded. A line says `there` once all have connected, another one at
the end how many there were.
"""

from __future__ import annotations

import json
import resource
import selectors
import socket
import sys
import time
from contextlib import suppress

SAYS = {
    "idle": b"",
    "half": b"POST /mcp HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Half: ",
    "noise": b"nothing of the kind\r\n\r\n",
    "broken": b"POST / HTTP/1.1\r\nHost: 127.0.0.1\r\nTransfer-Encoding: chunked\r\n\r\n",
    "asks": b"GET /v1/status HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
}
#: Connections in a second: until all have come, and then those that are made again. Bytes in all.
FIRST, AGAIN, MOST_BYTES = 3_000, 300, 64 << 20


class Crowd:
    """The connections.

    Args:
        kind: what each says.
        place: where.
        most: so many at a time.
    """

    def __init__(self, kind: str, place: tuple[str, int], most: int) -> None:
        self._says, self._place, self._most = SAYS[kind], place, most
        self._again = kind == "asks"
        self._then = b"no length\r\n" if kind == "broken" else b""
        self._selector = selectors.DefaultSelector()
        self._open: set[socket.socket] = set()
        self.made = self.ended = self.sent = 0

    def fill(self, room: int) -> None:
        """Connect until there are as many as there are to be, or no more may be made now."""
        for _ in range(min(room, self._most - len(self._open))):
            link = socket.socket()
            link.setblocking(False)
            link.connect_ex(self._place)
            self._open.add(link)
            self._selector.register(link, selectors.EVENT_WRITE)
            self.made += 1

    def may(self, spent: float) -> int:
        """Return how many may be made again, so long after all had come."""
        return max(0, self._most + int(AGAIN * spent) - self.made)

    def turn(self) -> None:
        """Say what is to be said, and notice who was let go."""
        for key, events in self._selector.select(0.01):
            link = key.fileobj
            assert isinstance(link, socket.socket)
            try:
                if events & selectors.EVENT_WRITE:
                    self.say(link)
                    self._selector.modify(link, selectors.EVENT_READ)
                elif not link.recv(1 << 16):
                    raise ConnectionResetError
                elif self._again:
                    self.say(link)
                elif self._then:
                    self.sent += link.send(self._then)
            except OSError:
                self.end(link)

    def say(self, link: socket.socket) -> None:
        """Say it once more."""
        if self.sent < MOST_BYTES:
            self.sent += link.send(self._says) if self._says else 0

    def end(self, link: socket.socket) -> None:
        """Let go of one."""
        self._open.discard(link)
        self._selector.unregister(link)
        link.close()
        self.ended += 1


def main(kind: str, host: str, port: str, most: str, seconds: str) -> None:
    """Stand there for a while."""
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    wanted = int(most) if hard == resource.RLIM_INFINITY else min(int(most), hard - 64)
    crowd, began = Crowd(kind, (host, int(port)), wanted), time.monotonic()
    there_s: float | None = None
    while (spent := time.monotonic() - began) < float(seconds):
        crowd.fill(
            int(FIRST * spent) - crowd.made if there_s is None else crowd.may(spent - there_s)
        )
        crowd.turn()
        if there_s is None and crowd.made >= wanted:
            there_s = spent
            sys.stdout.write("there\n")
            sys.stdout.flush()
    said = {"made": crowd.made, "ended": crowd.ended, "sent": crowd.sent}
    with suppress(BrokenPipeError):
        sys.stdout.write(json.dumps(said) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main(*sys.argv[1:])
