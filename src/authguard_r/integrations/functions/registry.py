# SPDX-License-Identifier: Apache-2.0
"""Which functions are tools of the binding, and what an action is called among them.

Spec page: docs/spec/adapters.md#registering
"""

from __future__ import annotations

import inspect
import threading
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from msgspec.structs import replace

from authguard_r.core.action import Action
from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.integrations.functions.functions import Functions, FunctionTool
from authguard_r.integrations.functions.values import Fields, Words
from authguard_r.integrations.tools.endpoints import GateTarget
from authguard_r.normalize.binding import Argument, ArgumentUse, Binding, ways_of
from authguard_r.normalize.dialects import Call
from authguard_r.normalize.rebuild import Rebuilder

_BY_NAME = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)


class Registry:
    """The functions of one guard (a `tools.body.Rebuilds`).

    Args:
        place: whose tools they are.
        functions: where they are called.
    """

    def __init__(self, place: GateTarget, functions: Functions) -> None:
        self._place = place
        self._functions = functions
        self._stops = frozenset(call.tool for call in place.stops)
        self._rebuilder = Rebuilder(place.site, _only(place.binding, {}))
        self._lock = threading.Lock()

    @property
    def missing(self) -> tuple[str, ...]:
        """The tools of the binding without a function, by name."""
        return tuple(sorted(set(self._place.binding.tools) - set(self._functions.tools)))

    def rebuild(self, action: Action) -> Call:
        """Return the call of a registered function that carries an action out.

        Raises:
            MalformedError: the binding has no such tool.
        """
        return self._rebuilder.rebuild(action)

    def add(
        self,
        name: str,
        function: Callable[..., Any] | None,
        coroutine: Callable[..., Any] | None,
        words: Words,
        fields: Fields,
    ) -> None:
        """Register a function; errors as `Guard.register`'s."""
        if coroutine is None and is_awaited(function):
            function, coroutine = None, function
        signatures = [signature_of(f, name) for f in (function, coroutine) if f is not None]
        if not signatures:
            raise MalformedError("expected a function", where=name)
        tool = FunctionTool(
            name=name,
            function=function,
            coroutine=coroutine,
            signature=signatures[0],
            words=words,
            fields=fields,
        )
        if name in self._place.binding.tools:
            if not self._place.shadow:
                self._require_fitting(tool)
        elif name not in self._stops and not self._place.shadow:
            raise _unknown(f"expected a tool of the binding, got `{name}`")
        with self._lock:
            if name in self._functions.tools:
                raise MalformedError(f"expected one function for `{name}`, got another", where=name)
            tools = {**self._functions.tools, name: tool}
            self._rebuilder = Rebuilder(self._place.site, _only(self._place.binding, tools))
            self._functions.tools = tools

    def found(self, name: str, beside: Mapping[str, Any]) -> FunctionTool:
        """Return a tool that may be asked for.

        Args:
            name: its name.
            beside: what the program gives it beside what was decided.

        Raises:
            MalformedError: it has no function.
            TypeError: an argument that the gate decides on would be given beside it.
        """
        tool = self._functions.tools.get(name)
        if tool is None or not (self._place.shadow or name in self._place.binding.tools):
            raise _unknown(f"expected a registered function for `{name}`")
        decided = sorted(self.decided(name) & beside.keys())
        if decided:
            raise TypeError(
                f"`{decided[0]}` is decided by the gate and cannot be given as an argument"
            )
        return tool

    def decided(self, name: str) -> frozenset[str]:
        """Return the names of a tool's arguments, as the binding has them."""
        return frozenset(
            top
            for arguments, when in self._ways(name)
            for path in (*arguments, *when, *(also for a in arguments.values() for also in a.also))
            for top in (path.split(".")[0],)
        )

    def filled(self, name: str, arguments: Mapping[str, Any]) -> dict[str, Any]:
        """Return arguments with what the function would take for those that are left out.

        Only of arguments that the binding has; None is how Python leaves one out.
        """
        known = self.decided(name)
        return {
            **{
                parameter.name: parameter.default
                for parameter in self._functions.tools[name].signature.parameters.values()
                if parameter.name in known
                and parameter.default not in (parameter.empty, None)
                and parameter.name not in arguments
            },
            **arguments,
        }

    def _ways(self, name: str) -> Iterator[tuple[dict[str, Argument], dict[str, Any]]]:
        if name in self._place.binding.tools:
            for way in ways_of(self._place.binding, name):
                yield way.tool.arguments, way.tool.when

    def _require_fitting(self, tool: FunctionTool) -> None:
        """Require that the rebuilt call is one of the function.

        Raises:
            MalformedError: it takes another argument, or needs one that is never forwarded.
        """
        parameters = tool.signature.parameters.values()
        taken = {parameter.name for parameter in parameters}
        takes_any = any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters)
        for arguments, when in self._ways(tool.name):
            always = {path.split(".")[0] for path, a in arguments.items() if _always(a)}
            always |= {path.split(".")[0] for path in when}
            extra = sorted(always - taken)
            if extra and not takes_any:
                raise MalformedError(
                    f"expected a function that takes `{extra[0]}`: the binding forwards it",
                    where=tool.name,
                )
            kept = {path for path, a in arguments.items() if _never(a)}
            for parameter in parameters:
                if parameter.name in kept and parameter.default is parameter.empty:
                    raise MalformedError(
                        f"expected a function without `{parameter.name}`, or with a default for "
                        "it: the binding does not forward it",
                        where=tool.name,
                    )


def is_awaited(function: Callable[..., Any] | None) -> bool:
    """True of a function that does its work when it is awaited."""
    return inspect.iscoroutinefunction(function) or inspect.iscoroutinefunction(
        getattr(function, "__call__", None)  # noqa: B004 - an object whose call is one
    )


def signature_of(function: Callable[..., Any], name: str) -> inspect.Signature:
    """Return how a function is called that does its work at once.

    Raises:
        MalformedError: it is not valid, or its arguments have no names.
    """
    if not callable(function):
        raise MalformedError(f"expected a function, got `{type(function).__name__}`", where=name)
    if inspect.isgeneratorfunction(function) or inspect.isasyncgenfunction(function):
        raise MalformedError(
            "expected a function that does its work when it is called, got a generator", where=name
        )
    try:
        signature = inspect.signature(function)
    except (ValueError, TypeError) as error:
        raise MalformedError("expected a function with a signature", where=name) from error
    if any(one.kind is one.VAR_POSITIONAL for one in signature.parameters.values()):
        raise MalformedError("expected arguments with names, got `*`", where=name)
    return signature


def _only(binding: Binding, tools: Mapping[str, FunctionTool]) -> Binding:
    kept = {name: tool for name, tool in binding.tools.items() if name in tools}
    return replace(binding, tools=kept)


def _always(argument: Argument) -> bool:
    if argument.use is not ArgumentUse.MAPPED:
        return argument.constant() is not None
    return not argument.optional or argument.default is not None


def _never(argument: Argument) -> bool:
    return argument.use is not ArgumentUse.MAPPED and argument.constant() is None


def _unknown(message: str) -> MalformedError:
    return MalformedError(message, where="tool", reason=Reason.TOOL_UNKNOWN)
