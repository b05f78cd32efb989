# SPDX-License-Identifier: Apache-2.0
"""Who may ask the gate: nobody before the last answer is there, wanted or not.

Source: docs/spec/mcp.md#front
"""

from __future__ import annotations

import asyncio

import pytest

from authguard_r.integrations.tools.planner import PlannerTurn


def test_a_call_that_was_canceled_keeps_its_turn_until_the_gate_has_answered() -> None:
    async def run() -> None:
        turn, answered, order = PlannerTurn(), asyncio.Event(), list[str]()

        async def gate() -> None:
            await answered.wait()
            order.append("answer")

        async def ask() -> None:
            async with turn:
                await turn.kept(gate())

        async def follow() -> None:
            async with turn:
                order.append("next")

        first = asyncio.ensure_future(ask())
        await asyncio.sleep(0)
        first.cancel()
        with pytest.raises(asyncio.CancelledError):
            await first
        assert turn.locked()
        following = asyncio.ensure_future(follow())
        gives_up = asyncio.ensure_future(follow())
        await asyncio.sleep(0)
        gives_up.cancel()
        following.cancel()  # in the middle of waiting for that answer
        await asyncio.gather(following, gives_up, return_exceptions=True)
        following = asyncio.ensure_future(follow())
        answered.set()
        async with asyncio.timeout(5):
            await following
        assert order == ["answer", "next"]
        assert not turn.locked()

    asyncio.run(run())


def test_what_fails_when_nobody_waits_is_nobodys_error() -> None:
    async def run() -> None:
        turn, failing = PlannerTurn(), asyncio.Event()
        loop, said = asyncio.get_running_loop(), list[object]()
        loop.set_exception_handler(lambda _, context: said.append(context))

        async def gate() -> None:
            await failing.wait()
            raise ZeroDivisionError

        waiting = asyncio.ensure_future(turn.kept(gate()))
        await asyncio.sleep(0)
        waiting.cancel()
        await asyncio.gather(waiting, return_exceptions=True)
        failing.set()
        async with asyncio.timeout(5), turn:
            pass
        assert said == []

    asyncio.run(run())
