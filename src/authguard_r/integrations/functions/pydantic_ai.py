# SPDX-License-Identifier: Apache-2.0
"""Toolsets of Pydantic AI behind a gate.

    agent = Agent(model, toolsets=[guard_tools(guard, tools)])

How-to: docs/howto/adapters.md#pydantic-ai
"""

from __future__ import annotations

import inspect
import json
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields
from threading import Lock
from typing import Any

from msgspec import Struct
from pydantic_ai import CallDeferred, RunContext, Tool
from pydantic_ai.exceptions import ApprovalRequired, ToolFailed
from pydantic_ai.toolsets import (
    AbstractToolset,
    ApprovalRequiredToolset,
    CombinedToolset,
    ExternalToolset,
    FunctionToolset,
    ToolsetTool,
    WrapperToolset,
)

from authguard_r.core.errors import AuthGuardError, MalformedError
from authguard_r.integrations.functions.guard import GateGuard
from authguard_r.integrations.functions.outcomes import NotDone, undecided
from authguard_r.integrations.functions.texts import BESIDE, arguments_in, left_out, words_in


class _PydanticContext(Struct):
    """What the framework has for one call.

    Args:
        context: the run's, with its dependencies.
        toolset: has the tool.
        tool: the tool as it is without a gate.
        nulls: arguments that the model left out by name.
        raised: what it raised, once it has.
    """

    context: RunContext[Any]
    toolset: AbstractToolset[Any]
    tool: ToolsetTool[Any]
    nulls: dict[str, None]
    raised: Exception | None = None


class _Names:
    """The tools that one guarded toolset has registered, in all its copies."""

    def __init__(self) -> None:
        self._names: set[str] = set()
        self._lock = Lock()

    def register(self, guard: GateGuard, names: Iterable[str]) -> None:
        """Register the tools that are new.

        Raises:
            MalformedError: the binding has no such tool, or another function does its work.
        """
        with self._lock:
            for name in names:
                if name not in self._names:
                    guard.register(name, None, coroutine=_released, words=words_in)
                    self._names.add(name)


@dataclass(kw_only=True)
class _GuardedTool(ToolsetTool[Any]):
    """A tool as a run sees it: what was written reaches the gate as it was written."""

    own: ToolsetTool[Any]


class _AsWritten:
    """Reads arguments strictly and changes nothing in them: the gate decides on what was written.

    The tool's own validator runs on what was released.

    Args:
        guard: hears of what cannot be read.
        tool: whose arguments they are.
    """

    def __init__(self, guard: GateGuard, tool: str) -> None:
        self._guard = guard
        self._tool = tool

    def validate_json(self, input: str | bytes | bytearray, **_: Any) -> Any:  # noqa: A002
        """Return what a model wrote as text."""
        try:
            return arguments_in(input)
        except MalformedError as error:
            self._said(input)
            raise ToolFailed(str(undecided(error))) from error

    def validate_python(self, input: Any, **_: Any) -> Any:  # noqa: A002
        """Return what a model's client has parsed; no names of arguments are no arguments."""
        if not isinstance(input, dict) or not all(isinstance(name, str) for name in input):
            self._said(repr(input))
            error = MalformedError("expected an object", where="arguments")
            raise ToolFailed(str(undecided(error)))
        return input

    def _said(self, text: str | bytes | bytearray) -> None:
        """Let the gate's log have it; a closed guard has no gate to send to."""
        with suppress(AuthGuardError):
            self._guard.unreadable(self._tool, text)


