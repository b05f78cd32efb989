# SPDX-License-Identifier: Apache-2.0
"""A call that is released before its work is begun: what is not begun is never done.

Source: lessons L1, L2; docs/spec/adapters.md#turns
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from authguard_r.integrations.functions import Failed, GateGuard, Refused, turns
from authguard_r.integrations.functions.turns import CallTurn, register
from fixtures.guarded_tools import SCOPE, SIGN, Courier, shared_courier
from fixtures.shared_gate import SharedGate

SCANNED = {"tool": "scan", "arguments": {}}


@pytest.fixture(scope="module")
def shared() -> Iterator[SharedGate]:
    with SharedGate() as made:
        yield made


@pytest.fixture
def robot(shared: SharedGate, tmp_path: Path) -> Iterator[Courier]:
    with shared_courier(shared, tmp_path) as made:
        yield made


@asynccontextmanager
async def guarded(robot: Courier) -> AsyncIterator[GateGuard]:
    async def work(name: str, arguments: dict[str, Any]) -> str:
        return robot.made(name, **arguments)

    with await asyncio.to_thread(robot.connect) as guard:
        register(guard, "scan", lambda arguments: work("scan", arguments))
        register(guard, "navigate_to", lambda arguments: work("navigate_to", arguments))
        yield guard


def test_what_is_released_waits_until_it_is_begun_and_is_done_once(robot: Courier) -> None:
    async def ask() -> None:
        async with guarded(robot) as guard:
            arguments = {"destination": "Pharmacy", "speed": None, "via": None}
            turn = CallTurn(guard, "navigate_to", arguments, waits=True)
            released = await turn.released()
            # what the binding gives no value is null, as it was written
            assert released == {"destination": "Pharmacy", "speed": 0.5, "via": None}
            assert robot.calls() == []
            assert await turn.done() == SIGN
            assert await turn.done() == SIGN
            assert robot.calls() == [{"tool": "navigate_to", "arguments": released}]

    asyncio.run(ask())


@pytest.mark.parametrize("waits", [False, True])
def test_what_is_refused_never_begins(robot: Courier, *, waits: bool) -> None:
    async def ask() -> None:
        async with guarded(robot) as guard:
            turn = CallTurn(guard, "navigate_to", {"destination": "Isolation Room"}, waits=waits)
            with pytest.raises(Refused, match=SCOPE):
                await turn.released()
            with pytest.raises(Refused, match=SCOPE):
                await turn.done()
            assert await CallTurn(guard, "scan", {}, waits=False).done() == SIGN

    asyncio.run(ask())
    assert robot.calls() == [SCANNED]


@pytest.mark.parametrize("given_up", [False, True])
def test_what_does_not_begin_is_given_up_and_begins_no_more(
    robot: Courier, monkeypatch: pytest.MonkeyPatch, *, given_up: bool
) -> None:
    async def ask() -> None:
        async with guarded(robot) as guard:
            turn = CallTurn(guard, "scan", {}, waits=True)
            await turn.released()
            if given_up:
                turn.give_up()
            # the next one has its turn after this one's end
            assert await CallTurn(guard, "scan", {}, waits=False).done() == SIGN
            with pytest.raises(Failed, match="expected the approved call"):
                await turn.done()

    if not given_up:
        monkeypatch.setattr(turns, "BEGIN_S", 0.2)
    asyncio.run(ask())
    assert robot.calls() == [SCANNED]


def test_what_the_work_raises_is_raised_and_without_a_turn_nothing_is_done(
    robot: Courier,
) -> None:
    async def fail(_: dict[str, Any]) -> None:
        raise OSError("dark")

    async def ask() -> None:
        with await asyncio.to_thread(robot.connect) as guard:
            register(guard, "scan", fail)
            with pytest.raises(OSError, match="dark"):
                await CallTurn(guard, "scan", {}, waits=False).done()
            with pytest.raises(Failed, match="expected a call of the agent's"):
                await guard.acall("scan", {})

    asyncio.run(ask())


def test_a_turn_that_is_called_off_is_nobodys(robot: Courier) -> None:
    async def ask() -> None:
        async with guarded(robot) as guard:
            turn = CallTurn(guard, "scan", {}, waits=True)
            await turn.released()
            waiting = asyncio.create_task(turn.done())
            waiting.cancel()
            with pytest.raises(asyncio.CancelledError):
                await waiting

    asyncio.run(ask())
