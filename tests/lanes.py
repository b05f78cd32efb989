# SPDX-License-Identifier: Apache-2.0
"""A stop lane to test: its configuration, its keys, and raw clients that speak its protocol.

Nothing here is a mock: the clients are sockets, and the controller answers as a real one does.
"""

from __future__ import annotations

import json
import os
import selectors
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import msgspec

import worlds
from authguard_r.assembly import folder_signer
from authguard_r.core.encoding import Tag
from authguard_r.core.token import sign_object
from authguard_r.gate.config import GateConfig, Peer, default_config
from authguard_r.gate.lane.link import start_lane
from authguard_r.gate.lane.place import SOCKET
from authguard_r.gate.lane.run import LaneFiles
from authguard_r.wire.frames import Frame, FrameReader, frame
from authguard_r.wire.messages import PROTOCOL, ClientRole, Kind, Mode, Stood, Stop

#: Bound against hanging; nothing is measured against it.
SOON_S = 20.0
EVERY = tuple(sorted(role for role in ClientRole if role is not ClientRole.GATE))
NONCE = "A" * 22


def config(*peers: Peer, **changes: Any) -> GateConfig:
    """Return a configuration; by default this user may be everything."""
    named = peers or (Peer(uid=os.geteuid(), roles=EVERY),)
    return msgspec.structs.replace(default_config(worlds.RID, named, Mode.ENFORCE), **changes)


def files(made: GateConfig | None = None) -> LaneFiles:
    """Return what a lane is started with, in a new run folder."""
    run = Path(mkdtemp(prefix="lane-", dir="/tmp"))
    path = run / "gate.token"
    signer = folder_signer(worlds.trust_folder(), "site-authority-1")
    path.write_bytes(sign_object(made or config(), Tag.GATE, signer))
    keys = worlds.trust_folder() / "keys"
    return LaneFiles(
        run=run,
        robot=worlds.RID,
        trust=worlds.trust_folder(),
        key=keys / f"gate-{worlds.RID}.key.pem",
        cert=keys / f"gate-{worlds.RID}.cert.pem",
        config=path,
    )


def until(true: Callable[[], Any], what: str = "it") -> Any:
    """Return the first true answer; fail when none comes."""
    end = time.monotonic() + SOON_S
    while time.monotonic() < end:
        answer = true()
        if answer:
            return answer
        time.sleep(0.005)
    raise AssertionError(f"{what} did not happen")


class Client:
    """A connection to the lane that says exactly what the test wants."""

    def __init__(self, run: Path) -> None:
        self.line = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.line.settimeout(SOON_S)
        self.line.connect(str(run / SOCKET))
        self._reader = FrameReader(lambda kind: 1 << 20)
        self._frames: list[Frame] = []

    def __del__(self) -> None:
        self.line.close()

    def say(self, kind: Kind, body: object, number: int = 0) -> None:
        self.line.sendall(frame(kind, number, body))

    def hello(self, role: ClientRole, client: str | None = None, nonce: str | None = None) -> Any:
        said = {"protocol": PROTOCOL, "role": role, "client": client or str(role)}
        self.say(Kind.HELLO, {**said, "nonce": nonce} if nonce else said)
        return self.told(Kind.WELCOME)

    def stop(self, why: str = "", number: int = 1) -> dict[str, Any]:
        self.say(Kind.STOP, Stop(why=why), number)
        return self.told(Kind.REPLY)  # type: ignore[no-any-return]

    def next(self) -> Frame | None:
        """Return the next frame, None when the lane has closed the connection."""
        while not self._frames:
            try:
                data = self.line.recv(1 << 16)
            except ConnectionResetError:
                return None
            if not data:
                return None
            self._frames += self._reader.feed(data)
        return self._frames.pop(0)

    def told(self, kind: Kind) -> Any:
        got = self.next()
        assert got is not None, "the lane closed the connection"
        assert got.kind is kind, (got.kind, got.body)
        return json.loads(got.body)

    def dropped(self) -> dict[str, Any]:
        """Return why the lane ended this connection."""
        fault: dict[str, Any] = {}
        while (got := self.next()) is not None:
            if got.kind is Kind.ERROR:
                fault = json.loads(got.body)
        return fault

    def close(self) -> None:
        self.line.close()


