# SPDX-License-Identifier: Apache-2.0
"""A tools' server's process ends with whoever started it, whenever that is told to end.

Source: docs/spec/mcp.md#upstream
"""

from __future__ import annotations

import asyncio
import gc
import os
import sys
from collections.abc import Coroutine, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from authguard_r.client.link import ProcessLog
from authguard_r.integrations.mcp.upstream import Upstream, ended_with_care, listed
from fixtures import scenarios

ODD = (
    sys.executable,
    str(scenarios.ROOT / "tests" / "programs" / "misbehaving_mcp_server.py"),
    "no-ping",
)
#: It never answers.
DEAF = (sys.executable, "-c", "import time; time.sleep(3600)")


@pytest.fixture(autouse=True)
def _only_what_is_new_is_collected() -> Iterator[None]:
    """Keep the collector from what thousands of tests before left in memory."""
    gc.freeze()
    yield
    gc.unfreeze()


def children() -> set[int]:
    """Return the processes that this one has."""
    found = set()
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            parent = stat.read_text().rpartition(")")[2].split()[1]
            if int(parent) == os.getpid():
                found.add(int(stat.parent.name))
    return found


def staying(server: tuple[str, ...]) -> Coroutine[Any, Any, None]:
    kept = Upstream(server, pins=None, environment={}, log=ProcessLog(), changed=lambda: None)
    return kept.stay()


@pytest.mark.complete
@pytest.mark.parametrize("server", [ODD, DEAF], ids=["odd", "deaf"])
@pytest.mark.parametrize("times", [1, 4])
@pytest.mark.parametrize("after_s", [0.0, 0.003, 0.02, 0.1, 0.4, 1.2])
def test_a_connection_that_is_called_off_leaves_no_process(
    after_s: float, times: int, server: tuple[str, ...]
) -> None:
    before = children()

    async def talk() -> None:
        going = asyncio.ensure_future(staying(server))
        await asyncio.sleep(after_s)
        for number in range(times):  # as a group does that ends while it is canceled
            going.cancel()
            await asyncio.sleep(number * 0.02)
        with pytest.raises(asyncio.CancelledError):
            await going

    asyncio.run(talk())
    gc.collect()  # what was not closed would say so
    assert children() == before


def test_a_server_that_hears_nothing_is_ended_too() -> None:
    before = children()

    async def talk() -> None:
        for work in (staying(DEAF), listed(DEAF, {})):
            with pytest.raises(TimeoutError):
                async with asyncio.timeout(0.3):
                    await work

    asyncio.run(talk())
    gc.collect()
    assert children() == before


def test_what_goes_wrong_while_it_is_held_is_told() -> None:
    async def fails(_: asyncio.Lock) -> None:
        raise RuntimeError("dark")

    async def returns(_: asyncio.Lock) -> int:
        return 5

    with pytest.raises(RuntimeError, match="dark"):
        asyncio.run(ended_with_care(fails))
    assert asyncio.run(ended_with_care(returns)) == 5
