# SPDX-License-Identifier: Apache-2.0
"""The end that a planner's MCP client speaks to: the tools that are bound, and nothing else.

A call becomes a proposal; the answer is what the gate says of it, with what the tool brought to
light. Nothing is decided here: resources, prompts, completions, log levels and subscriptions have
no handler, and a form that a client has filled in is not read. Spec page: docs/spec/mcp.md#front
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager, nullcontext
from importlib.metadata import version
from typing import Any

import mcp_types as types
from mcp.server.lowlevel import Server

from authguard_r.core.errors import AuthGuardError, MalformedError, RefusedError
from authguard_r.core.reasons import Reason
from authguard_r.integrations.mcp import asking
from authguard_r.integrations.mcp.answers import answer_of, texts_of
from authguard_r.integrations.mcp.pins import Pins
from authguard_r.integrations.mcp.turns import Turns
from authguard_r.integrations.mcp.unreadable import UNREADABLE
from authguard_r.integrations.tools.call_schema import narrowed
from authguard_r.integrations.tools.planner import CallOutcome, LostError, ToolPlanner
from authguard_r.normalize.binding import Binding, ways_of
from authguard_r.normalize.dialects import Call
from authguard_r.site.model import Site

#: Where a client names its proposal, so that asking again is the same one.
KEY = "authguard-r/key"
_NAME = "authguard-r"
#: Most bytes of calls that wait for their turn; a place costs some by itself.
MAX_WAITING = 16 << 20
_PLACE = 1_024
#: Calls a tool as the planner wrote it.
Unguarded = Callable[[str, dict[str, Any]], Awaitable[types.CallToolResult]]


def shown(pins: Pins, binding: Binding, site: Site) -> list[types.Tool]:
    """Return the tools that a planner is shown: bound ones, of which some way may be granted.

    A tool that could change the robot's own belief, in any way of calling it, is hidden. What its
    server says of its harmlessness is left out. The schema is narrowed to what the binding reads.
    """
    return [
        types.Tool(
            name=pin.name,
            description=pin.description,
            input_schema=narrowed(pin.schema, pin.name, binding, site),
        )
        for pin in pins.tools
        if fate(pin.name, binding, site).startswith("shown")
    ]


def tools_of(pins: Pins) -> list[types.Tool]:
    """Return every pinned tool, without what its server says of its harmlessness."""
    return [
        types.Tool(name=pin.name, description=pin.description, input_schema=pin.schema)
        for pin in pins.tools
    ]


def beside_tools(binding: Binding, site: Site) -> frozenset[str]:
    """Return the tools of which every way may run beside another action, and moves nothing."""
    kinds = {
        name: [site.vocabulary[way.tool.type] for way in ways_of(binding, name)]
        for name in binding.tools
    }
    return frozenset(
        n for n, all_of in kinds.items() if all(k.beside and not k.moves for k in all_of)
    )


def fate(name: str, binding: Binding, site: Site) -> str:
    """Return how a server's tool is treated: `shown`, or `hidden` and why."""
    if name not in binding.tools:
        return "hidden: not bound"
    ways = [site.vocabulary[way.tool.type] for way in ways_of(binding, name)]
    refused = sum(kind.state_writing for kind in ways)
    if refused == len(ways):
        return "hidden: it writes the robot's state, or no gate can check it"
    return f"shown: {len(ways) - refused} of {len(ways)} ways can be granted"


