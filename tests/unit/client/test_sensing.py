# SPDX-License-Identifier: Apache-2.0
"""An estimator's connection to a robot's sensors is made again for ever; what is wrong ends it."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from pathlib import Path
from tempfile import mkdtemp

import pytest

from authguard_r.client.attesting import Measurement
from authguard_r.client.link import ProcessLog
from authguard_r.client.sensing import SENSORS, listen, read_raw
from authguard_r.sim.sensors import reading_frame
from authguard_r.sim.sight import snapshot_of
from fixtures import scenarios

PATIENCE_S = 20.0


def raw(rid: str = scenarios.RID) -> bytes:
    return reading_frame(snapshot_of(scenarios.world(), robot=rid, epoch=0, seq=0), 1_000)


async def until(holds: Callable[[], object]) -> None:
    async with asyncio.timeout(PATIENCE_S):
        while not holds():
            await asyncio.sleep(0.01)


async def told(run: Path, said: list[bytes]) -> list[Measurement]:
    """Serve one thing to each connection, the last again and again; return what was taken."""
    found: list[Measurement] = []
    listening = asyncio.ensure_future(
        listen(
            run, lambda item, now: found.append(read_raw(item, now, scenarios.RID)), ProcessLog()
        )
    )
    await asyncio.sleep(0)  # nobody is there yet
    open_ones: list[asyncio.StreamWriter] = []

    async def serve(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        open_ones.append(writer)
        writer.write(said.pop(0) if len(said) > 1 else said[0])
        if len(open_ones) == 1:
            writer.close()

    server = await asyncio.start_unix_server(serve, run / SENSORS)
    try:
        await until(lambda: found)
    finally:
        listening.cancel()
        await asyncio.gather(listening, return_exceptions=True)
        for writer in open_ones:
            writer.close()
        server.close()
    return found


def test_what_is_wrong_ends_a_connection_and_the_next_is_made(
    capsys: pytest.CaptureFixture[str],
) -> None:
    run = Path(mkdtemp(prefix="ag-", dir="/tmp"))
    said = [b"", b"\xff" * 64, raw(scenarios.OTHER), raw()]
    found = asyncio.run(told(run, said))
    assert [one.snapshot.robot for one in found] == [scenarios.RID]
    lines = [json.loads(line) for line in capsys.readouterr().err.splitlines()]
    events = [line["event"] for line in lines]
    assert events[0] == "unreachable"
    assert events.count("refused") == 2
    assert "disconnected" in events
