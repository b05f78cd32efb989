# SPDX-License-Identifier: Apache-2.0
"""Functions as a tools' server: what is called off, what is kept, what never began.

Source: docs/spec/adapters.md#functions
"""

from __future__ import annotations

import asyncio
import contextvars
import inspect
import threading
from collections.abc import Callable
from typing import Any

import pytest

from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import Digest
from authguard_r.integrations.functions import functions as module
from authguard_r.integrations.functions.functions import Functions, FunctionTool, WaitingCaller
from authguard_r.integrations.tools.server import CallError
from fixtures import scenarios


def with_tool(function: Any, *, is_async: bool = False, changed: Any = None) -> Functions:
    made = Functions(changed or (lambda: None))
    made.tools = {
        "scan": FunctionTool(
            name="scan",
            function=None if is_async else function,
            coroutine=function if is_async else None,
            signature=inspect.signature(function),
        )
    }
    return made


def waiting(loop: asyncio.AbstractEventLoop, **beside: Any) -> WaitingCaller:
    """Return a caller whose proposal was released."""
    caller = WaitingCaller(tool="scan", beside=beside, context=contextvars.Context(), loop=loop)
    caller.told({"ticket": scenarios.TICKET})
    caller.told({})  # the first word counts
    return caller


def test_a_release_is_a_callers_by_its_ticket_and_by_nothing_else() -> None:
    async def scan(mine: object = None) -> object:
        return mine

    async def talk() -> None:
        made = with_tool(scan, is_async=True)
        mine, here = object(), asyncio.get_running_loop()
        made.caller = waiting(here, mine=mine)
        for ticket, value in ((Digest("s" * 43), None), (None, None), (scenarios.TICKET, mine)):
            answer = await made.call("scan", {}, 10.0, ticket=ticket)
            assert answer.told is not None
            assert made.take(answer.told.content).value is value
        made.caller = WaitingCaller(
            tool="scan", beside={}, context=contextvars.Context(), loop=here
        )
        with pytest.raises(CallError, match="in time"):  # nobody has said whose it is
            await made.call("scan", {}, 0.01, ticket=scenarios.TICKET)
        made.close()

    asyncio.run(talk())


def test_what_does_not_end_in_time_is_told_so_and_nothing_begins_until_it_has() -> None:
    go = threading.Event()

    async def talk() -> None:
        came_back = asyncio.Event()
        made = with_tool(go.wait, changed=came_back.set)
        with pytest.raises(CallError, match="in time") as told:
            await made.call("scan", {}, 0.01)
        assert told.value.sent
        assert not made.ready
        go.set()
        async with asyncio.timeout(20):
            await came_back.wait()
        assert made.ready

    asyncio.run(talk())


def test_what_nobody_fetches_is_not_kept_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_KEPT", 2)

    async def talk() -> None:
        made = with_tool(object)
        answers = [await made.call("scan", {}, 10.0) for _ in range(3)]
        first, second, third = (a.told.content for a in answers if a.told is not None)
        assert made.take(third).value is not made.take(second).value
        for content in (first, third, b"{", b"[]", b"5", b'{"number": []}'):
            with pytest.raises(MalformedError, match="of this process"):
                made.take(content)

    asyncio.run(talk())


def test_a_function_that_takes_other_arguments_or_is_none_was_not_called() -> None:
    async def talk() -> None:
        made = with_tool(lambda: None)
        for name, arguments in (("scan", {"far": True}), ("look", {})):
            with pytest.raises(CallError) as told:
                await made.call(name, arguments, 10.0)
            assert not told.value.sent

    asyncio.run(talk())


def test_a_coroutine_of_a_caller_whose_loop_is_closed_begins_nowhere() -> None:
    gone = asyncio.new_event_loop()
    gone.close()

    async def scan() -> None:
        raise AssertionError("it began")

    async def talk() -> None:
        made = with_tool(scan, is_async=True)
        made.caller = waiting(gone)
        with pytest.raises(CallError, match="closed") as told:
            await made.call("scan", {}, 10.0, ticket=scenarios.TICKET)
        assert not told.value.sent

    asyncio.run(talk())


def test_a_coroutine_that_raises_has_failed_and_one_still_awaited_is_canceled_at_the_end() -> None:
    ends: list[str] = []
    begun = threading.Event()

    async def fails() -> None:
        raise OSError("dark")

    async def hangs() -> None:
        begun.set()
        try:
            await asyncio.sleep(3_600)
        finally:
            ends.append("canceled")

    async def talk() -> None:
        made = with_tool(fails, is_async=True)
        answer = await made.call("scan", {}, 10.0)
        assert answer.is_error
        assert answer.told is not None
        assert answer.told.texts == ("OSError: dark",)
        made.tools = with_tool(hangs, is_async=True).tools
        going = asyncio.create_task(made.call("scan", {}, 3_600.0))
        await asyncio.to_thread(begun.wait)
        await asyncio.to_thread(made.close)
        await going
        made.close()

    asyncio.run(talk())
    assert ends == ["canceled"]


def test_a_caller_that_has_left_its_loop_cancels_nothing_in_it() -> None:
    """The loop is closed while its coroutine is called off: there is nothing left to cancel."""
    loop = asyncio.new_event_loop()
    stop: Callable[[], None] = loop.stop

    async def hangs() -> None:
        loop.call_soon(stop)
        await asyncio.sleep(3_600)

    async def talk() -> None:
        made = with_tool(hangs, is_async=True)
        made.caller = waiting(loop)
        thread = threading.Thread(target=loop.run_forever)
        thread.start()
        going = asyncio.create_task(made.call("scan", {}, 3_600.0, ticket=scenarios.TICKET))
        await asyncio.to_thread(thread.join)
        for task in asyncio.all_tasks(loop):
            task._log_destroy_pending = False  # type: ignore[attr-defined]
        loop.close()
        going.cancel()
        with pytest.raises(asyncio.CancelledError):
            await going
        assert not made.ready

    asyncio.run(talk())


def test_a_call_that_is_called_off_as_it_ends_is_not_waited_for() -> None:
    ended = threading.Event()

    class Late(Functions):
        """Tells of the end before its answer is there."""

        def _ended(self, run: Any) -> None:
            super()._ended(run)
            going[0].cancel()

    going: list[asyncio.Task[Any]] = []

    async def talk() -> None:
        made = Late(lambda: None)
        made.tools = with_tool(ended.wait).tools
        going.append(asyncio.create_task(made.call("scan", {}, 3_600.0, ticket=scenarios.TICKET)))
        await asyncio.sleep(0)
        ended.set()
        with pytest.raises(asyncio.CancelledError):
            await going[0]
        assert made.ready

    asyncio.run(talk())
