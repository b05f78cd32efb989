# SPDX-License-Identifier: Apache-2.0
"""A client process that offers work to a gate, open loop: when it was meant to, not when it may.

    python benchmarks/offer.py benign|flood|stops|closed SOCKET NAME RATE SECONDS

It says that it is connected, then reads the instant at which to begin from its standard input, on
the monotonic clock, which all processes of a machine share. What happened is one JSON object on
standard output. A time is counted from the instant at which the request was
meant to be sent: one that had to wait for the answer to the one before has waited for the gate.
"""

from __future__ import annotations

import json
import select
import socket
import sys
from collections import Counter
from collections.abc import Callable
from itertools import count
from pathlib import Path
from time import monotonic, sleep
from typing import Any

from authguard_r.client import GateClient
from authguard_r.wire.frames import frame, raw_frame
from authguard_r.wire.messages import ClientRole, Kind, Propose
from line import ACCEPTED, HEADER, REFUSED, Line, said

_UNREADABLE = b"first I will scan(, then"
_ELSEWHERE = b'{"plan": [{"tool": "navigate_to", "arguments": {"destination": "Station 103"}}]}'
#: Of ten proposals of a flood: six that no grant covers, two that cannot be read, one to a place
#: that is not the mission's, one frame whose body is no message. What comes while one of them is
#: being decided is shed by its header.
_MIX = (
    REFUSED,
    _UNREADABLE,
    REFUSED,
    _ELSEWHERE,
    REFUSED,
    b"",
    REFUSED,
    _UNREADABLE,
    *2 * (REFUSED,),
)
#: One of so many is of a kind that may not come: the connection ends, and the flood calls again.
_FORBIDDEN = 5_000
_KEY = "0" * 16
_BATCH, _TICK_S = 64, 0.002

#: Returns the instant to begin at, once it has come.
Begin = Callable[[], float]


def benign(path: Path, name: str, rate: float, seconds: float, begin: Begin) -> dict[str, Any]:
    """Offer accepted work; return microseconds to decision and to outcome, from the intent."""
    line = Line(path, name)
    took: dict[str, list[int]] = {"decided_us": [], "settled_us": [], "late_us": []}
    failed: Counter[str] = Counter()
    for due in _instants(rate, seconds, begin()):
        data = line.proposal(ACCEPTED)
        _until(due)
        took["late_us"].append(_us(due))
        line.socket.sendall(data)
        decided, body = 0, b""
        while True:
            kind, _, body = line.next()
            if kind != Kind.EVENT:
                break
            decided = _us(due)
        if decided:  # it was released; whether it was then carried out is counted apart
            took["decided_us"].append(decided)
            took["settled_us"].append(_us(due))
        if kind != Kind.REPLY or b'"succeeded"' not in body:
            failed[_why(body)] += 1
    line.close()
    return {**took, "failed": dict(failed)}


def stops(path: Path, name: str, rate: float, seconds: float, begin: Begin) -> dict[str, Any]:
    """Stop the robot again and again; return microseconds until it was said to stand.

    `sent_us` counts from when this process had its turn on a core and sent the request.
    """
    client = GateClient.connect(path, role=ClientRole.AUDITOR, client=name)
    stood_us, sent_us, late_us, failed = [], [], [], 0
    for due in _instants(rate, seconds, begin()):
        _until(due)
        late_us.append(_us(due))
        told = client.stop("benchmark")
        stood_us.append(_us(due))
        sent_us.append(stood_us[-1] - late_us[-1])
        failed += not told["stopped"]
    client.close()
    return {"stood_us": stood_us, "sent_us": sent_us, "late_us": late_us, "failed": failed}


def closed(path: Path, name: str, rate: float, seconds: float, begin: Begin) -> dict[str, Any]:
    """Offer refused work as fast as it is answered: what the gate can do."""
    line = Line(path, name)
    at = begin()
    answered = 0
    while monotonic() < at + seconds:
        line.socket.sendall(line.proposal(REFUSED))
        while line.next()[0] not in {Kind.REPLY, Kind.ERROR}:
            pass
        answered += 1
    line.close()
    return {"answered": answered}


