# SPDX-License-Identifier: Apache-2.0
"""LangChain and LangGraph tools behind a gate.

    agent = create_agent(model, guard_tools(guard, tools))

How-to: docs/howto/adapters.md#langchain-and-langgraph
"""

from __future__ import annotations

import functools
import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any, Self, get_type_hints
from uuid import uuid4

from langchain_core.callbacks import (
    AsyncCallbackManagerForToolRun,
    BaseCallbackManager,
    CallbackManagerForToolRun,
)
from langchain_core.messages import BaseMessage, ToolMessage
from langchain_core.runnables import RunnableConfig
from langchain_core.tools import BaseTool, InjectedToolCallId, StructuredTool, ToolException
from langchain_core.tools.simple import Tool
from langchain_core.utils.pydantic import get_fields
from msgspec import Struct
from pydantic import PrivateAttr, SkipValidation
from pydantic_core import PydanticSerializationError, to_jsonable_python

from authguard_r.core.errors import AuthGuardError, MalformedError
from authguard_r.integrations.functions.guard import GateGuard
from authguard_r.integrations.functions.outcomes import NotDone, undecided
from authguard_r.integrations.functions.values import fields_of, words_of

#: How what is no part of a proposal reaches the tool.
_BESIDE = "authguard_beside"


class _LangChainContext(Struct, frozen=True):
    """What the framework gives a tool for one call, and no planner.

    Args:
        config: the run's configuration; its callbacks hear of the tool's own run.
        injected: arguments that are no part of what a model is shown.
    """

    config: RunnableConfig
    injected: dict[str, Any]


def guard_tools(
    guard: GateGuard, tools: Sequence[BaseTool], *, raises: bool = False
) -> list[BaseTool]:
    """Return tools that a model is shown alike, and that call nothing past the gate.

    Args:
        guard: has the functions from now on; the given tools are still the given tools.
        tools: each one of the guard's binding.
        raises: raise `Refused` and `Failed`; else the model sees them as an error of the tool.

    Raises:
        MalformedError: the binding has no such tool, or it decides on an argument that the
            framework injects.
    """
    return [_guarded(guard, tool, raises=raises) for tool in tools]


class GuardedTool(BaseTool):
    """A tool of the same name, description and schema that calls nothing but a guard.

    `func` is for frameworks that read its annotations; called, it goes through the guard too.
    """

    func: SkipValidation[Callable[..., Any] | None] = None

    _guard: GateGuard = PrivateAttr()
    _injected: frozenset[str] = PrivateAttr()
    _raises: bool = PrivateAttr()

    @classmethod
    def of(
        cls, guard: GateGuard, tool: BaseTool, injected: frozenset[str], *, raises: bool
    ) -> Self:
        """Return the guarded one of a tool that is registered."""
        schema = tool.args_schema
        if schema is None:  # what a model is shown without one, written down
            schema = {"type": "object", "properties": tool.args, "required": list(tool.args)}
        # a field since LangChain 1.0
        more: dict[str, Any] = {"extras": tool.extras} if hasattr(tool, "extras") else {}
        made = cls(
            name=tool.name,
            description=tool.description,
            args_schema=schema,
            return_direct=tool.return_direct,
            response_format=tool.response_format,
            tags=tool.tags,
            metadata=tool.metadata,
            callbacks=None,  # they hear of the tool's own run
            verbose=tool.verbose,
            handle_tool_error=not raises,
            handle_validation_error=tool.handle_validation_error,
            **more,
        )
        made._guard, made._injected, made._raises = guard, injected, raises
        made.func = made._annotated(tool)
        return made

    @functools.cached_property
    def _injected_args_keys(self) -> frozenset[str]:
        return self._injected

    def _run(
        self,
        *args: Any,
        config: RunnableConfig,
        run_manager: CallbackManagerForToolRun | None = None,
        **kwargs: Any,
    ) -> Any:
        child = None if run_manager is None else run_manager.get_child()
        with _told(raises=self._raises):
            written, beside = self._split(args, kwargs, config, child)
            found = self._guard.call(self.name, written, beside={_BESIDE: beside})
        return self._formed(found)

    async def _arun(
        self,
        *args: Any,
        config: RunnableConfig,
        run_manager: AsyncCallbackManagerForToolRun | None = None,
        **kwargs: Any,
    ) -> Any:
        child = None if run_manager is None else run_manager.get_child()
        with _told(raises=self._raises):
            written, beside = self._split(args, kwargs, config, child)
            found = await self._guard.acall(self.name, written, beside={_BESIDE: beside})
        return self._formed(found)

    def _split(
        self,
        args: tuple[Any, ...],
        kwargs: dict[str, Any],
        config: RunnableConfig,
        child: BaseCallbackManager | None,
    ) -> tuple[dict[str, Any], _LangChainContext]:
        """Return what is proposed, and what the tool is given beside it."""
        names = [name for name in self.args if name not in self._injected]
        given = {**dict(zip(names, args, strict=False)), **kwargs}
        written = {name: value for name, value in given.items() if name not in self._injected}
        injected = {name: value for name, value in given.items() if name in self._injected}
        try:
            plain = to_jsonable_python(written)
        except (PydanticSerializationError, ValueError, RecursionError) as error:
            raise undecided(MalformedError("expected JSON", where="arguments")) from error
        more: RunnableConfig = {**(config or {})}
        if child is not None:
            more["callbacks"] = child
        return plain, _LangChainContext(more, injected)

    def _formed(self, found: Any) -> Any:
        if self.response_format != "content_and_artifact":
            return found
        if isinstance(found, ToolMessage):
            return found.content, found.artifact
        return found, None

    def _annotated(self, tool: BaseTool) -> Callable[..., Any]:
        """Return a function that goes through the guard, with the annotations of the tool's own."""

        def asked(*args: Any, **kwargs: Any) -> Any:
            return self._run(*args, config={}, **kwargs)

        own = getattr(tool, "func", None) or getattr(tool, "coroutine", None)
        with suppress(NameError, TypeError):  # nothing can be read of it
            asked.__annotations__ = get_type_hints(own, include_extras=True)
        asked.__name__, asked.__doc__ = tool.name, tool.description
        return asked


