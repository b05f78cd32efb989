# SPDX-License-Identifier: Apache-2.0
"""Tools of the OpenAI Agents SDK behind a gate.

    agent = guard_agent(guard, Agent(name="courier", tools=tools))

How-to: docs/howto/adapters.md#openai-agents
"""

from __future__ import annotations

import asyncio
import copy
import json
from collections.abc import Sequence
from dataclasses import fields
from typing import Any

from agents import Agent, FunctionTool, Tool, ToolOriginType
from agents.tool import (
    get_function_tool_origin,
    invoke_function_tool,
    maybe_invoke_function_tool_failure_error_function,
    set_function_tool_failure_error_function,
)
from agents.tool_context import ToolContext
from msgspec import Struct

from authguard_r.core.errors import AuthGuardError, MalformedError
from authguard_r.integrations.functions.guard import GateGuard
from authguard_r.integrations.functions.outcomes import NotDone, undecided
from authguard_r.integrations.functions.texts import BESIDE, arguments_in, left_out, words_in


class _SdkContext(Struct):
    """What the SDK has for one call.

    Args:
        context: its context, as the tool may ask for it.
        nulls: arguments that the model left out by name.
        raised: what the tool raised, once it has.
    """

    context: ToolContext[Any]
    nulls: dict[str, None] = {}
    raised: Exception | None = None


class _Worded(Exception):  # noqa: N818 - it carries what the model is told
    """A fault of a tool as its own failure function words it."""


def guard_agent(guard: GateGuard, agent: Agent[Any]) -> Agent[Any]:
    """Return an agent whose every tool is guarded.

    Raises:
        MalformedError: it reaches something past its tools, or as `guard_tools` says.
    """
    if type(agent) is not Agent:
        raise MalformedError(
            f"expected a plain agent, got `{type(agent).__name__}`: it brings tools of its own",
            where=agent.name,
        )
    for past, found in (("MCP servers", agent.mcp_servers), ("handoffs", agent.handoffs)):
        if found:
            raise MalformedError(
                f"expected an agent without {past}: they go past the gate", where=agent.name
            )
    return agent.clone(tools=guard_tools(guard, agent.tools))


def guard_tools(guard: GateGuard, tools: Sequence[Tool]) -> list[Tool]:
    """Return tools that a model is shown alike, and that call nothing past the gate.

    The model sees what the gate refuses, and the run goes on.

    Args:
        guard: has the functions from now on; the given tools are still the given tools.
        tools: function tools of this process, each one of the guard's binding.

    Raises:
        MalformedError: one is no function tool of this process, or the binding has none such.
    """
    own = [_function_tool(tool) for tool in tools]
    return [_guarded(guard, tool) for tool in own]


def _function_tool(tool: Tool) -> FunctionTool:
    """Return a tool that is a function of this process.

    Raises:
        MalformedError: it is run elsewhere, or by a model: that goes past the gate.
    """
    name = str(getattr(tool, "name", type(tool).__name__))
    if not isinstance(tool, FunctionTool):
        raise MalformedError(
            f"expected a function tool, got `{type(tool).__name__}`: it goes past the gate",
            where=name,
        )
    origin = get_function_tool_origin(tool)
    if origin is None or origin.type is not ToolOriginType.FUNCTION:
        kind = "unknown" if origin is None else origin.type.value
        raise MalformedError(
            f"expected a function of this process, got a tool of origin `{kind}`", where=name
        )
    return tool


def _guarded(guard: GateGuard, tool: FunctionTool) -> FunctionTool:
    guard.register(tool.name, None, coroutine=_released(tool), words=words_in)

    async def ask(context: ToolContext[Any], text: str) -> Any:
        beside = _SdkContext(context)
        try:
            try:
                written = arguments_in(text)
            except MalformedError as error:
                await asyncio.wrap_future(guard.unreadable(tool.name, text))
                raise undecided(error) from error
            beside.nulls = left_out(written, guard.decided(tool.name))
            asked = {name: value for name, value in written.items() if name not in beside.nulls}
            return await guard.acall(tool.name, asked, beside={BESIDE: beside})
        except (NotDone, AuthGuardError) as error:
            if beside.raised is None or error.__cause__ is not beside.raised:
                return str(error)
        if isinstance(beside.raised, _Worded):
            return str(beside.raised)
        raise beside.raised  # the tool's own policy: its faults end the run

    given = {field.name: getattr(tool, field.name) for field in fields(FunctionTool)}
    return FunctionTool(**{**given, "on_invoke_tool": ask})


def _released(tool: FunctionTool) -> Any:
    """Return what does a tool's work with what the gate released."""
    own = copy.copy(tool)
    own.timeout_seconds = None  # the guarded one waits so long; the binding says how long it runs
    set_function_tool_failure_error_function(own, None)  # the gate hears of a fault as one

    async def work(*, authguard_beside: _SdkContext | None = None, **arguments: Any) -> Any:
        if authguard_beside is None:
            raise MalformedError("expected a call of the agent's", where=tool.name)
        text = json.dumps({**authguard_beside.nulls, **arguments})
        context = _context(authguard_beside.context, text)
        try:
            return await invoke_function_tool(function_tool=own, context=context, arguments=text)
        except Exception as error:
            told = await maybe_invoke_function_tool_failure_error_function(
                function_tool=tool, context=authguard_beside.context, error=error
            )
            authguard_beside.raised = error if told is None else _Worded(told)
            raise authguard_beside.raised from error

    return work


def _context(context: ToolContext[Any], text: str) -> ToolContext[Any]:
    """Return a call's context with the arguments that were released, for a tool that reads them."""
    made = copy.copy(context)
    made.tool_arguments = text
    if made.tool_call is not None:
        made.tool_call = made.tool_call.model_copy(update={"arguments": text})
    return made