class Flood:
    """Sends so many proposals a second, whatever becomes of them; reads every answer.

    What the gate does not take because it reads nothing more from this client is offered all the
    same, and counted as `held_back`.
    """

    def __init__(self, path: Path, name: str) -> None:
        self._path, self._name = path, name
        self._numbers = count(1)
        self._made = [_template(plan) for plan in _MIX]
        self._rest = b""
        self._line: socket.socket | None = None
        self.counted: Counter[str] = Counter()
        self._call()

    def run(self, rate: float, seconds: float, begin: Begin) -> dict[str, Any]:
        at = begin()
        offered = 0
        while (now := monotonic()) < at + seconds:
            due = int((now - at) * rate)
            while offered < due:
                size = min(_BATCH, due - offered)
                offered += size
                if not self._send(size):
                    self.counted["held_back"] += due - offered
                    offered = due
            self._take()
        return {"offered": offered, **self.counted}

    def _send(self, size: int) -> bool:
        """Send the rest of the last batch, then a new one; False when nothing more goes in."""
        try:
            if self._rest:
                self._rest = self._rest[self._socket.send(self._rest) :]
            if self._rest:
                self.counted["held_back"] += size
                return False
            data = b"".join(self._next() for _ in range(size))
            self._rest = data
            self._rest = data[self._socket.send(data) :]
            self.counted["sent"] += size
        except BlockingIOError:
            self.counted["sent" if self._rest else "held_back"] += size
            return False
        except OSError:
            self._call()
        return True

    def _next(self) -> bytes:
        number = next(self._numbers)
        if number % _FORBIDDEN == 0:
            return raw_frame(Kind.ORDER, number, b"{}")
        body, end = self._made[number % len(self._made)]
        return HEADER.pack(len(body) + len(end), Kind.PROPOSE, number) + (
            body.replace(_KEY.encode(), b"%016x" % number) + end
        )

    def _take(self) -> None:
        ready, _, _ = select.select([self._socket], [], [], _TICK_S)
        if not ready:
            return
        try:
            data = self._socket.recv(1 << 18)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._call()
            return
        busy = data.count(b'"BUSY"')
        self.counted["shed"] += busy
        self.counted["malformed"] += data.count(b'"code":') - busy
        self.counted["refused"] += data.count(b'"planned":')

    @property
    def _socket(self) -> socket.socket:
        if self._line is None:
            raise RuntimeError("a flood has a connection")
        return self._line

    def _call(self) -> None:
        if self._line is not None:
            self._line.close()
            self.counted["called_again"] += 1
        self._rest = b""
        self._line = Line(self._path, self._name).socket
        self._line.settimeout(0)


def flood(path: Path, name: str, rate: float, seconds: float, begin: Begin) -> dict[str, Any]:
    """Offer what is refused, shed or malformed, so many a second; return what became of it."""
    return Flood(path, name).run(rate, seconds, begin)


def _template(plan: bytes) -> tuple[bytes, bytes]:
    """Return a proposal's body in two halves, with a key to be replaced in the first."""
    if not plan:
        return b'{"key":"' + _KEY.encode() + b'","plan":', b"7,,}"
    body = frame(Kind.PROPOSE, 0, Propose(key=_KEY, plan=plan))[HEADER.size :]
    cut = body.index(_KEY.encode()) + len(_KEY)
    return body[:cut], body[cut:]


def _instants(rate: float, seconds: float, at: float) -> list[float]:
    return [at + number / rate for number in range(int(seconds * rate))]


def _begin() -> float:
    """Say that everything is connected; return the instant to begin at, once it has come."""
    print("connected", flush=True)
    at = float(sys.stdin.readline())
    _until(at)
    return at


def _until(instant: float) -> None:
    left = instant - monotonic()
    if left > 0:
        sleep(left)


def _us(since: float) -> int:
    return int((monotonic() - since) * 1e6)


def _why(body: bytes) -> str:
    told = said(body)
    steps = told.get("steps") or [told]
    execution = steps[-1].get("execution") or {}
    return str(execution.get("reasons") or steps[-1].get("reasons") or told.get("code"))


WORK = {"benign": benign, "flood": flood, "stops": stops, "closed": closed}


def main(arguments: list[str]) -> int:
    """Do one kind of work and say what became of it."""
    kind, path, name, rate, seconds = arguments
    print(json.dumps(WORK[kind](Path(path), name, float(rate), float(seconds), _begin)))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
