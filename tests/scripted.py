# SPDX-License-Identifier: Apache-2.0
"""A peer on a real Unix socket that says what a test tells it to, in the protocol's own frames.

It is no gate and no stand-in for one: it is whatever might listen there, honest or not.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import worlds
from authguard_r.assembly import folder_signer, gate_name
from authguard_r.core.encoding import Tag, b64
from authguard_r.core.token import sign_object
from authguard_r.wire.frames import Frame, FrameReader, frame, read_body
from authguard_r.wire.messages import BODY, PROTOCOL, Hello, Kind, Mode, Proof, Welcome

SITE = b64(bytes(32))


class Peer:
    """One accepted connection, from the listening side."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer
        self._cut = FrameReader(lambda _: 1 << 23)
        self._frames: list[Frame] = []

    async def frame(self) -> Frame:
        """Return the next frame of the client; EOFError when it hung up."""
        while not self._frames:
            data = await self.reader.read(1 << 16)
            if not data:
                raise EOFError
            self._frames += self._cut.feed(data)
        return self._frames.pop(0)

    async def request(self) -> tuple[int, Any]:
        """Return the next request's number and its message."""
        item = await self.frame()
        return item.id, read_body(item.body, BODY[item.kind])

    async def gone(self) -> None:
        """Return when the client has hung up."""
        try:
            while True:
                await self.frame()
        except (EOFError, ConnectionError):
            return

    def raw(self, data: bytes) -> None:
        """Send bytes as they are."""
        self.writer.write(data)

    def send(self, kind: Kind, number: int, body: object) -> None:
        """Send one frame."""
        self.raw(frame(kind, number, body))

    def reply(self, number: int, **said: Any) -> None:
        """Answer a request."""
        self.send(Kind.REPLY, number, said)

    def event(self, number: int, **said: Any) -> None:
        """Send an event of a request."""
        self.send(Kind.EVENT, number, said)

    def fault(self, number: int, code: str, **more: Any) -> None:
        """Refuse a request, or with 0 the connection."""
        said = {"code": code, "message": "expected less", "where": "here", **more}
        self.send(Kind.ERROR, number, said)

    async def welcome(self, *, signer: str | None = None, **changes: Any) -> Hello:
        """Take the hello and welcome the client; a change makes the welcome dishonest."""
        _, hello = await self.request()
        self.send(Kind.WELCOME, 0, welcome_of(hello, signer=signer, **changes))
        return hello


def welcome_of(hello: Hello, *, signer: str | None = None, **changes: Any) -> Welcome:
    """Return the welcome of a hello, with fields (`proof_...`: of the proof) replaced."""
    proof = {"robot": worlds.RID, "role": hello.role, "nonce": hello.nonce or ""}
    proof |= {name[6:]: changes.pop(name) for name in list(changes) if name.startswith("proof_")}
    said = {
        "protocol": PROTOCOL,
        "robot": worlds.RID,
        "mode": Mode.ENFORCE,
        "role": hello.role,
        "client": hello.client,
        "site": SITE,
    }
    if hello.nonce is not None:
        key = folder_signer(worlds.trust_folder(), signer or gate_name(worlds.RID))
        said["proof"] = sign_object(Proof(**proof), Tag.HANDSHAKE, key).decode()
    return Welcome(**(said | changes))


Talk = Callable[[Peer], Awaitable[None]]


@contextmanager
def listening(talk: Talk, name: str = "gate.sock") -> Iterator[Path]:
    """Serve one script for every connection, on a loop of its own; its own faults are raised."""
    with TemporaryDirectory(prefix="ag-") as folder:
        path = Path(folder) / name
        service = _Service(path, talk)
        try:
            yield path
        finally:
            service.end()
    assert service.faults == []


class _Service:
    def __init__(self, path: Path, talk: Talk) -> None:
        self.faults: list[BaseException] = []
        self._talk = talk
        self._up = threading.Event()
        self._loop = asyncio.new_event_loop()
        self._tasks: set[asyncio.Task[None]] = set()
        self._thread = threading.Thread(target=self._run, args=(path,))
        self._thread.start()
        assert self._up.wait(30)

    def end(self) -> None:
        self._loop.call_soon_threadsafe(self._done.set)
        self._thread.join(30)
        assert not self._thread.is_alive()

    def _run(self, path: Path) -> None:
        with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
            runner.run(self._serve(path))

    async def _serve(self, path: Path) -> None:
        self._done = asyncio.Event()
        server = await asyncio.start_unix_server(self._accept, path)
        self._up.set()
        await self._done.wait()
        server.close()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await server.wait_closed()

    async def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._tasks.add(task)
        try:
            await self._talk(Peer(reader, writer))
        except asyncio.CancelledError:
            pass
        except (EOFError, ConnectionError):
            pass  # the client hung up: a script need not expect it
        except BaseException as error:  # noqa: BLE001 - raised in the test, by `listening`
            self.faults.append(error)
        finally:
            self._tasks.discard(task)
            writer.transport.abort()
