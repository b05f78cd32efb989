# SPDX-License-Identifier: Apache-2.0
"""Functions of this process as a tools' server (`tools.server.Server`).

What is called is what was rebuilt from a released action. What a function returned stays here,
under a number; the number and the words go through the gate. A function that runs cannot be
killed: one that was called off may still do things, and nothing else begins until it has ended.
Spec page: docs/spec/adapters.md#functions
"""

from __future__ import annotations

import asyncio
import contextvars
import inspect
import json
import secrets
import threading
from collections import OrderedDict
from collections.abc import Awaitable, Callable, Mapping
from concurrent.futures import Future, InvalidStateError
from contextlib import suppress
from typing import Any

from msgspec import Struct, field

from authguard_r.client.controller import ExecutionNews
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import Digest
from authguard_r.integrations.functions.values import (
    Fields,
    Words,
    fields_of,
    is_lazy,
    sendable,
    words_of,
)
from authguard_r.integrations.tools.server import WITHHELD, CallError, ToolAnswer, fits

#: Most returned values that wait for their callers.
MAX_KEPT = 64
#: Longest wait for functions that are awaited still when a guard is closed, in seconds.
CLOSE_S = 2.0


class FunctionTool(Struct, frozen=True, kw_only=True):
    """A function that is a tool.

    Args:
        name: its name in the binding.
        function: does its work when it is called; None: only the other does.
        coroutine: does its work when it is awaited; None: only the other does.
        signature: how either is called.
        words: every word of what it returns that a model could read.
        fields: what it returns as fields by name, for what the binding demands of an answer.
    """

    name: str
    function: Callable[..., Any] | None
    coroutine: Callable[..., Awaitable[Any]] | None
    signature: inspect.Signature
    words: Words = words_of
    fields: Fields = fields_of


class WaitingCaller(Struct, frozen=True, kw_only=True):
    """Who waits for a call in this process.

    Args:
        tool: what it asked for.
        beside: arguments that the program gives and no planner.
        context: its context variables.
        loop: its event loop; None: a thread that waits.
        ticket: of the release that came of it; None: nothing was released for it.
    """

    tool: str
    beside: Mapping[str, Any]
    context: contextvars.Context
    loop: asyncio.AbstractEventLoop | None = None
    ticket: Future[Digest | None] = field(default_factory=Future)

    def told(self, step: Mapping[str, Any]) -> None:
        """Take note of the first ticket that the gate reports."""
        if not self.ticket.done():
            self.ticket.set_result(step.get("ticket"))

    async def waits_for(self, ticket: Digest | None) -> bool:
        """True of the release that this caller's own proposal came to.

        The gate decides a proposal as it comes, or says why it does not: one of the two ends this.
        """
        if ticket is None:
            return False
        return await asyncio.shield(asyncio.wrap_future(self.ticket)) == ticket


class FunctionResult(Struct, frozen=True, kw_only=True):
    """What came of a function's call.

    Args:
        value: what it returned; an exception that it raised.
        text: why the value is not handed out; empty when it is.
    """

    value: Any
    text: str = ""


class CallRun:
    """One call while it is carried out."""

    def __init__(self) -> None:
        self.over = False


#: The call that the running code is part of.
INSIDE: contextvars.ContextVar[CallRun | None] = contextvars.ContextVar("authguard", default=None)


