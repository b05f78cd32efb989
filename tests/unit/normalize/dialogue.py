# SPDX-License-Identifier: Apache-2.0
"""One plan written in every dialect, so that a test can say a thing once and mean it thrice."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cache
from typing import Any

import pytest

from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.normalize import Binder, Dialect, Plan, read_plan
from fixtures import scenarios

#: A call: the tool's external name and its arguments.
Call = tuple[str, dict[str, Any]]


@cache
def binder() -> Binder:
    return Binder(scenarios.site(), scenarios.binding())


def as_json(*calls: Call) -> str:
    return json.dumps({"plan": [{"tool": tool, "arguments": args} for tool, args in calls]})


def as_openai(*calls: Call, **choice: Any) -> str:
    """A reply as a server sends it; keyword arguments replace fields of its one choice."""
    tool_calls = [
        {
            "id": f"call_{number}",
            "type": "function",
            "function": {"name": tool, "arguments": json.dumps(args)},
        }
        for number, (tool, args) in enumerate(calls)
    ]
    whole = {
        "index": 0,
        "message": {"role": "assistant", "content": None, "tool_calls": tool_calls},
        "finish_reason": "tool_calls",
        **choice,
    }
    return json.dumps({"id": "chatcmpl-1", "object": "chat.completion", "choices": [whole]})


def literal(value: Any) -> str:
    if isinstance(value, str):
        return f"'{value}'" if '"' in value else f'"{value}"'
    return json.dumps(value)


def as_calls(*calls: Call) -> str:
    """One call a line; only strings, numbers and truth values can be said."""
    return "\n".join(
        f"{tool}({', '.join(f'{name}={literal(value)}' for name, value in args.items())})"
        for tool, args in calls
    )


WRITERS: dict[Dialect, Callable[..., str]] = {
    Dialect.JSON: as_json,
    Dialect.OPENAI: as_openai,
    Dialect.CALLS: as_calls,
}


def name_place(dialect: Dialect, number: int, *calls: Call) -> str:
    """Return where the name of a call's tool stands."""
    found = place(dialect, number, *calls)
    if dialect is Dialect.JSON:
        return f"{found}.tool"
    return found.replace("arguments", "name") if dialect is Dialect.OPENAI else found


def place(dialect: Dialect, number: int, *calls: Call) -> str:
    """Return where the call stands in a plan written in the dialect."""
    if dialect is Dialect.JSON:
        return f"plan[{number}]"
    if dialect is Dialect.OPENAI:
        return f"choices[0].message.tool_calls[{number}].function.arguments"
    return f"input[{sum(len(as_calls(call)) + 1 for call in calls[:number])}]"


def read(text: str | bytes, dialect: Dialect = Dialect.AUTO) -> Plan:
    data = text if isinstance(text, bytes) else text.encode("utf-8", "surrogatepass")
    return read_plan(data, binder=binder(), dialect=dialect)


def refused(
    text: str | bytes, reason: Reason, where: str, dialect: Dialect = Dialect.AUTO
) -> MalformedError:
    """Assert that the whole text is refused for this reason in this place."""
    with pytest.raises(MalformedError) as caught:
        read(text, dialect)
    assert (caught.value.reason, caught.value.where) == (reason, where)
    return caught.value
