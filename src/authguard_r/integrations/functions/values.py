# SPDX-License-Identifier: Apache-2.0
"""What goes into a proposal, and the words of what a function returned.

Spec page: docs/spec/adapters.md#values
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import msgspec

from authguard_r.core.errors import MalformedError

#: Deepest nesting of an argument.
MAX_DEPTH = 32
#: Returns every word of a value that a model could read.
Words = Callable[[Any], Iterable[str]]
#: Returns a value as fields by name; None when it has none.
Fields = Callable[[Any], Any]


def plain(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Return arguments as JSON has them.

    Raises:
        MalformedError: with the place of what has no JSON.
    """
    found: dict[str, Any] = _plain(arguments, "arguments", 0)
    return found


def _plain(value: Any, where: str, depth: int) -> Any:
    if depth > MAX_DEPTH:
        raise MalformedError(f"expected at most {MAX_DEPTH} levels", where=where)
    if value is None or isinstance(value, bool):
        return value
    if isinstance(value, str):
        return _text(value, where)
    if isinstance(value, int):
        return int(value)
    if isinstance(value, float):
        if not math.isfinite(value):
            raise MalformedError("expected a finite number", where=where)
        return float(value)
    if isinstance(value, list | tuple):
        return [_plain(item, f"{where}[{at}]", depth + 1) for at, item in enumerate(value)]
    if isinstance(value, Mapping):
        if not all(isinstance(name, str) for name in value):
            raise MalformedError("expected names as keys", where=where)
        return {
            _text(name, where): _plain(item, f"{where}.{name}", depth + 1)
            for name, item in value.items()
        }
    raise MalformedError(f"expected JSON, got `{type(value).__name__}`", where=where)


def _text(value: str, where: str) -> str:
    try:
        value.encode()
    except UnicodeEncodeError as error:
        raise MalformedError("expected text", where=where) from error
    return str.__str__(value)


def words_of(value: Any) -> tuple[str, ...]:
    """Return every word of what a function returned, in the forms that a model may be shown.

    Raises:
        Exception: what the value's own code raises.
    """
    if value is None:
        return ("",)
    if isinstance(value, str):
        return (value,)
    dump = getattr(value, "model_dump_json", None)
    try:
        written = dump() if callable(dump) else msgspec.json.encode(value, enc_hook=str).decode()
    except (TypeError, ValueError, RecursionError, OverflowError):
        return (str(value),)
    return tuple(dict.fromkeys((str(written), str(value))))


def fields_of(value: Any) -> Any:
    """Return what a function returned as fields by name; None when it has none."""
    dump = getattr(value, "model_dump", None)
    try:
        found = dump(mode="json") if callable(dump) else msgspec.to_builtins(value, enc_hook=str)
    except (TypeError, ValueError, RecursionError, OverflowError):
        return None
    return found if isinstance(found, dict) else None


def sendable(texts: Iterable[str]) -> tuple[str, ...]:
    """Return texts as they can be sent: without half characters."""
    return tuple(text.encode(errors="replace").decode() for text in texts) or ("",)


def is_lazy(value: Any) -> bool:
    """True of a value whose work is still to be done, past every gate."""
    return inspect.isawaitable(value) or inspect.isgenerator(value) or inspect.isasyncgen(value)
