# SPDX-License-Identifier: Apache-2.0
"""A gate that does what a test says, with a real key or a false one, on a real socket.

Run as a program it drives a robot along and renews for ever, until somebody kills it.
"""

from __future__ import annotations

import socket
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from authguard_r.core.action import Action
from authguard_r.core.encoding import Tag
from authguard_r.core.identifiers import Digest
from authguard_r.core.principals import Signer
from authguard_r.core.state import Snapshot
from authguard_r.core.token import sign_object
from authguard_r.keys.signer import read_signer
from authguard_r.wire.frames import Frame, FrameReader, frame, read_body
from authguard_r.wire.messages import (
    PROTOCOL,
    Begun,
    Dispatch,
    Ended,
    Halt,
    Hello,
    Kind,
    Mode,
    Proof,
    Renew,
    Stood,
    Welcome,
)

#: Nothing here may take longer, in seconds; a bound against hanging.
PATIENCE = 30.0
RENEW_S = 0.05


def ticket(number: int = 1) -> Digest:
    return Digest(f"{number:043}")


def navigate(*, speed: int = 1_000) -> Action:
    return Action(
        type="navigate",
        tool="base",
        source="dock",
        destination="pharmacy",
        params={"speed_mm_s": speed},
    )


class Peer:
    """One accepted connection."""

    def __init__(self, link: socket.socket) -> None:
        self.link = link
        self.reader = FrameReader(lambda _: 1 << 22)
        self.frames: list[Frame] = []
        self.is_over = False
        self.life = 0
        self.renewed = 0.0

    def send(self, kind: Kind, message: object, number: int = 0) -> None:
        try:
            self.link.sendall(frame(kind, number, message))
        except OSError:
            self.is_over = True

    def poll(self, seconds: float = 0.01) -> None:
        """Take in what comes within so long."""
        self.link.settimeout(seconds)
        try:
            data = self.link.recv(1 << 16)
        except TimeoutError:
            return
        except OSError:
            data = b""
        self.is_over = self.is_over or not data
        came = self.reader.feed(data)
        for item in came:
            if item.kind is Kind.STOOD:
                self.life = read_body(item.body, Stood).life
        self.frames += came

    def until(self, done: Callable[[], Any], *, renewing: int | None = None) -> Any:
        """Take in what comes, and renew, until something holds; return what it is."""
        begun = time.monotonic()
        while not (found := done()):
            assert time.monotonic() - begun < PATIENCE, [item.kind for item in self.frames]
            if renewing is not None and time.monotonic() - self.renewed > RENEW_S:
                self.renewed = time.monotonic()
                self.send(Kind.RENEW, Renew(ticket=ticket(renewing)))
            self.poll()
        return found

    def next(self, kind: Kind, *, renewing: int | None = None) -> Frame:
        """Return the next frame of a kind; what came before it is dropped."""
        is_there = [False]

        def there() -> Frame | None:
            assert not self.is_over or any(f.kind is kind for f in self.frames), "it hung up"
            for at, item in enumerate(self.frames):
                if item.kind is kind:
                    del self.frames[: at + 1]
                    is_there[0] = True
                    return item
            return None

        found = self.until(there, renewing=renewing)
        assert is_there[0]
        return found  # type: ignore[no-any-return]

    def ended(self, *, renewing: int | None = None) -> Ended:
        return read_body(self.next(Kind.ENDED, renewing=renewing).body, Ended)

    def stood(self, *, renewing: int | None = None) -> int:
        return read_body(self.next(Kind.STOOD, renewing=renewing).body, Stood).stops

    def begun(self) -> Begun:
        return read_body(self.next(Kind.BEGUN).body, Begun)

    def dispatch(self, number: int = 1, **changes: Any) -> None:
        """Send an action to be begun, once the controller has said which start of it this is."""
        life = changes.pop("life", None) or self.until(lambda: self.life)
        order: dict[str, Any] = {
            "ticket": ticket(number),
            "action": navigate(),
            "max_ms": 600_000,
            "renew_within_ms": 5_000,
            "life": life,
            "stops": 0,
        }
        self.send(Kind.DISPATCH, Dispatch(**{**order, **changes}))

    def halt(self, number: int = 7) -> None:
        self.send(Kind.HALT, Halt(), number)

    def close(self) -> None:
        self.link.close()


