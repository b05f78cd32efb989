# SPDX-License-Identifier: Apache-2.0
"""Which dialect a plan is written in: the one that fits, or none.

A plan's dialect is recognized by its shape alone: its first words, or the keys of its outermost
object. Text in JSON is parsed once. Where several dialects claim a shape, each of them reads it:
one that refuses does not fit, and two that fit must have read the very same calls. Spec page:
docs/spec/normalize.md#auto
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

from msgspec import Struct

from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.normalize.dialects.call import Call, Dialect
from authguard_r.normalize.dialects.plain import read_bare, read_call_text
from authguard_r.normalize.dialects.python_code import (
    read_badrobot,
    read_badrobot_reply,
    read_code,
    read_go2,
)
from authguard_r.normalize.dialects.rosbridge import read_ros2
from authguard_r.normalize.dialects.spine import LIST, read_spine, read_spine_reply
from authguard_r.normalize.dialects.tool_use import read_anthropic, read_mcp, read_openai
from authguard_r.normalize.dialects.verbs import (
    begins_with_maneuver,
    begins_with_step,
    read_dolphins,
    read_step_list,
    read_steps,
)
from authguard_r.normalize.parse import read_json

#: The readers of plain data, for plans that are written in JSON.
_OF_JSON: dict[Dialect, Callable[[Any], tuple[Call, ...]]] = {
    Dialect.OPENAI: read_openai,
    Dialect.ANTHROPIC: read_anthropic,
    Dialect.MCP: read_mcp,
    Dialect.ROS2: read_ros2,
    Dialect.BADROBOT: read_badrobot_reply,
    Dialect.SPINE: read_spine_reply,
    Dialect.STEPS: read_step_list,
    Dialect.JSON: read_bare,
}
#: The readers of text, for dialects that are not always written in JSON.
_OF_TEXT: dict[Dialect, Callable[[str], tuple[Call, ...]]] = {
    Dialect.CALLS: read_call_text,
    Dialect.PYTHON: read_code,
    Dialect.BADROBOT: read_badrobot,
    Dialect.SPINE: read_spine,
    Dialect.GO2: read_go2,
    Dialect.DOLPHINS: read_dolphins,
}
#: The key by which an object claims a dialect.
_KEYS: tuple[tuple[str, Dialect], ...] = (
    ("choices", Dialect.OPENAI),
    ("stop_reason", Dialect.ANTHROPIC),
    ("jsonrpc", Dialect.MCP),
    ("op", Dialect.ROS2),
    ("function", Dialect.BADROBOT),
    ("tool", Dialect.JSON),
)
#: The dialects of which a list of objects may be.
_LISTED = frozenset({Dialect.MCP, Dialect.ROS2, Dialect.JSON})
_SPACE = " \t\r\n"
_CALL = re.compile(r"[ \t\r\n]*[A-Za-z_][A-Za-z0-9_]*\(")
_CODE = re.compile(r"[ \t\r\n]*(?:#|[A-Za-z_][A-Za-z0-9_.]*\()")
_SINGLE = re.compile(r"[ \t\r\n]*\{[ \t\r\n]*'")


class PlanReading(Struct, frozen=True):
    """What a plan says, and in which dialect; never `auto`."""

    dialect: Dialect
    calls: tuple[Call, ...]


def read(text: str, dialect: Dialect) -> PlanReading:
    """Return what a plan says in a dialect, or in the one that fits.

    Args:
        text: what the planner wrote; untrusted.
        dialect: how to read it; `auto` finds out.

    Raises:
        MalformedError: broken, in no dialect, or in two that differ (`DIALECT_UNKNOWN`).
    """
    if dialect is Dialect.AUTO:
        return _recognized(text)
    if dialect is Dialect.STEPS:
        is_list = text.lstrip(_SPACE)[:1] == "["
        calls = read_step_list(read_json(text, where="input")) if is_list else read_steps(text)
    elif dialect in _OF_TEXT:
        calls = _OF_TEXT[dialect](text)
    else:
        calls = _OF_JSON[dialect](read_json(text, where="input"))
    return PlanReading(dialect, calls)


def _recognized(text: str) -> PlanReading:
    first = text.lstrip(_SPACE)[:1]
    if first not in {"{", "["}:
        return _of_words(text)
    if first == "[" and LIST.match(text):
        return read(text, Dialect.SPINE)
    if first == "{" and _SINGLE.match(text):
        return read(text, Dialect.BADROBOT)
    value = read_json(text, where="input")
    return _agreed(value, _claims(value))


def _of_words(text: str) -> PlanReading:
    """Read a plan that is not in JSON; by their first words, these dialects exclude each other.

    Everything that `calls` reads, `python` reads alike or not at all (a property test holds them to
    it), so the second is asked only where the first refuses.
    """
    if not text.strip(_SPACE):
        return PlanReading(Dialect.CALLS, ())
    if _CALL.match(text):
        try:
            return read(text, Dialect.CALLS)
        except MalformedError as error:
            return _code_or(error, text)
    if _CODE.match(text):
        return read(text, Dialect.PYTHON)
    if begins_with_step(text):
        return read(text, Dialect.STEPS)
    if begins_with_maneuver(text):
        return read(text, Dialect.DOLPHINS)
    at = len(text) - len(text.lstrip(_SPACE))
    raise _unknown("no dialect begins like this", f"input[{at}]")


def _code_or(error: MalformedError, text: str) -> PlanReading:
    try:
        return read(text, Dialect.PYTHON)
    except MalformedError:
        raise error from None


def _claims(value: Any) -> list[Dialect]:
    """Return the dialects that a JSON value may be in, by its outermost shape."""
    if isinstance(value, dict):
        found = [dialect for key, dialect in _KEYS if key in value]
        if "plan" in value:
            plan = value["plan"]
            rows = isinstance(plan, list) and bool(plan) and isinstance(plan[0], list)
            found.append(Dialect.SPINE if rows or isinstance(plan, str) else Dialect.JSON)
        return found if len(found) < 2 else list(dict.fromkeys(found))
    if value == []:
        return [Dialect.JSON]
    if isinstance(value, list) and isinstance(value[0], dict):
        keys = ((key, dialect) for key, dialect in _KEYS if dialect in _LISTED)
        return [dialect for key, dialect in keys if key in value[0]]
    return [Dialect.STEPS] if isinstance(value, list) and isinstance(value[0], str) else []


def _agreed(value: Any, claims: list[Dialect]) -> PlanReading:
    if not claims:
        raise _unknown("no dialect has such JSON", "input")
    if len(claims) == 1:
        return PlanReading(claims[0], _OF_JSON[claims[0]](value))
    fitting: list[PlanReading] = []
    refusals: list[MalformedError] = []
    for dialect in claims:
        try:
            fitting.append(PlanReading(dialect, _OF_JSON[dialect](value)))
        except MalformedError as error:
            refusals.append(error)
    if not fitting:
        raise refusals[0]
    for other in fitting[1:]:
        if _said(other) != _said(fitting[0]):
            raise _unknown(
                f"`{fitting[0].dialect}` and `{other.dialect}` differ; name one", "input"
            )
    return fitting[0]


def _said(reading: PlanReading) -> str:
    """Return the calls as text in which `1`, `1.0` and `True` are three things."""
    return repr([(call.tool, call.arguments) for call in reading.calls])


def _unknown(message: str, where: str) -> MalformedError:
    return MalformedError(message, where=where, reason=Reason.DIALECT_UNKNOWN)