class Robot(Client):
    """A controller that is told to stand; it answers when the test lets it."""

    def __init__(self, run: Path) -> None:
        super().__init__(run)
        self.welcome = self.hello(ClientRole.CONTROLLER, "robot", NONCE)
        self.stops = 0

    def halted(self) -> int:
        """Return the number of the next `HALT`."""
        got = self.next()
        assert got is not None
        assert (got.kind, got.body) == (Kind.HALT, b"{}")
        return got.id

    def stand(self, number: int) -> None:
        self.stops += 1
        self.say(Kind.STOOD, Stood(stops=self.stops), number)

    def obey(self) -> None:
        """Stand whenever told to, until the lane lets go of it."""
        while (got := self.next()) is not None:
            self.stand(got.id)


@contextmanager
def obedient_robot(run: Path) -> Iterator[Robot]:
    """A controller in a thread that stands at once."""
    robot = Robot(run)
    thread = threading.Thread(target=robot.obey)
    thread.start()
    try:
        yield robot
    finally:
        robot.line.shutdown(socket.SHUT_RDWR)
        thread.join(SOON_S)


def stops(client: Client, why: str = "") -> dict[str, Any]:
    """Ask for stops until one is confirmed in time, on a machine that does other things too."""
    return until(lambda: (told := client.stop(why))["stopped"] and told)  # type: ignore[no-any-return]


@contextmanager
def process(started: LaneFiles) -> Iterator[subprocess.Popen[bytes]]:
    """A lane in a process of its own, killed at the end."""
    words = [sys.executable, "-c", "from authguard_r.cli import main; main()", "stop-lane"]
    for name in ("run", "robot", "trust", "key", "cert", "config"):
        words += [f"--{name}", str(getattr(started, name))]
    child = subprocess.Popen([*words, "--json"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    assert child.stdout is not None
    try:
        ready = json.loads(child.stdout.readline())
        assert ready.get("ready") is True, ready
        yield child
    finally:
        child.kill()
        child.wait()
        child.stdout.close()


def obey(run: Path) -> None:
    """Stand whenever told to, for ever."""
    robot = Robot(run)
    robot.line.settimeout(None)
    print("obeys", flush=True)
    robot.obey()


@contextmanager
def script(call: str) -> Iterator[subprocess.Popen[bytes]]:
    """One of this module's functions in a process of its own, killed at the end."""
    code = f"import lanes, pathlib; lanes.{call}"
    path = os.pathsep.join((str(worlds.ROOT / "tests"), os.environ.get("PYTHONPATH", "")))
    child = subprocess.Popen(
        [sys.executable, "-c", code],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": path},
    )
    assert child.stdout is not None
    assert child.stderr is not None
    try:
        yield child
    finally:
        child.kill()
        child.wait()
        child.stdout.close()
        child.stderr.close()


@contextmanager
def standing_robot(run: Path) -> Iterator[int]:
    """A controller in a process of its own that stands at once; yields its number."""
    with script(f"obey(pathlib.Path({str(run)!r}))") as child:
        assert child.stdout is not None
        assert child.stdout.readline() == b"obeys\n"
        yield child.pid


def flood(run: Path, name: str, count: int) -> None:
    """Ask for stops as fast as it goes, many at once, and burn the processor in between."""
    client = Client(run)
    client.hello(ClientRole.PLANNER, name)
    print("floods", flush=True)
    for first in range(0, count, 50):
        asked = range(first, first + 50)
        client.line.sendall(b"".join(frame(Kind.STOP, n, Stop(why=str(n))) for n in asked))
        answered = [client.next() for _ in asked]
        assert [item.id for item in answered if item is not None] == list(asked)
        sum(range(100_000))
    print("done", flush=True)


def start_and_wait(encoded: str) -> None:
    """Do what a gate does when it starts, then nothing until somebody kills it."""
    plain = json.loads(encoded)
    started = start_lane(LaneFiles(robot=plain.pop("robot"), **{k: Path(plain[k]) for k in plain}))
    print(started.pid if started is not None else 0, flush=True)
    time.sleep(3_600)


def many(run: Path, count: int) -> list[socket.socket]:
    """Return that many connections that say nothing."""
    lines: list[socket.socket] = []
    for _ in range(count):
        line = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        line.settimeout(SOON_S)
        line.connect(str(run / SOCKET))
        lines.append(line)
    return lines


def open_of(lines: list[socket.socket]) -> int:
    """Return how many of them the lane has not closed."""
    with selectors.DefaultSelector() as selector:
        for line in lines:
            selector.register(line, selectors.EVENT_READ)
        return len(lines) - len(selector.select(0))
