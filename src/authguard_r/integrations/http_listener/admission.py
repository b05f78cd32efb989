# SPDX-License-Identifier: Apache-2.0
"""How many may be connected, and who has to go when there are more.

Every user of this machine can connect to a port, as often as they like. So each connection is
counted from the first moment on. At the limit, the oldest connection of a stranger is closed for
the next one. A connection whose request was let in and is not answered yet is kept. Spec
page: docs/spec/listeners.md
"""

from __future__ import annotations

import resource
from pathlib import Path
from typing import Generic, TypeVar

from msgspec import Struct
from msgspec.structs import replace

from authguard_r.core.errors import EnvironmentFault
from authguard_r.core.reasons import Reason

#: Files that a listener leaves to the rest of its process, beyond those that are open at its start.
RESERVE = 64
#: With fewer connections than this a listener does not start.
LEAST = 16

G = TypeVar("G")


class AdmissionLimits(Struct, frozen=True, kw_only=True):
    """What a listener gives to those whom it does not know, and to all in sum.

    Args:
        connections: at one time, in every state.
        first_s: from the connection, TLS included, until the first request's head is whole, and
            from an answer until the next one's is; in seconds.
        idle_s: nothing is asked between two requests for so long, in seconds.
        body_s: until a request's body is whole, in seconds.
        take_s: until an answer is taken, in seconds.
        head: longest head of a request, in bytes.
        body: longest body of a request, in bytes.
        lines: of one kind in the log in a second, about those whom it does not know.
    """

    connections: int
    first_s: float = 10.0
    idle_s: float = 5.0
    body_s: float = 10.0
    take_s: float = 10.0
    head: int = 16_384
    body: int
    lines: int = 50


def fitting(limits: AdmissionLimits) -> AdmissionLimits:
    """Return limits that the process has files for; it is allowed more files if it may have them.

    Raises:
        EnvironmentFault: there are files for less than `LEAST` connections.
    """
    taken = len(tuple(Path("/proc/self/fd").iterdir())) + RESERVE
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = taken + limits.connections
    if resource.RLIM_INFINITY not in (soft, hard) and soft < wanted:
        soft = min(wanted, hard)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    left = limits.connections if soft == resource.RLIM_INFINITY else soft - taken
    if left < LEAST:
        raise EnvironmentFault(
            f"the process may open {soft} files: give it at least {taken + LEAST} (`ulimit -n`)",
            reason=Reason.SERVICE_UNAVAILABLE,
            where="RLIMIT_NOFILE",
        )
    return replace(limits, connections=min(limits.connections, left))


class AdmissionControl(Generic[G]):
    """Who is connected.

    Args:
        most: so many at one time.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._strangers: dict[G, None] = {}
        self._known: dict[G, None] = {}
        self._served: set[G] = set()

    @property
    def guests(self) -> tuple[G, ...]:
        """Every connection that is there."""
        return (*self._strangers, *self._known, *self._served)

    @property
    def strangers(self) -> int:
        """How many are there of whom no request was let in."""
        return len(self._strangers)

    def is_stranger(self, guest: G) -> bool:
        """True while no request of it was let in."""
        return guest in self._strangers

    def enter(self, guest: G) -> G | None:
        """Take a connection in; return which one has to go for that: possibly the new one."""
        if len(self._strangers) + len(self._known) + len(self._served) < self._most:
            self._strangers[guest] = None
            return None
        gone = self.spare()
        if gone is None:
            return guest
        self._strangers[guest] = None
        return gone

    def spare(self) -> G | None:
        """Take out the connection that is needed least, and return it; None when all are needed."""
        for group in (self._strangers, self._known):
            for guest in group:
                del group[guest]
                return guest
        return None

    def stir(self, guest: G) -> None:
        """A stranger got something done: it is the last of them that has to go."""
        if self._strangers.pop(guest, self) is None:
            self._strangers[guest] = None

    def serve(self, guest: G) -> None:
        """A guest's request was let in: it stays until it is answered."""
        if guest in self._strangers or guest in self._known:
            self.leave(guest)
            self._served.add(guest)

    def rest(self, guest: G) -> None:
        """A guest has its answer: it goes after all strangers."""
        if guest in self._served:
            self._served.discard(guest)
            self._known[guest] = None

    def leave(self, guest: G) -> None:
        """A connection has ended."""
        self._strangers.pop(guest, None)
        self._known.pop(guest, None)
        self._served.discard(guest)
