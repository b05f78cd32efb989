# SPDX-License-Identifier: Apache-2.0
"""A connection of the robot's own: made again for ever, and let go when its server reads nothing.

The server is scripted, on a real socket, with the gate's real key.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest

from authguard_r.client.driver import BOUNDS
from authguard_r.client.link import MAX_UNREAD, PersistentConnection, ProcessLog
from authguard_r.client.proof import Proven
from authguard_r.core.identifiers import Identifier
from authguard_r.keys.signer import folder_signer
from authguard_r.keys.trust import read_trust
from authguard_r.wire.frames import Frame
from authguard_r.wire.messages import ClientRole
from fixtures import scenarios
from integration.scripted_gate import gate_at, proved


class Heard:
    """What a connection brought."""

    def __init__(self) -> None:
        self.came: list[str] = []

    def opened(self, proven: Proven) -> None:
        self.came.append("opened")

    def heard(self, item: Frame) -> None:
        self.came.append("heard")

    def closed(self) -> None:
        self.came.append("closed")


def caller(path: Path, listener: Heard, trust: Path | None = None) -> PersistentConnection:
    return PersistentConnection(
        path,
        role=ClientRole.CONTROLLER,
        client=Identifier("controller-1"),
        robot=scenarios.RID,
        trust=lambda: read_trust(trust or scenarios.trust_folder()),
        bounds=BOUNDS,
        listener=listener,
        log=ProcessLog(),
    )


async def until(holds: Callable[[], object]) -> None:
    async with asyncio.timeout(30):
        while not holds():
            await asyncio.sleep(0.01)


async def ended(staying: asyncio.Task[None]) -> None:
    staying.cancel()
    with suppress(asyncio.CancelledError):
        await staying


def test_a_server_that_is_not_there_is_said_once_and_called_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said: list[str] = []

    async def talk() -> None:
        line = caller(tmp_path / "gate.sock", Heard())
        line.send(b"lost")  # nobody is there
        line.hang_up()
        staying = asyncio.ensure_future(line.stay())
        await until(lambda: said.append(capsys.readouterr().err) or any(said))
        await asyncio.sleep(0.2)  # some tries more
        await ended(staying)

    asyncio.run(talk())
    said.append(capsys.readouterr().err)
    (told,) = [json.loads(text) for text in "".join(said).splitlines()]
    assert (told["event"], told["channel"]) == ("unreachable", "gate.sock")


def test_without_a_trust_root_nobody_is_called(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said: list[str] = []

    async def talk() -> None:
        line = caller(tmp_path / "gate.sock", Heard(), trust=tmp_path / "none")
        staying = asyncio.ensure_future(line.stay())
        await until(lambda: said.append(capsys.readouterr().err) or any(said))
        await ended(staying)

    asyncio.run(talk())
    assert json.loads("".join(said).splitlines()[0])["event"] == "refused"


def test_a_server_that_reads_nothing_is_let_go(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, heard = tmp_path / "gate.sock", Heard()
    signer = folder_signer(scenarios.trust_folder(), f"gate-{scenarios.RID}")

    async def talk() -> None:
        with gate_at(path, proved(signer, scenarios.RID)) as gate:
            line = caller(path, heard)
            staying = asyncio.ensure_future(line.stay())
            await asyncio.to_thread(gate.accept)
            await until(lambda: heard.came == ["opened"])
            line.send(b"x" * (MAX_UNREAD + (1 << 20)))
            assert heard.came == ["opened", "closed"]
            line.send(b"x")  # gone is gone
            await ended(staying)

    asyncio.run(talk())
    events = [json.loads(text)["event"] for text in capsys.readouterr().err.splitlines()]
    assert events[:3] == ["connected", "unread", "disconnected"]
