# SPDX-License-Identifier: Apache-2.0
"""What every dialect reads a plan into, and the two questions that all of them ask of a value.

A call is what the planner asked for, in the planner's own words: names are resolved and values
judged by the binding alone. Spec page: docs/spec/normalize.md#dialects
"""

from __future__ import annotations

from collections.abc import Set as AbstractSet
from enum import StrEnum
from typing import Any

from msgspec import Struct

from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.normalize.parse import MAX_CALLS


class Dialect(StrEnum):
    """How a plan is written; `auto` names the one that fits."""

    AUTO = "auto"
    OPENAI = "openai"
    ANTHROPIC = "anthropic"
    MCP = "mcp"
    JSON = "json"
    CALLS = "calls"
    PYTHON = "python"
    BADROBOT = "badrobot"
    SPINE = "spine"
    GO2 = "go2"
    DOLPHINS = "dolphins"
    STEPS = "steps"
    ROS2 = "ros2"


class Call(Struct, frozen=True):
    """One call of a planner.

    Args:
        tool: its external name, as the planner spelled it; untrusted.
        arguments: by external name, possibly nested; positional ones are called `1`, `2`, ...
            Numbers are `int` or exact `Decimal`, never floats. Untrusted.
        where: the place in the planner's text, for messages.
    """

    tool: str
    arguments: dict[str, Any]
    where: str


def expect(value: Any, kind: type[Any], where: str) -> Any:
    """Return the value when it is of the kind.

    Raises:
        MalformedError: it is of another, or absent.
    """
    if isinstance(value, kind):
        return value
    expected = {"dict": "an object", "list": "a list", "str": "a string"}[kind.__name__]
    raise MalformedError(f"expected {expected}", where=where)


def expect_fields(value: dict[str, Any], allowed: AbstractSet[str], where: str) -> None:
    """Refuse an object with a field that the dialect does not have.

    Raises:
        MalformedError: with the first such field as the place (`FIELD_UNKNOWN`).
    """
    if not value.keys() <= allowed:
        shown = ascii(min(value.keys() - allowed))[1:-1][:80]
        raise MalformedError(
            f"expected {_listed(allowed)} only, got `{shown}`",
            where=f"{where}.{shown}",
            reason=Reason.FIELD_UNKNOWN,
        )


def expect_few(count: int) -> None:
    """Refuse more calls than a plan may have.

    Raises:
        MalformedError: more than `MAX_CALLS` (`INPUT_TOO_LARGE`).
    """
    if count > MAX_CALLS:
        raise MalformedError(
            f"expected at most {MAX_CALLS} calls, got {count}",
            where="input",
            reason=Reason.INPUT_TOO_LARGE,
        )


def numbered(values: list[Any]) -> dict[str, Any]:
    """Return positional values under the names `1`, `2`, ..."""
    return {str(number): value for number, value in enumerate(values, 1)}


def _listed(names: AbstractSet[str]) -> str:
    return ", ".join(f"`{name}`" for name in sorted(names))
