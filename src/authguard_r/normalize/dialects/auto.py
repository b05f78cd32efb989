# SPDX-License-Identifier: Apache-2.0
"""Which dialect a plan is written in: the one that fits, or none.

A plan's dialect is recognized by its shape alone: its first words, or the keys of its outermost
object. Text in JSON is parsed once. Where several dialects claim a shape, each of them reads it:
one that refuses does not fit, and two that fit must have read the very same calls. Spec page:
docs/spec/normalize.md#auto
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from msgspec import Struct

from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.normalize.dialects.call import Call, Dialect
from authguard_r.normalize.dialects.plain import (
    ReplyForm,
    read_bare,
    read_call_text,
    read_declared,
)
from authguard_r.normalize.dialects.python_code import (
    read_badrobot,
    read_badrobot_reply,
    read_code,
    read_go2,
)
from authguard_r.normalize.dialects.rosbridge import read_ros2
from authguard_r.normalize.dialects.servers import (
    read_bedrock,
    read_gemini,
    read_langchain,
    read_ollama,
)
from authguard_r.normalize.dialects.spine import LIST, read_spine, read_spine_reply
from authguard_r.normalize.dialects.templates import (
    TEMPLATES,
    TemplateReading,
    blank,
    fenced,
    read_pythonic,
    trimmed,
)
from authguard_r.normalize.dialects.tool_use import (
    read_anthropic,
    read_mcp,
    read_openai,
    read_responses,
)
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
    Dialect.RESPONSES: read_responses,
    Dialect.ANTHROPIC: read_anthropic,
    Dialect.GEMINI: read_gemini,
    Dialect.BEDROCK: read_bedrock,
    Dialect.OLLAMA: read_ollama,
    Dialect.LANGCHAIN: read_langchain,
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
#: The readers of text with tags around its calls, or of one list of them.
_OF_TEMPLATE: dict[Dialect, Callable[[str], TemplateReading]] = {
    Dialect.PYTHONIC: read_pythonic,
    **{dialect: reader for _, dialect, reader in TEMPLATES},
}
#: The key by which an object claims a dialect, and the kind of its value.
_KEYS: tuple[tuple[str, type[Any], Dialect], ...] = (
    ("choices", object, Dialect.OPENAI),
    ("output", list, Dialect.RESPONSES),
    ("stop_reason", object, Dialect.ANTHROPIC),
    ("candidates", object, Dialect.GEMINI),
    ("output", dict, Dialect.BEDROCK),
    ("done", bool, Dialect.OLLAMA),
    ("kwargs", dict, Dialect.LANGCHAIN),
    ("data", dict, Dialect.LANGCHAIN),
    ("jsonrpc", object, Dialect.MCP),
    ("op", object, Dialect.ROS2),
    ("function", list, Dialect.BADROBOT),
    ("tool", object, Dialect.JSON),
    ("name", object, Dialect.JSON),
)
_NAMES = frozenset(key for key, _, _ in _KEYS)
#: The dialects of which a list of objects may be.
_LISTED = frozenset({Dialect.MCP, Dialect.ROS2, Dialect.JSON})
_SPACE = " \t\r\n"
_CALL = re.compile(r"[ \t\r\n]*[A-Za-z_][A-Za-z0-9_]*\(")
_CODE = re.compile(r"[ \t\r\n]*(?:#|[A-Za-z_][A-Za-z0-9_.]*\()")
_DOTTED = re.compile(r"[ \t\r\n]*\[[ \t\r\n]*[A-Za-z_][A-Za-z0-9_.]*\(")
_QUOTED = re.compile(r"[=\"']")
_SINGLE = re.compile(r"[ \t\r\n]*\{[ \t\r\n]*'(?:function|response)'")
#: What `calls` refuses and code may have: arguments by their position.
_POSITIONAL = "expected `field=literal`"
#: How the languages of a fence are called that hold calls of Python.
_PYTHON = frozenset({"python", "py", "tool_code"})


class PlanReading(Struct, frozen=True):
    """What a plan says, and in which dialect; never `auto`.

    Args:
        dialect: in which the plan was read.
        calls: in order.
        around: what stood around the calls and was not looked at, for the record: `fence, 12
            characters before it`; empty: nothing did.
    """

    dialect: Dialect
    calls: tuple[Call, ...]
    around: str = ""


def read(text: str, dialect: Dialect, form: ReplyForm | None = None) -> PlanReading:
    """Return what a plan says in a dialect, or in the one that fits.

    Args:
        text: what the planner wrote; untrusted.
        dialect: how to read it; `auto` finds out.
        form: the reply's form that a binding declares.

    Raises:
        MalformedError: broken, in no dialect, or in two that differ (`DIALECT_UNKNOWN`).
    """
    text = trimmed(text)
    if dialect is Dialect.AUTO:
        return _unwrapped(text, form)
    if dialect in _OF_TEMPLATE:
        reply = _OF_TEMPLATE[dialect](text)
        return PlanReading(dialect, reply.calls, _around(dialect, reply.before, reply.after))
    if dialect is Dialect.STEPS:
        is_list = text.lstrip(_SPACE)[:1] == "["
        calls = read_step_list(read_json(text, where="input")) if is_list else read_steps(text)
    elif dialect in _OF_TEXT:
        calls = _OF_TEXT[dialect](text)
    else:
        calls = _of_json(dialect, read_json(text, where="input"), form)
    return PlanReading(dialect, calls)


def _of_json(dialect: Dialect, value: Any, form: ReplyForm | None) -> tuple[Call, ...]:
    if dialect is not Dialect.REPLY:
        return _OF_JSON[dialect](value)
    if form is None:
        raise _unknown("expected a binding that declares its `reply`", "dialect")
    return read_declared(value, form)


def _unwrapped(text: str, form: ReplyForm | None) -> PlanReading:
    """Read a plan out of the one thing that is wrapped around it, or as it stands."""
    begins = text.lstrip(_SPACE)
    if begins[:1] in {"{", "["} and not begins.startswith(("[TOOL_CALLS]", "[THINK]")):
        return _recognized(text, form)
    shown = [(tag, dialect) for tag, dialect, _ in TEMPLATES if tag in text]
    if "```" in text and not any(dialect is Dialect.DEEPSEEK for _, dialect in shown):
        shown.append(("```", Dialect.AUTO))
    if len(shown) > 1:
        tags = " and ".join(f"`{tag}`" for tag, _ in shown[:2])
        raise _unknown(f"expected one way to mark calls, got {tags}", "input")
    if not shown:
        thought, over, rest = text.partition("</think>")
        if not over or not begins.startswith("<think>"):
            return _recognized(text, form)
        if rest.lstrip(_SPACE)[:1] in {"{", "["}:
            rest = blank(thought + over) + rest
        reading = _recognized(rest, form)
        around = _around("think", len(thought.strip(_SPACE)) + len(over), 0)
        return PlanReading(reading.dialect, reading.calls, around)
    if _CODE.match(text):  # code, with a tag in a comment, says something by itself
        return _agreed([partial(_taken_out, text, shown[0][1], form), partial(_of_words, text)])
    return _taken_out(text, shown[0][1], form)


def _taken_out(text: str, dialect: Dialect, form: ReplyForm | None) -> PlanReading:
    """Read what stands in the tags of a dialect, or in a fence."""
    if dialect is not Dialect.AUTO:
        return read(text, dialect)
    inner, language, before, after = fenced(text)
    reading = read(inner, Dialect.PYTHON) if language in _PYTHON else _recognized(inner, form)
    return PlanReading(reading.dialect, reading.calls, _around("fence", before, after))


def _around(name: str, before: int, after: int) -> str:
    parts = ((before, "before"), (after, "after"))
    return ", ".join([name, *(f"{n} characters {place} it" for n, place in parts if n)])


def _recognized(text: str, form: ReplyForm | None) -> PlanReading:
    first = text.lstrip(_SPACE)[:1]
    if first not in {"{", "["}:
        return _of_words(text)
    if first == "[" and (LIST.match(text) or _DOTTED.match(text)):
        readers = [Dialect.SPINE, Dialect.PYTHONIC]
        if _QUOTED.search(text):  # its refusal is the one to show
            readers.reverse()
        return _agreed([partial(read, text, dialect) for dialect in readers])
    if first == "{" and _SINGLE.match(text):
        return read(text, Dialect.BADROBOT)
    value = read_json(text, where="input")
    claims = _claims(value, form)
    if not claims:
        text = "expected JSON in a known format, or as the binding declares it under `reply`"
        raise _unknown(text, "input")
    if len(claims) == 1:
        return _as(claims[0], value, form)
    return _agreed([partial(_as, dialect, value, form) for dialect in claims])


def _as(dialect: Dialect, value: Any, form: ReplyForm | None) -> PlanReading:
    return PlanReading(dialect, _of_json(dialect, value, form))


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
    except MalformedError as other:
        later = _POSITIONAL in error.message and not other.where.startswith("line[1]")
        raise other if later else error from None


def _claims(value: Any, form: ReplyForm | None) -> list[Dialect]:
    """Return the dialects that a JSON value may be in, by its outermost shape."""
    if value == []:
        return [Dialect.JSON]
    first = value[0] if isinstance(value, list) else value
    if isinstance(first, str) and first is not value:
        return [Dialect.STEPS]
    if not isinstance(first, dict):
        return []
    found = []
    if not _NAMES.isdisjoint(first):
        found = [d for key, kind, d in _KEYS if key in first and isinstance(first[key], kind)]
    if "tool_calls" in first:  # a stored message, which names its role or its type
        found.append(Dialect.OPENAI if "role" in first else Dialect.LANGCHAIN)
    if first is not value:
        found = [dialect for dialect in found if dialect in _LISTED]
    elif "plan" in value:
        plan = value["plan"]
        rows = isinstance(plan, list) and bool(plan) and isinstance(plan[0], list)
        found.append(Dialect.SPINE if rows or isinstance(plan, str) else Dialect.JSON)
    if form is not None and not {form.list, form.tool}.isdisjoint(first):
        found.insert(0, Dialect.REPLY)
    return list(dict.fromkeys(found))


def _agreed(readers: Sequence[Callable[[], PlanReading]]) -> PlanReading:
    """Return the one reading of those that claim a plan; two that fit must say the very same."""
    if len(readers) == 1:
        return readers[0]()
    fitting: list[PlanReading] = []
    refusals: list[MalformedError] = []
    for reader in readers:
        try:
            fitting.append(reader())
        except MalformedError as error:
            refusals.append(error)
    if not fitting:
        raise refusals[0]
    for other in fitting[1:]:
        if _said(other) != _said(fitting[0]):
            text = f"`{fitting[0].dialect}` and `{other.dialect}` differ; name one"
            raise _unknown(text, "input")
    return fitting[0]


def _said(reading: PlanReading) -> str:
    """Return the calls as text in which `1`, `1.0` and `True` are three things."""
    return repr([(call.tool, call.arguments) for call in reading.calls])


def _unknown(message: str, where: str) -> MalformedError:
    return MalformedError(message, where=where, reason=Reason.DIALECT_UNKNOWN)
