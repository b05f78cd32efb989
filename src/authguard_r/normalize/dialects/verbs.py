# SPDX-License-Identifier: Apache-2.0
"""Plans of fixed verbs: household steps (`find Mug`) and driving maneuvers (`1. accelerate`).

There is no grammar to guess at: a line is a verb of the list and its names, or the whole plan is
refused. Verbs are recognized by exact spelling, as by their executors. Spec page:
docs/spec/normalize.md#dialects
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from typing import Any

from msgspec import Struct

from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.normalize.dialects.call import Call, expect, numbered

_NUMBERED = re.compile(r"([1-9][0-9]{0,5})[.)] ")
#: The number of a further step, within one.
_INNER = re.compile(r"(?<=[^0-9])[0-9]{1,6}[.)] *[A-Za-z]")


class _Verb(Struct, frozen=True):
    """A canonical verb with the fewest and the most names it takes."""

    tool: str
    low: int = 1
    high: int = 1


_BREAK, _DROP, _EMPTY = _Verb("break"), _Verb("drop", 0), _Verb("empty_liquid")
_FILL, _OFF, _ON = _Verb("fill_liquid", 2, 2), _Verb("turn_off"), _Verb("turn_on")
_USE_UP = _Verb("use_up")
#: Every spelling of every step. One of two words never begins with one of a single word.
STEP_VERBS: dict[str, _Verb] = {
    **{
        word: _Verb(word)
        for word in ("clean", "close", "cook", "dirty", "find", "open", "pick", "put", "slice")
    },
    "break": _BREAK,
    "drop": _DROP,
    "pour": _Verb("pour", 0),
    "throw": _Verb("throw", 0),
    "turn_on": _ON,
    "turn on": _ON,
    "turn_off": _OFF,
    "turn off": _OFF,
    "fillLiquid": _FILL,
    "fill_liquid": _FILL,
    "fill liquid": _FILL,
    "emptyLiquid": _EMPTY,
    "empty_liquid": _EMPTY,
    "empty liquid": _EMPTY,
    "useUp": _USE_UP,
    "use_up": _USE_UP,
    "use up": _USE_UP,
}
#: The driving maneuvers; none takes a name.
DRIVE_VERBS: dict[str, _Verb] = {
    verb: _Verb(verb, 0, 0)
    for verb in ("accelerate", "decelerate", "stop", "turn_left", "turn_right")
}


def read_steps(text: str) -> tuple[Call, ...]:
    """Return the calls of household steps, one a line: all numbered from 1, or none.

    Raises:
        MalformedError: an unknown verb, names missing or too many, numbers out of order.
    """
    return tuple(_call(step, STEP_VERBS, where) for step, where in _lines(text, must_number=False))


def read_step_list(value: Any) -> tuple[Call, ...]:
    """Return the calls of a JSON list of household steps.

    Args:
        value: the list as strict JSON spells it; untrusted.

    Raises:
        MalformedError: not a list of strings, an unknown verb, names missing or too many.
    """
    items = expect(value, list, "input")
    places = [f"input[{number}]" for number in range(len(items))]
    lines = [(expect(item, str, where), where) for item, where in zip(items, places, strict=True)]
    return tuple(_call(step, STEP_VERBS, where) for step, where in _steps(lines, must_number=False))


def read_dolphins(text: str) -> tuple[Call, ...]:
    """Return the calls of a numbered list of driving maneuvers.

    Raises:
        MalformedError: an unknown verb, a line without its number, numbers out of order.
    """
    return tuple(_call(step, DRIVE_VERBS, where) for step, where in _lines(text, must_number=True))


def begins_with_step(text: str) -> bool:
    """Return whether the first line begins with a step verb."""
    return _verb(_first(text), STEP_VERBS) is not None


def begins_with_maneuver(text: str) -> bool:
    """Return whether the first line begins with a driving maneuver."""
    return _verb(_first(text), DRIVE_VERBS) is not None


def _first(text: str) -> list[str]:
    line = text.lstrip(" \t\r\n").split("\n", 1)[0].rstrip(" \t\r")
    return _NUMBERED.sub("", line, count=1).split(" ")


def _lines(text: str, *, must_number: bool) -> Iterator[tuple[str, str]]:
    """Yield each step of a text without its number, and its place; empty lines are none."""
    lines = ((line.strip(" \t\r"), f"line[{n}]") for n, line in enumerate(text.split("\n"), 1))
    return _steps((line for line in lines if line[0]), must_number=must_number)


def _steps(lines: Iterable[tuple[str, str]], *, must_number: bool) -> Iterator[tuple[str, str]]:
    """Yield each step without its number, and its place; a gap in the numbers is a lost step."""
    counted: bool | None = True if must_number else None
    for count, (step, where) in enumerate(lines, 1):
        mark = _NUMBERED.match(step)
        counted = mark is not None if counted is None else counted
        if (int(mark[1]) if mark is not None else None) != (count if counted else None):
            expected = f"the number `{count}.`" if counted else "no number"
            raise MalformedError(f"expected {expected} before the step", where=where)
        if _INNER.search(step, mark.end() if mark is not None else 0):
            raise MalformedError("expected each step on a line of its own", where=where)
        yield step[mark.end() if mark is not None else 0 :], where


def _call(step: str, verbs: dict[str, _Verb], where: str) -> Call:
    words = step.split(" ")
    found = _verb(words, verbs)
    if found is None:
        raise MalformedError(
            f"expected a verb of the dialect, got `{ascii(step)[1:-1][:80]}`",
            where=where,
            reason=Reason.TOOL_UNKNOWN,
        )
    verb, names = verbs[found], words[found.count(" ") + 1 :]
    if not all(word and word.isprintable() for word in names):
        raise MalformedError("expected names of printable words, one space apart", where=where)
    if verb.high > 1 and len(names) > 1:
        names = [" ".join(names[:-1]), names[-1]]  # a liquid is one word
    elif names:
        names = [" ".join(names)]
    if not verb.low <= len(names) <= verb.high:
        expected = f"{verb.low}" if verb.low == verb.high else f"{verb.low} to {verb.high}"
        raise MalformedError(f"expected {expected} names, got {len(names)}", where=where)
    return Call(verb.tool, numbered(names), where)


def _verb(words: list[str], verbs: dict[str, _Verb]) -> str | None:
    return next((v for v in (" ".join(words[:2]), words[0]) if v in verbs), None)
