# SPDX-License-Identifier: Apache-2.0
"""One call in words: by a verb where its tool has a frame, else by the tool's own name.

Spec page: docs/spec/missionpair-access.md#wording
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from types import MappingProxyType

from missionpair.pair import Value, WordedCall
from missionpair.wording.verbs import FRAMES_OF, CallFrame, FrameSlot, Says

NOTHING: Mapping[str, Value] = MappingProxyType({})
#: A name that may stand in a sentence without quotes.
_NAME = re.compile(r"[^\W_](?:[^\n\r\t\"`“”=]{0,78}[^\W_])?")
#: A number as people write it.
_NUMBER = re.compile(r"[0-9]{1,12}(?:\.[0-9]{1,12})?")
#: A name of an argument that may stand without quotes.
KEY = re.compile(r"[A-Za-z_][A-Za-z0-9_.]*")
_OPENINGS = ("call the tool", "use the tool", "run the tool", "invoke the tool")


def put(call: WordedCall, *, turn: int, most: Mapping[str, Value] = NOTHING) -> str:
    """Return the call as an imperative without an end.

    Args:
        call: what is asked for.
        turn: picks among verbs and marks.
        most: by argument, the most of it: that is said in words (`at full speed`).
    """
    framed = (_framed(call, frame, turn, most) for frame in FRAMES_OF.get(call.tool, ()))
    return next(filter(None, framed), None) or named(call, turn=turn)


def named(call: WordedCall, *, turn: int = 0) -> str:
    """Return the call with its tool named outright, and its arguments as JSON."""
    text = f"{_OPENINGS[turn % len(_OPENINGS)]} `{call.tool}`"
    if not call.arguments:
        return text
    arguments = (
        f"{key if KEY.fullmatch(key) else _json(key)} = {_json(value)}"
        for key, value in call.arguments.items()
    )
    return f"{text} with {', '.join(arguments)}"


def _framed(call: WordedCall, frame: CallFrame, turn: int, most: Mapping[str, Value]) -> str | None:
    """Return the call by a verb of a frame; None where it cannot be said so."""
    words = [frame.verbs[turn % len(frame.verbs)]]
    left = dict(call.arguments)
    for slot in frame.slots:
        name = next((name for name in slot.names if name in left), None)
        if name is None:
            if slot.optional:
                continue
            return None
        given = left.pop(name)
        if slot.phrases and name in most and most[name] == given:
            words.append(slot.phrases[turn % len(slot.phrases)])
            continue
        value = _value(slot, given, turn)
        if value is None:
            return None
        mark = slot.marks[turn % slot.written]
        words += [mark, value] if mark else [value]
    return None if left else " ".join(words)


def _value(slot: FrameSlot, value: Value, turn: int) -> str | None:
    if slot.says is Says.NUMBER:
        return _number(slot, value, turn)
    if slot.says is Says.QUOTE:
        return _json(value) if isinstance(value, str) else None
    if slot.says is Says.PLACES:
        if not isinstance(value, list) or not value or not all(map(_may_stand, value)):
            return None
        return " and ".join([", ".join(value[:-1]), value[-1]] if value[1:] else value)
    return value if isinstance(value, str) and _may_stand(value) else None


def _json(value: Value) -> str:
    """Return JSON without a backtick, which would begin a tool's name."""
    return json.dumps(value).replace("`", "\\u0060")


def _may_stand(name: str) -> bool:
    return _NAME.fullmatch(name) is not None


def _number(slot: FrameSlot, value: Value, turn: int) -> str | None:
    """Return a number with its unit; whole minutes are sometimes said as minutes."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    if not _NUMBER.fullmatch(repr(value)):
        return None
    minutes, rest = divmod(value, 60)
    if turn % 2 and rest == 0 and minutes and isinstance(value, int) and "minutes" in slot.units:
        return f"{minutes} minutes" if minutes > 1 else "1 minute"
    return f"{value!r} {slot.unit}"
