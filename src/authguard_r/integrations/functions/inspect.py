# SPDX-License-Identifier: Apache-2.0
"""Tools of Inspect behind a gate, and an approver that asks it.

    tools = guard_tools(guard, tools)            # in the task
    approvers: [{name: authguard_r/authguard, tools: "*"}]  # in its approval policy

Guarded tools alone are enough. With the approver, Inspect's log shows the gate's decision, and the
arguments that are run. Needs the extra `inspect`. How-to: docs/howto/adapters.md#inspect
"""

from __future__ import annotations

import contextvars
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import replace
from importlib import import_module
from typing import Any

from pydantic import Field

from authguard_r.core.errors import AuthGuardError, MalformedError
from authguard_r.integrations.functions.guard import GateGuard
from authguard_r.integrations.functions.outcomes import NotDone
from authguard_r.integrations.functions.turns import CallTurn, register

_approval: Any = import_module("inspect_ai.approval")
_handoff: Any = import_module("inspect_ai.agent._handoff")
_running: Any = import_module("inspect_ai.model._call_tools")
_tool: Any = import_module("inspect_ai.tool")
_call: Any = import_module("inspect_ai.tool._tool_call")

#: The call that was approved in this task and has not begun: tool, released arguments, turn.
_APPROVED: contextvars.ContextVar[tuple[str, dict[str, Any], CallTurn] | None] = (
    contextvars.ContextVar("authguard_approved", default=None)
)
#: How a tool is asked for before it runs.
_Ask = Callable[[dict[str, Any]], Awaitable[dict[str, Any]]]


class _View(_tool.ToolCallView):  # type: ignore[misc]
    """What an approver is shown of a call of a guarded tool; nothing that a model writes is one."""

    ask: _Ask = Field(exclude=True)


def guard_tools(guard: GateGuard, tools: Sequence[Any]) -> list[Any]:
    """Return tools that a model is shown alike, and that call nothing past the gate.

    A refusal is a tool error that the model sees.

    Args:
        guard: has the functions from now on; the given tools are still the given tools.
        tools: of this process, each one of the guard's binding.

    Raises:
        MalformedError: one is no tool of this process, or the binding has none such.
    """
    definitions = [_definition(tool) for tool in tools]
    return [_guarded(guard, definition) for definition in definitions]


def _definition(tool: Any) -> Any:
    """Return a tool's definition.

    Raises:
        MalformedError: it is no tool, or what runs it is a model's server or another agent.
    """
    if not isinstance(tool, _tool.ToolDef):
        if isinstance(tool, _tool.ToolSource) or not callable(tool):
            kind = type(tool).__name__
            raise MalformedError(f"expected a tool, got `{kind}`", where=kind)
        tool = _tool.ToolDef(tool)
    if isinstance(tool.tool, _handoff.AgentTool):
        raise MalformedError(
            "expected a tool, got a handoff: it goes past the gate", where=tool.name
        )
    if tool.options:
        raise MalformedError(
            "expected a tool without options: a model's server may run it", where=tool.name
        )
    return tool


def _guarded(guard: GateGuard, definition: Any) -> Any:
    name = definition.name

    async def do(arguments: dict[str, Any]) -> Any:
        return await definition.tool(**_running.tool_params(arguments, definition.tool))

    async def ask(arguments: dict[str, Any]) -> dict[str, Any]:
        turn = CallTurn(guard, name, arguments, waits=True)
        released = await turn.released()
        _APPROVED.set((name, released, turn))
        return released

    async def execute(**kwargs: Any) -> Any:
        turn = _approved(name, kwargs) or CallTurn(guard, name, kwargs, waits=False)
        try:
            return await turn.done()
        except (NotDone, AuthGuardError) as error:
            raise _tool.ToolError(str(error)) from error

    def view(call: Any) -> Any:
        own = definition.viewer or _call.default_tool_call_viewer
        shown = own(call)
        return _View(context=shown.context, call=shown.call, ask=ask)

    register(guard, name, do)
    return _tool.ToolDef(
        execute,
        name=name,
        description=definition.description,
        parameters=definition.parameters,
        parallel=definition.parallel,
        viewer=view,
        model_input=definition.model_input,
        max_output=definition.max_output,
    ).as_tool()


def _approved(name: str, arguments: dict[str, Any]) -> CallTurn | None:
    """Return the turn of the very call that was approved in this task; None without one.

    What came in between may have changed the call: then the approved one is given up.
    """
    approved = _APPROVED.get()
    _APPROVED.set(None)
    if approved is None:
        return None
    *released, turn = approved
    if released == [name, arguments]:
        return turn
    turn.give_up()
    return None


def _authguard(gone: str = "reject") -> Any:
    """Return an approver that lets a gate decide, by the role of a planner.

    It approves with the arguments that were released; the guarded tool runs inside the release. A
    tool that is not guarded is rejected: it would run past the gate.

    Args:
        gone: the result of a call that the gate has not decided: `reject`, or `terminate`, which
            ends the sample.

    Raises:
        ValueError: another word.
    """
    if gone not in {"reject", "terminate"}:
        raise ValueError(f"expected `reject` or `terminate`, got `{gone}`")

    async def approve(message: str, call: Any, view: Any, history: Any) -> Any:  # noqa: ARG001
        if not isinstance(view, _View):
            why = f"refused: `{call.function}` is not guarded"
            return _approval.Approval(decision="reject", explanation=why)
        try:
            released = await view.ask(call.arguments)
        except NotDone as error:
            decided = error.__cause__ is None or isinstance(error.__cause__, MalformedError)
            return _approval.Approval(
                decision="reject" if decided else gone, explanation=str(error)
            )
        except AuthGuardError as error:
            return _approval.Approval(decision=gone, explanation=str(error))
        modified = replace(call, arguments=released)
        return _approval.Approval(decision="modify", modified=modified, explanation="released")

    return approve


authguard = _approval.approver(name="authguard")(_authguard)