class Functions:
    """The functions that are registered, and what they returned.

    Args:
        changed: called when a function that was called off has ended.
    """

    def __init__(self, changed: Callable[[], None]) -> None:
        self.tools: dict[str, FunctionTool] = {}
        self.caller: WaitingCaller | None = None  # whose turn it is
        self._changed = changed
        self._kept: OrderedDict[str, FunctionResult] = OrderedDict()
        self._left: set[CallRun] = set()  # called off, and still running
        self._own = OwnLoop()

    @property
    def ready(self) -> bool:
        """True while no function runs on that was called off."""
        return not self._left

    async def call(
        self,
        tool: str,
        arguments: dict[str, Any],
        within_s: float,
        *,
        ticket: Digest | None = None,
    ) -> ToolAnswer:
        """Call a function for the caller whose release it is; another's release has no caller.

        Raises:
            CallError: there is none of the name, it cannot be called so, or it did not end.
        """
        found = self.tools.get(tool)
        if found is None:
            raise CallError(f"no function is registered for `{tool}`", sent=False)
        try:
            async with asyncio.timeout(within_s):
                caller = self.caller
                if caller is None or not await caller.waits_for(ticket):
                    caller = WaitingCaller(tool=tool, beside={}, context=contextvars.Context())
                kept = await self.carry(found, arguments, caller)
        except TimeoutError as error:
            raise CallError("it did not end in time", sent=True) from error
        return self._answer(found, kept)

    async def carry(
        self, tool: FunctionTool, arguments: dict[str, Any], caller: WaitingCaller
    ) -> FunctionResult:
        """Call a function and return what came of it.

        Args:
            tool: which.
            arguments: by name.
            caller: who waits.

        Raises:
            CallError: it cannot be called so; nothing was done.
        """
        given = called_with(tool, arguments, caller.beside)
        run, here = CallRun(), asyncio.get_running_loop()

        def ended() -> None:
            run.over = True
            with suppress(RuntimeError):  # the guard is closed
                here.call_soon_threadsafe(self._ended, run)

        caller.context.run(INSIDE.set, run)
        going = self._begun(tool, given, caller, ended)
        try:
            return await asyncio.wrap_future(going)
        except asyncio.CancelledError:
            if not run.over:
                self._left.add(run)
            raise

    def _begun(
        self,
        tool: FunctionTool,
        given: inspect.BoundArguments,
        caller: WaitingCaller,
        ended: Callable[[], None],
    ) -> Future[FunctionResult]:
        """Begin a call: awaited in the caller's own loop, or called in a thread of its own."""
        function, coroutine = tool.function, tool.coroutine
        if function is not None and (coroutine is None or caller.loop is None):
            return in_thread(function, given, caller.context, ended)
        if coroutine is None:  # pragma: no cover - one of them is there
            raise RuntimeError("expected a function")
        loop = caller.loop or self._own.running()
        try:
            return in_loop(loop, coroutine, given, caller.context, ended)
        except RuntimeError as error:
            raise CallError("the caller's event loop is closed", sent=False) from error

    def _ended(self, run: CallRun) -> None:
        if run in self._left:
            self._left.discard(run)
            self._changed()

    def _answer(self, tool: FunctionTool, kept: FunctionResult) -> ToolAnswer:
        number, fields = secrets.token_hex(16), None
        if not kept.text:
            try:
                texts, fields = sendable(tool.words(kept.value)), tool.fields(kept.value)
            except Exception as error:  # noqa: BLE001 - the value's own code
                kept = FunctionResult(value=error, text=named(error))
        if kept.text:
            texts = sendable((kept.text,))
        is_error = bool(kept.text)
        told = told_of(number, texts)
        if not fits(told):
            kept = FunctionResult(value=None, text=WITHHELD)
            told = told_of(number, (WITHHELD,))
        self._kept[number] = kept
        while len(self._kept) > MAX_KEPT:
            self._kept.popitem(last=False)
        return ToolAnswer(is_error=is_error, structured=fields, text="\n".join(texts), told=told)

    def take(self, content: bytes) -> FunctionResult:
        """Return what came of a call, once.

        Args:
            content: what the gate brought back of it.

        Raises:
            MalformedError: nothing is kept under it.
        """
        try:
            return self._kept.pop(json.loads(content)["number"])
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            raise MalformedError("expected an answer of this process", where="result") from error

    def close(self) -> None:
        """End the loop in which functions are awaited for callers that have none."""
        self._own.close()