@dataclass
class GuardedToolset(WrapperToolset[Any]):
    """A toolset whose every tool calls nothing but a guard.

    A refusal is a failed result that the model sees (`ToolFailed`): it costs no retry, so that the
    run goes on; `UsageLimits` bound how often a model may insist.

    Args:
        guard: has the tools of the binding from now on.
        wrapped: has the tools; what is no function of a run is refused.

    Raises:
        MalformedError: a tool is run elsewhere or waits for the framework's own approval, or the
            binding has no such tool.
    """

    guard: GateGuard
    names: _Names = field(default_factory=_Names, repr=False)

    def __init__(
        self, guard: GateGuard, wrapped: AbstractToolset[Any], names: _Names | None = None
    ) -> None:
        _require_own(wrapped)
        super().__init__(wrapped)
        self.guard = guard
        self.names = names or _Names()
        if isinstance(wrapped, FunctionToolset):
            self.names.register(guard, wrapped.tools)

    async def get_tools(self, ctx: RunContext[Any]) -> dict[str, ToolsetTool[Any]]:
        """Return the tools of a step, each of them guarded.

        Raises:
            MalformedError: one is no function, or none of the binding's.
        """
        found = await self.wrapped.get_tools(ctx)
        for name, tool in found.items():
            _require_function(name, tool)
        self.names.register(self.guard, found)
        return {name: self._guarded(tool) for name, tool in found.items()}

    async def call_tool(
        self, name: str, tool_args: dict[str, Any], ctx: RunContext[Any], tool: ToolsetTool[Any]
    ) -> Any:
        """Propose a call; what the tool does, it does once the gate released it.

        Raises:
            ToolFailed: it was refused, or did not succeed.
            Exception: what the tool raises.
        """
        if not isinstance(tool, _GuardedTool):
            raise TypeError(f"expected a tool of this toolset, got `{type(tool).__name__}`")
        nulls = left_out(tool_args, self.guard.decided(name))
        asked = {key: value for key, value in tool_args.items() if key not in nulls}
        beside = _PydanticContext(ctx, self.wrapped, tool.own, nulls)
        try:
            return await self.guard.acall(name, asked, beside={BESIDE: beside})
        except (NotDone, AuthGuardError) as error:
            if beside.raised is None or error.__cause__ is not beside.raised:
                raise ToolFailed(str(error)) from error
            if isinstance(beside.raised, CallDeferred | ApprovalRequired):
                raise ToolFailed("failed: the tool is not done in this run") from error
        raise beside.raised

    def _guarded(self, tool: ToolsetTool[Any]) -> _GuardedTool:
        given = {item.name: getattr(tool, item.name) for item in fields(ToolsetTool)}
        reads = _AsWritten(self.guard, tool.tool_def.name)
        changed = {"toolset": self, "args_validator": reads, "args_validator_func": None}
        return _GuardedTool(**{**given, **changed}, own=tool)


def guard_tools(
    guard: GateGuard, tools: Sequence[Tool[Any] | Callable[..., Any]]
) -> GuardedToolset:
    """Return a toolset of tools that a model is shown alike, and that call nothing past the gate.

    Args:
        guard: has the functions from now on; the given tools are still the given tools.
        tools: functions, or tools of them, each one of the guard's binding.

    Raises:
        MalformedError: one is no function of this process, or as `GuardedToolset` says.
    """
    for tool in tools:
        if not isinstance(tool, Tool) and not inspect.isroutine(tool):
            raise MalformedError(
                f"expected a function or a tool of one, got `{type(tool).__name__}`: "
                "it goes past the gate",
                where=type(tool).__name__,
            )
    return GuardedToolset(guard, FunctionToolset(tools))


def _require_own(toolset: AbstractToolset[Any]) -> None:
    """Refuse what is not carried out by the run itself, as far as that is known beforehand."""
    if isinstance(toolset, ExternalToolset | ApprovalRequiredToolset):
        raise MalformedError(
            f"expected tools that a run carries out, got `{type(toolset).__name__}`",
            where=toolset.label,
        )
    if isinstance(toolset, WrapperToolset):
        _require_own(toolset.wrapped)
    elif isinstance(toolset, CombinedToolset):
        for inner in toolset.toolsets:
            _require_own(inner)
    elif isinstance(toolset, FunctionToolset):
        for name, tool in toolset.tools.items():
            if tool.requires_approval:
                raise _not_a_function(name, "unapproved")


def _require_function(name: str, tool: ToolsetTool[Any]) -> None:
    definition = tool.tool_def
    if definition.kind != "function":
        raise _not_a_function(name, definition.kind)
    if definition.unless_native is not None:
        raise _not_a_function(name, f"native {definition.unless_native}")


def _not_a_function(name: str, kind: str) -> MalformedError:
    return MalformedError(
        f"expected a function that a run carries out, got a tool that is `{kind}`", where=name
    )


async def _released(*, authguard_beside: _PydanticContext | None = None, **arguments: Any) -> Any:
    """Do a tool's work with what the gate released."""
    if authguard_beside is None:
        raise MalformedError("expected a call of the agent's", where="tool")
    context, tool = authguard_beside.context, authguard_beside.tool
    try:
        given = tool.args_validator.validate_json(
            json.dumps({**authguard_beside.nulls, **arguments}), context=context.validation_context
        )
        if tool.args_validator_func is not None:
            checked = tool.args_validator_func(context, **given)
            if inspect.isawaitable(checked):
                await checked
        name = tool.tool_def.name
        return await authguard_beside.toolset.call_tool(name, given, context, tool)
    except Exception as error:
        authguard_beside.raised = error
        raise