@contextmanager
def _told(*, raises: bool) -> Iterator[None]:
    """Make what a guard raises an error of the tool, which a model can read and go by."""
    try:
        yield
    except (NotDone, AuthGuardError) as error:
        if raises:
            raise
        raise ToolException(str(error)) from error


def _guarded(guard: GateGuard, tool: BaseTool, *, raises: bool) -> BaseTool:
    injected = _injected_of(tool)
    clash = sorted(injected & guard.decided(tool.name))
    if clash:
        raise MalformedError(
            f"expected a binding without `{clash[0]}`: it is injected past the planner",
            where=tool.name,
        )
    # what it would make of its errors is made here, so that the gate hears of them as errors
    own = tool.model_copy(update={"handle_tool_error": False, "handle_validation_error": False})
    handler = tool.handle_tool_error

    def call(*, authguard_beside: _LangChainContext | None = None, **arguments: Any) -> Any:
        given, config = _call_of(own, arguments, authguard_beside)
        try:
            return _checked(own.invoke(given, config))
        except ToolException as error:
            raise _handled(error, handler) from error

    async def acall(*, authguard_beside: _LangChainContext | None = None, **arguments: Any) -> Any:
        given, config = _call_of(own, arguments, authguard_beside)
        try:
            return _checked(await own.ainvoke(given, config))
        except ToolException as error:
            raise _handled(error, handler) from error

    guard.register(
        tool.name,
        call if _is_called(tool) else None,
        coroutine=acall if _is_awaited(tool) else None,
        words=_words,
        fields=_fields,
    )
    return GuardedTool.of(guard, tool, injected, raises=raises)


def _injected_of(tool: BaseTool) -> frozenset[str]:
    """Return the arguments of a tool that a model is not shown: the framework gives them."""
    # the framework's own reading; before 1.0 the schema alone says it
    found = set(getattr(tool, "_injected_args_keys", ()))
    if tool.args_schema is not None and not isinstance(tool.args_schema, dict):
        found |= get_fields(tool.args_schema).keys() - tool.args.keys()
    return frozenset(found)


def _is_called(tool: BaseTool) -> bool:
    return not isinstance(tool, StructuredTool | Tool) or tool.func is not None


def _is_awaited(tool: BaseTool) -> bool:
    if isinstance(tool, StructuredTool | Tool):
        return tool.coroutine is not None
    return type(tool)._arun is not BaseTool._arun  # noqa: SLF001 - overridden, it awaits by itself


def _call_of(
    tool: BaseTool, arguments: dict[str, Any], beside: _LangChainContext | None
) -> tuple[dict[str, Any], RunnableConfig]:
    """Return how a tool is invoked: as a model's call where only that keeps its artifact."""
    injected = {} if beside is None else beside.injected
    config: RunnableConfig = {} if beside is None else beside.config
    given = {**injected, **arguments}
    call = _call_id(tool, injected)
    if call is None and tool.response_format != "content_and_artifact":
        return given, config
    call = call or f"call-{uuid4().hex}"
    return {"type": "tool_call", "id": call, "name": tool.name, "args": given}, config


def _call_id(tool: BaseTool, injected: dict[str, Any]) -> str | None:
    """Return the number of the model's call, where the tool wants to know it."""
    schema = tool.args_schema
    fields = {} if schema is None or isinstance(schema, dict) else get_fields(schema)
    for name, value in injected.items():
        marks = getattr(fields.get(name), "metadata", ())
        if name == "tool_call_id" or any(_marks_call(mark) for mark in marks):
            return str(value)
    return None


def _marks_call(mark: Any) -> bool:
    return mark is InjectedToolCallId or isinstance(mark, InjectedToolCallId)


def _checked(found: Any) -> Any:
    """Return what a tool returned, unless it says of itself that it is an error."""
    if isinstance(found, ToolMessage) and found.status == "error":
        raise ToolException(" ".join(_words(found)))
    return found


def _handled(error: ToolException, handler: Any) -> ToolException:
    """Return an error as the tool's own handler words it for a model."""
    if callable(handler):
        return ToolException(handler(error))
    return ToolException(handler) if isinstance(handler, str) else error


def _words(value: Any) -> Iterable[str]:
    """Yield every word of what a tool returned that a model could read: no artifact is one."""
    if isinstance(value, BaseMessage):
        yield from _words(value.content)
    elif isinstance(value, dict):
        for name, item in value.items():
            yield str(name)
            yield from _words(item)
    elif isinstance(value, list | tuple):
        for item in value:
            yield from _words(item)
    elif hasattr(value, "update") and hasattr(value, "goto"):  # a command to a graph
        yield from _words(value.update)
    else:
        yield from words_of(value)


def _fields(value: Any) -> Any:
    """Return what a tool returned as fields by name; a message's are its text's."""
    if not isinstance(value, ToolMessage):
        return fields_of(value)
    try:
        found = json.loads(value.content) if isinstance(value.content, str) else None
    except (ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) else None