class OwnLoop:
    """An event loop in a thread, for functions whose callers have none."""

    def __init__(self) -> None:
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread: threading.Thread | None = None

    def running(self) -> asyncio.AbstractEventLoop:
        """Return it, started."""
        if self._loop is None:
            self._loop = asyncio.new_event_loop()
            self._thread = threading.Thread(target=self._serve, args=(self._loop,), daemon=True)
            self._thread.start()
        return self._loop

    def close(self) -> None:
        """End it; what is still awaited there is canceled, what blocks it is left to itself."""
        loop, self._loop = self._loop, None
        if loop is not None and self._thread is not None:
            loop.call_soon_threadsafe(loop.stop)
            self._thread.join(CLOSE_S)

    def _serve(self, loop: asyncio.AbstractEventLoop) -> None:
        try:
            loop.run_forever()
            loop.run_until_complete(_canceled(asyncio.all_tasks(loop)))
        finally:
            loop.close()


async def _canceled(tasks: set[asyncio.Task[Any]]) -> None:
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


def called_with(
    tool: FunctionTool, arguments: dict[str, Any], beside: Mapping[str, Any]
) -> inspect.BoundArguments:
    """Return how a function is called; what was authorized comes before what is beside it.

    Raises:
        CallError: it takes other arguments.
    """
    try:
        both = {**beside, **arguments}
        first = [
            both.pop(name)
            for name, parameter in tool.signature.parameters.items()
            if parameter.kind is parameter.POSITIONAL_ONLY and name in both
        ]
        return tool.signature.bind(*first, **both)
    except TypeError as error:
        raise CallError(str(error), sent=False) from error


def in_thread(
    function: Callable[..., Any],
    given: inspect.BoundArguments,
    context: contextvars.Context,
    ended: Callable[[], None],
) -> Future[FunctionResult]:
    """Call a function in a thread that ends with the process, even if it does not return."""
    found: Future[FunctionResult] = Future()
    found.set_running_or_notify_cancel()

    def work() -> None:
        try:
            kept = kept_of(context.run(function, *given.args, **given.kwargs))
        except BaseException as error:  # noqa: BLE001 - the thread is the function's
            kept = FunctionResult(value=error, text=named(error))
        finally:
            ended()
        found.set_result(kept)

    threading.Thread(target=work, name="authguard-tool", daemon=True).start()
    return found


def in_loop(
    loop: asyncio.AbstractEventLoop,
    coroutine: Callable[..., Awaitable[Any]],
    given: inspect.BoundArguments,
    context: contextvars.Context,
    ended: Callable[[], None],
) -> Future[FunctionResult]:
    """Await a function in a loop of another thread; canceling the answer cancels it there.

    Raises:
        RuntimeError: the loop is closed.
    """
    found: Future[FunctionResult] = Future()

    async def work() -> FunctionResult:
        try:
            return kept_of(await coroutine(*given.args, **given.kwargs))
        except Exception as error:  # noqa: BLE001 - the function's own
            return FunctionResult(value=error, text=named(error))

    def over(task: asyncio.Task[FunctionResult]) -> None:
        ended()
        error = asyncio.CancelledError() if task.cancelled() else task.exception()
        kept = task.result() if error is None else FunctionResult(value=error, text=named(error))
        with suppress(InvalidStateError):  # it was called off; no caller waits any more
            found.set_result(kept)

    def begin() -> None:
        task = loop.create_task(work())
        task.add_done_callback(over)

        def call_off(_: Future[FunctionResult]) -> None:
            with suppress(RuntimeError):  # that loop is closed
                loop.call_soon_threadsafe(task.cancel)

        found.add_done_callback(call_off)

    loop.call_soon_threadsafe(begin, context=context)
    return found


def kept_of(value: Any) -> FunctionResult:
    """Return what a function returned; an unfinished coroutine is an error."""
    if is_lazy(value):
        if inspect.iscoroutine(value):
            value.close()
        return FunctionResult(
            value=None, text="expected a value, got work that is still to be done"
        )
    return FunctionResult(value=value)


def told_of(number: str, texts: tuple[str, ...]) -> ExecutionNews:
    """Return what goes through the gate: the number of what is kept, and its words."""
    return ExecutionNews(json.dumps({"number": number, "texts": texts}).encode(), texts)


def named(error: BaseException) -> str:
    """Return an exception as a model may see it."""
    try:
        said = str(error)
    except Exception:  # noqa: BLE001 - its own code
        said = ""
    return f"{type(error).__name__}: {said}" if said else type(error).__name__
