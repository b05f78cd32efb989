# SPDX-License-Identifier: Apache-2.0
"""Sessions take turns, and a turn is neither lost nor given twice.

Source: docs/spec/mcp.md#front
"""

from __future__ import annotations

import asyncio
from contextlib import suppress

from authguard_r.integrations.mcp.turns import Turns


async def asks(turns: Turns, session: str | None, name: str, had: list[str]) -> None:
    async with turns.turn(session):
        had.append(name)
        await asyncio.sleep(0.01)


def test_sessions_take_turns_however_many_calls_each_has_waiting() -> None:
    async def run() -> list[str]:
        turns, had = Turns(), list[str]()
        greedy = [asyncio.ensure_future(asks(turns, "a", f"a{n}", had)) for n in range(5)]
        await asyncio.sleep(0)
        modest = [asyncio.ensure_future(asks(turns, name, name, had)) for name in ("b", "c")]
        await asyncio.gather(*greedy, *modest)
        return had

    assert asyncio.run(run()) == ["a0", "a1", "b", "c", "a2", "a3", "a4"]


def test_who_gives_up_takes_no_turn_from_anybody() -> None:
    async def run() -> list[str]:
        turns, had = Turns(), list[str]()
        async with turns.turn("a"):
            waits = [asyncio.ensure_future(asks(turns, "b", f"b{n}", had)) for n in range(3)]
            await asyncio.sleep(0)
            waits[0].cancel()  # while it waits
        waits[1].cancel()  # it was given the turn, and has not run yet
        await asyncio.gather(*waits, return_exceptions=True)
        async with asyncio.timeout(5), turns.turn("c"):
            had.append("c")
        return had

    assert asyncio.run(run()) == ["b2", "c"]


def test_a_block_that_fails_gives_its_turn_back() -> None:
    async def run() -> None:
        turns = Turns()
        with suppress(ZeroDivisionError):
            async with turns.turn(None):
                _ = 1 // 0
        async with asyncio.timeout(5), turns.turn(None):
            pass

    asyncio.run(run())