class Front:
    """Answers a planner's client.

    Args:
        planner: proposes to the gate.
        aside: proposes what runs beside another action, and its tools.
        tools: returns what is shown now.
        made: returns the call that was made for a release's ticket.
        unguarded: calls a tool as the planner wrote it; for a gate in shadow mode, which releases
            nothing and only says what it would have done. None: nothing is called from here.
    """

    def __init__(
        self,
        planner: ToolPlanner,
        aside: tuple[ToolPlanner, frozenset[str]],
        tools: Callable[[], list[types.Tool]],
        made: Callable[[str | None], Call | None],
        unguarded: Unguarded | None = None,
    ) -> None:
        self._planner = planner
        self._aside, self._beside_tools = aside
        self._tools = tools
        self._made = made
        self._unguarded = unguarded
        self._turns = Turns()
        self._waiting = 0
        self.server: Server[Any] = Server(
            _NAME,
            version=version("authguard-r"),
            on_list_tools=self._list,
            on_call_tool=self._call,
        )

    async def _list(self, ctx: Any, params: Any) -> types.ListToolsResult:  # noqa: ARG002
        return types.ListToolsResult(tools=self._tools())

    async def _call(
        self, ctx: Any, params: types.CallToolRequestParams
    ) -> types.CallToolResult | types.InputRequiredResult:
        said = asking.said(params)
        if said is asking.PersonAnswer.NO:  # it only narrows; a yes is read nowhere
            return refused({"outcome": "reject", "reasons": []}, "not proposed again: declined")
        session = _session_of(ctx)
        answer, waits_for = await self._proposed(params, session, again=said is not None)
        if waits_for is None or said is not None or not asking.can_ask(ctx):
            return answer
        if asking.is_modern(ctx):
            return asking.question(params.name, waits_for)
        if await asking.asked_to_go_on(ctx, params.name, waits_for):
            answer, _ = await self._proposed(params, session, again=True)
        return answer

    async def _proposed(
        self, params: types.CallToolRequestParams, session: str | None, *, again: bool
    ) -> tuple[types.CallToolResult, int | None]:
        """Return the result of a call, and how many approvals it waits for, as the gate says.

        One that is made again is a proposal of its own. Nothing that a tool's server says is
        taken for the gate's word: it is asked before there is an answer of a server.
        """
        arguments = params.arguments or {}
        try:
            if UNREADABLE in arguments:
                await self._planner.unreadable(params.name, str(arguments[UNREADABLE]))
                raise MalformedError("expected strict JSON, each key once", where="arguments")
            is_beside = params.name in self._beside_tools
            planner = self._aside if is_beside else self._planner
            turn = nullcontext() if is_beside else self._turns.turn(session)
            with self._room(arguments):
                async with turn, planner.turn:
                    key = named(params, again=again)
                    asked = await planner.propose(params.name, arguments, key=key)
                    if self._unguarded is not None:
                        return await self._beside(params.name, arguments, asked), None
        except LostError as lost:
            return undecided(lost.error), None
        except AuthGuardError as error:
            return undecided(error), None
        waits = asked.execution is None and asked.step["outcome"] == "request_approval"
        return answered(asked, self._made(asked.ticket)), asked.step.get(
            "required_approvals", 0
        ) if waits else None

    async def _beside(
        self, tool: str, arguments: dict[str, Any], asked: CallOutcome
    ) -> types.CallToolResult:
        """Make a call after each verdict of the gate, and let it know what the planner sees."""
        if self._unguarded is None:  # pragma: no cover - asked by the caller
            raise RuntimeError("nothing is called from here")
        answer = await self._unguarded(tool, arguments)
        await self._planner.note(texts_of(answer))
        return answer.model_copy(update={"meta": {_NAME: {**asked.verdict, "shadow": True}}})

    @contextmanager
    def _room(self, arguments: dict[str, Any]) -> Iterator[None]:
        """Hold a place among the calls that wait.

        Raises:
            RefusedError: they hold too much already (`BUSY`).
            MalformedError: the arguments are no JSON.
        """
        size = size_of(arguments)
        if self._waiting + size > MAX_WAITING:
            raise RefusedError("too many calls wait", reason=Reason.BUSY, where="arguments")
        self._waiting += size
        try:
            yield
        finally:
            self._waiting -= size


def _session_of(ctx: Any) -> str | None:
    """Return which session asks; None: the only one, or one of those that last for one request."""
    headers = getattr(ctx.request, "headers", {})
    name: str | None = headers.get("mcp-session-id")
    return name


def named(params: types.CallToolRequestParams, *, again: bool) -> str | None:
    """Return what a call's proposal is named; None: it is not named.

    Raises:
        MalformedError: its name is no text.
    """
    key = (params.meta or {}).get(KEY)
    if key is None:
        return None
    if not isinstance(key, str):
        raise MalformedError("expected text", where=f"_meta.{KEY}")
    return hashlib.sha256(f"again {key}".encode()).hexdigest()[:40] if again else key


def size_of(arguments: dict[str, Any]) -> int:
    """Return about how many bytes a call holds while it waits.

    Raises:
        MalformedError: the arguments are no JSON.
    """
    try:
        return len(json.dumps(arguments)) + _PLACE
    except (ValueError, TypeError, RecursionError) as error:
        raise MalformedError("not JSON", where="arguments") from error


def answered(asked: CallOutcome, made: Call | None = None) -> types.CallToolResult:
    """Return what a planner sees of its call.

    Args:
        asked: how it went.
        made: what was called: a place may have become its approach point, a number a rounded one.
    """
    outcome = asked.execution
    verdict = {**asked.verdict, "execution": outcome, "repeated": asked.repeated}
    if made is not None:
        verdict["dispatched"] = {"tool": made.tool, "arguments": made.arguments}
    if outcome is None:
        return refused(verdict, asked.refusal)
    if asked.results:
        try:
            answer = answer_of(asked.result())
        except (ValueError, MalformedError):
            return refused(verdict, "the tool's answer could not be read")
        failed = answer.is_error or outcome != "succeeded"
        changed = {"is_error": failed, "meta": {_NAME: verdict}}
        if _NAME in (answer.structured_content or {}):  # a verdict is the gate's to give
            own = {k: v for k, v in answer.structured_content.items() if k != _NAME}
            changed["structured_content"] = own
        return answer.model_copy(update=changed)
    if outcome == "succeeded":
        text = "succeeded" + (" before; its answer is not repeated" if asked.repeated else "")
        return types.CallToolResult(content=[_text(text)], structured_content={_NAME: verdict})
    return refused(verdict, f"{outcome}: " + ", ".join(asked.step["execution"]["reasons"]))


def undecided(error: AuthGuardError) -> types.CallToolResult:
    """Return what a planner sees when the gate did not answer it."""
    return refused({"outcome": "reject", "reasons": [str(error.reason)]}, error.message)


def refused(verdict: dict[str, Any], text: str) -> types.CallToolResult:
    """Return an error of the tool, which a planner can read and go by."""
    return types.CallToolResult(
        content=[_text(text)], structured_content={_NAME: verdict}, is_error=True
    )


def _text(text: str) -> types.TextContent:
    return types.TextContent(type="text", text=text)
