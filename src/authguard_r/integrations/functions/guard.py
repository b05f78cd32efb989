# SPDX-License-Identifier: Apache-2.0
"""One process's end at a gate: its functions are a robot's tools, and its agent their planner.

A call is proposed; what the gate releases is rebuilt and made here; what the function returned is
handed out once its words have gone through the gate. Code of this process that has the function
itself is not held by anything: the barrier is a process without the robot's credentials
(`authguard mcp`). Spec page: docs/spec/adapters.md
"""

from __future__ import annotations

import asyncio
import contextvars
import functools
import inspect
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import CancelledError, Future
from pathlib import Path
from types import TracebackType
from typing import Any, ParamSpec, Self, TypeVar, overload

from authguard_r.access.files import read_binding, trusted_site
from authguard_r.client.link import ProcessLog
from authguard_r.core.errors import AuthGuardError, EnvironmentFault, MalformedError
from authguard_r.core.identifiers import RobotId
from authguard_r.core.reasons import Reason
from authguard_r.integrations.functions.background import Background
from authguard_r.integrations.functions.functions import (
    INSIDE,
    FunctionResult,
    Functions,
    FunctionTool,
    WaitingCaller,
)
from authguard_r.integrations.functions.outcomes import (
    Failed,
    Repeated,
    lost,
    refused,
    report_of,
    undecided,
)
from authguard_r.integrations.functions.registry import Registry
from authguard_r.integrations.functions.values import (
    Fields,
    Words,
    fields_of,
    plain,
    sendable,
    words_of,
)
from authguard_r.integrations.tools.endpoints import START_S, Ends, GateTarget
from authguard_r.integrations.tools.planner import CallOutcome, LostError
from authguard_r.integrations.tools.server import CallError
from authguard_r.keys.trust import read_trust
from authguard_r.normalize.dialects import Call

P = ParamSpec("P")
R = TypeVar("R")