#: What a server answers to a hello; None: nothing.
Answer = Callable[[Hello], Welcome | None]


def proved(signer: Signer, robot: str, **changes: Any) -> Answer:
    """Return the answer of a server that holds a key, with something changed."""

    def answer(hello: Hello) -> Welcome:
        said = {"robot": robot, "role": hello.role, "nonce": hello.nonce, **changes}
        token = sign_object(Proof(**said), Tag.HANDSHAKE, signer).decode()
        return welcome(hello, robot, token)

    return answer


def welcome(hello: Hello, robot: str, proof: str | None) -> Welcome:
    return Welcome(
        protocol=PROTOCOL,
        robot=robot,
        mode=Mode.ENFORCE,
        role=hello.role,
        client=hello.client,
        proof=proof,
    )


class ScriptedGate:
    """A server on a socket; every client is answered the same way."""

    def __init__(self, path: Path, answer: Answer) -> None:
        self.answer = answer
        self.peers: list[Peer] = []
        self.listening = socket.socket(socket.AF_UNIX)
        self.listening.bind(str(path))
        self.listening.listen(8)
        self.listening.settimeout(PATIENCE)

    def accept(self) -> Peer:
        """Return the next client, once it was answered."""
        link, _ = self.listening.accept()
        peer = Peer(link)
        self.peers.append(peer)
        hello = read_body(peer.next(Kind.HELLO).body, Hello)
        answered = self.answer(hello)
        if answered is not None:
            peer.send(Kind.WELCOME, answered)
        return peer

    def close(self) -> None:
        self.listening.close()
        for peer in self.peers:
            peer.close()


@contextmanager
def gate_at(path: Path, answer: Answer) -> Iterator[ScriptedGate]:
    """Serve on a path, in place of whoever did before."""
    path.unlink(missing_ok=True)
    gate = ScriptedGate(path, answer)
    try:
        yield gate
    finally:
        gate.close()


class Sensors:
    """Who listens to the robot's sensors."""

    def __init__(self, path: Path) -> None:
        begun = time.monotonic()
        while True:
            self.link = socket.socket(socket.AF_UNIX)
            try:
                self.link.connect(str(path))
                break
            except OSError:
                self.link.close()
                assert time.monotonic() - begun < PATIENCE
                time.sleep(0.02)
        self.link.settimeout(PATIENCE)
        self.reader = FrameReader(lambda _: 1 << 20)

    def next(self) -> Snapshot:
        """Return the newest of what has come, at least one."""
        frames: list[Frame] = []
        while not frames:
            data = self.link.recv(1 << 16)
            assert data, "the sensors are gone"
            frames = self.reader.feed(data)
        return read_body(frames[-1].body, Snapshot)

    def until(self, holds: Callable[[Snapshot], bool]) -> Snapshot:
        """Return the first snapshot of which something holds."""
        begun = time.monotonic()
        while not holds(seen := self.next()):
            assert time.monotonic() - begun < PATIENCE, seen
        return seen

    def close(self) -> None:
        self.link.close()


def main(path: str, key: str, cert: str, renew_within_ms: str) -> None:
    """Drive the robot and renew for ever."""
    signer = read_signer(Path(key), Path(cert))
    with gate_at(Path(path), proved(signer, "courier-1")) as gate:
        peer = gate.accept()
        peer.dispatch(renew_within_ms=int(renew_within_ms))
        peer.begun()
        peer.until(lambda: False, renewing=1)


if __name__ == "__main__":
    PATIENCE = 600.0
    main(*sys.argv[1:])