class GateGuard:
    """A context manager; made by `connect`.

    Args:
        place: which robot and which gate.
    """

    def __init__(self, place: GateTarget) -> None:
        self._functions = Functions(self._look)
        self._registry = Registry(place, self._functions)
        self._ends = Ends(place, self._functions, ProcessLog(), self._registry)
        self._shadow = place.shadow
        self._background = Background(self._ends)

    @classmethod
    def connect(
        cls,
        *,
        robot: str,
        run: Path | str,
        site: Path | str,
        binding: Path | str,
        trust: Path | str,
        client: str = "agent",
        stops: Sequence[str | tuple[str, Mapping[str, Any]]] = (),
        shadow: bool = False,
        within_s: float = START_S,
    ) -> Self:
        """Return a guard that both of its ends have connected.

        Args:
            robot: whose tools the functions are.
            run: the gate's run folder.
            site: the site: a signed token, or YAML beside a demonstration's trust root.
            binding: a shipped binding's name, or a file: the gate's own.
            trust: the trust folder.
            client: the planner's name in the log.
            stops: registered functions that stop the robot, in order: a name, or a name and
                arguments.
            shadow: take a gate in shadow mode and no other: calls are made as they were written.
            within_s: the gate has come by then.

        Raises:
            EnvironmentFault: the gate did not come, or a file cannot be read.
            AuthenticityError: a signature does not hold.
            MalformedError: no site, binding or call.
            RefusedError: the gate enforces, and `shadow` was asked for.
        """
        anchor = read_trust(Path(trust))
        model = trusted_site(Path(site), anchor)
        place = GateTarget(
            robot=RobotId(robot),
            run=Path(run),
            site=model,
            binding=read_binding(str(binding), model),
            trust=lambda: read_trust(Path(trust)),
            stops=tuple(map(_stop, stops)),
            client=client,
            shadow=shadow,
            within_s=within_s,
        )
        guard = cls(place)
        guard._background.start()
        return guard

    @property
    def registered(self) -> tuple[str, ...]:
        """The tools that have a function, by name."""
        return tuple(sorted(self._functions.tools))

    @property
    def missing(self) -> tuple[str, ...]:
        """The tools of the binding that have none, by name."""
        return self._registry.missing

    def decided(self, tool: str) -> frozenset[str]:
        """Return the names of the arguments of a tool that the gate decides on."""
        return self._registry.decided(tool)

    def register(
        self,
        name: str,
        function: Callable[..., Any] | None,
        *,
        coroutine: Callable[..., Any] | None = None,
        words: Words | None = None,
        fields: Fields | None = None,
    ) -> None:
        """Let a function be what a tool does.

        Args:
            name: the tool's, as the binding spells it.
            function: does its work when it is called, or is a coroutine function.
            coroutine: does the same when it is awaited, in the event loop that awaits `acall`.
            words: every word of what it returns that a model could read; for values whose JSON
                and `str` do not say it.
            fields: what it returns as fields by name, for the binding's `succeeds`.

        Raises:
            MalformedError: the binding has no such tool, or it has a function already, or the
                binding's call does not fit this function.
        """
        self._registry.add(name, function, coroutine, words or words_of, fields or fields_of)

    @overload
    def tool(
        self, function: Callable[P, R], /, *, name: None = None, words: None = None
    ) -> Callable[P, R]: ...

    @overload
    def tool(
        self, function: None = None, /, *, name: str | None = None, words: Words | None = None
    ) -> Callable[[Callable[P, R]], Callable[P, R]]: ...

    def tool(
        self,
        function: Callable[..., Any] | None = None,
        /,
        *,
        name: str | None = None,
        words: Words | None = None,
    ) -> Callable[..., Any]:
        """Register the function below and put a guarded one in its place.

        It has the same name, documentation and signature, and calls nothing but `call` or `acall`.
        """
        if function is None:
            return functools.partial(self._guarded, name=name, words=words)
        return self._guarded(function, name=name, words=words)

    def call(
        self,
        tool: str,
        arguments: Mapping[str, Any],
        *,
        key: str | None = None,
        beside: Mapping[str, Any] | None = None,
    ) -> Any:
        """Propose a call, and return what the function returned once the gate released it.

        Args:
            tool: a registered tool's name.
            arguments: by name; untrusted. What the function is called with is rebuilt.
            key: names the proposal: the same key again is the same one, and calls nothing.
            beside: arguments that the program gives and the planner does not; the function has
                them as they are. None of them may be an argument of the binding's.

        Raises:
            Refused: nothing was called.
            Failed: it did not succeed, or its outcome is unknown.
            Repeated: it succeeded before under this key.
            MalformedError: no function is registered for the tool.
        """
        asked = self._ask(tool, arguments, key, beside, loop=None)
        try:
            return asked.result()
        except CancelledError as error:
            raise _closed() from error

    async def acall(
        self,
        tool: str,
        arguments: Mapping[str, Any],
        *,
        key: str | None = None,
        beside: Mapping[str, Any] | None = None,
    ) -> Any:
        """Do as `call` does, in an event loop; a coroutine function is awaited in this one.

        Canceling it ends the waiting, not the action: the stop process does that.
        """
        asked = self._ask(tool, arguments, key, beside, loop=asyncio.get_running_loop())
        waiting = asyncio.wrap_future(asked)
        try:
            return await asyncio.shield(waiting)
        except asyncio.CancelledError as error:
            if waiting.cancelled():
                raise _closed() from error
            raise

    def unreadable(self, tool: str, text: str | bytes | bytearray) -> Future[None]:
        """Have the gate refuse, and log, what a model wrote for a call that cannot be read.

        It is never called; the caller may wait for the gate's answer.
        """
        plain = text if isinstance(text, str) else text.decode(errors="backslashreplace")
        return self._background.begin(self._ends.planner.unreadable(tool, plain))

    def close(self) -> None:
        """Let go of the gate; what still runs is reported to it as lost."""
        self._background.close()
        self._functions.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    # what a call is

    def _ask(
        self,
        tool: str,
        arguments: Mapping[str, Any],
        key: str | None,
        beside: Mapping[str, Any] | None,
        *,
        loop: asyncio.AbstractEventLoop | None,
    ) -> Future[Any]:
        """Begin a call; calls begin in the order in which this is entered."""
        found = self._registry.found(tool, beside or {})
        inside = INSIDE.get()
        if inside is not None and not inside.over:
            raise RuntimeError(f"`{tool}` was called by a guarded function: its turn never comes")
        caller = WaitingCaller(
            tool=tool, beside=dict(beside or {}), context=contextvars.copy_context(), loop=loop
        )
        try:
            written = plain(self._registry.filled(tool, arguments))
        except MalformedError as error:
            raise undecided(error) from error
        return self._background.begin(self._asked(found, written, dict(arguments), key, caller))

    async def _asked(
        self,
        tool: FunctionTool,
        written: dict[str, Any],
        arguments: dict[str, Any],
        key: str | None,
        caller: WaitingCaller,
    ) -> Any:
        planner = self._ends.planner
        async with planner.turn:
            try:
                self._functions.caller = caller
                asked = await planner.propose(tool.name, written, key=key, told=caller.told)
                if self._shadow:
                    return await self._beside(tool, arguments, caller, asked)
            except LostError as error:
                raise lost(error.error) from error
            except AuthGuardError as error:
                raise undecided(error) from error
            finally:
                self._functions.caller = None
                caller.told({})
        return self._value(asked)

    async def _beside(
        self,
        tool: FunctionTool,
        arguments: dict[str, Any],
        caller: WaitingCaller,
        asked: CallOutcome,
    ) -> Any:
        """Call the function after each verdict, and let the gate know what the planner sees."""
        report = {**report_of(asked), "shadow": True}
        try:
            kept = await self._functions.carry(tool, arguments, caller)
        except CallError as error:
            raise Failed(f"not_started: {error.message}", report) from error
        try:
            words = (kept.text,) if kept.text else tool.words(kept.value)
            await self._ends.planner.note(sendable(words))
        except Exception as error:
            raise Failed("its result could not be recorded", report) from error
        return _handed(kept, report)

    def _value(self, asked: CallOutcome) -> Any:
        """Return what the function returned.

        Raises:
            NotDone: nothing that can be handed out.
        """
        outcome, report = asked.execution, report_of(asked)
        if outcome is None:
            raise refused(asked)
        if asked.results:
            try:
                kept = self._functions.take(asked.result())
            except MalformedError as error:
                raise Failed(f"{outcome}: its answer is not of this process", report) from error
            if outcome == "succeeded" or kept.text:
                return _handed(kept, report)
        if outcome == "succeeded" and asked.repeated:
            raise Repeated("succeeded before; its answer is not repeated", report)
        raise Failed(f"{outcome}: " + ", ".join(asked.step["execution"]["reasons"]), report)

    def _guarded(
        self, function: Callable[..., Any], *, name: str | None, words: Words | None
    ) -> Callable[..., Any]:
        called = name or function.__name__
        self.register(called, function, words=words)
        signature = inspect.signature(function)
        given = functools.partial(_given, signature)

        if inspect.iscoroutinefunction(function):

            async def guarded(*args: Any, **kwargs: Any) -> Any:
                return await self.acall(called, given(args, kwargs))
        else:

            def guarded(*args: Any, **kwargs: Any) -> Any:  # type: ignore[misc]
                return self.call(called, given(args, kwargs))

        made = functools.update_wrapper(guarded, function, updated=())
        del made.__wrapped__  # the function itself cannot be reached from here
        made.__signature__ = signature  # type: ignore[attr-defined]
        return made

    def _look(self) -> None:
        self._ends.look()


def _handed(kept: FunctionResult, report: dict[str, Any]) -> Any:
    """Return a value; what has none is a failure, with the exception that it came of."""
    if not kept.text:
        return kept.value
    raise Failed(kept.text, report) from (
        kept.value if isinstance(kept.value, BaseException) else None
    )


def _given(
    signature: inspect.Signature, args: tuple[Any, ...], kwargs: dict[str, Any]
) -> dict[str, Any]:
    """Return arguments by name; what has none, or two values, is refused."""
    try:
        first = signature.bind_partial(*args).arguments
    except TypeError as error:
        raise undecided(MalformedError(str(error), where="arguments")) from error
    twice = sorted(first.keys() & kwargs.keys())
    if twice:
        raise undecided(MalformedError("expected one value", where=f"arguments.{twice[0]}"))
    return {**first, **kwargs}


def _closed() -> EnvironmentFault:
    return EnvironmentFault("the guard was closed", reason=Reason.CONTROLLER_FAILED)


def _stop(given: str | tuple[str, Mapping[str, Any]]) -> Call:
    name, arguments = (given, {}) if isinstance(given, str) else given
    return Call(name, plain(arguments), "stops")
