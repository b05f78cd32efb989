# SPDX-License-Identifier: Apache-2.0
"""Whether a model's draft keeps what the operator settled, and that draft as plain data.

A proposer that is asked to keep an answer may keep another one. What cannot be found in the draft
counts as changed: the operator would sign what was never said.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from decimal import Decimal
from types import MappingProxyType
from typing import Any

from authguard_r.authoring.drafting.measures import Measure, read_measure_text
from authguard_r.authoring.drafting.tokens import tokenize
from authguard_r.core.errors import MalformedError

#: Fields of a draft that stand at its top and nowhere else.
_TOP = frozenset({"mission", "task", "robot", "issuer", "version", "supersedes", "place_max_age"})
#: Parts of a draft that there is one of: a path into them means one value.
_ONCE = frozenset({"window", "budgets", "risk_policy", "closing"})
#: How the end of validity is asked for, and where a draft may say it.
_ENDS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {"window": ("for", "expiry"), "window.for": ("for",), "window.expiry": ("expiry",)}
)


def holds(draft: Mapping[str, Any], field: str, value: str) -> bool:
    """True when the draft says for a field what was given for it.

    Args:
        draft: plain data in the draft format; untrusted.
        field: the field of a question: a path in the draft, or the slot of a step
            (`step2.destination`), which some part of the draft must then hold.
        value: what was given, as a person wrote it.
    """
    if field in _ENDS:
        return _window(draft.get("window"), _ENDS[field], value)
    if field in _TOP or field.partition(".")[0] in _ONCE:
        return _same(_at(draft, field), value)
    slot = field.rpartition(".")[2]
    rest = [(key, found) for key, found in _leaves(draft, "") if key not in _TOP]
    named = [found for key, found in rest if key in {slot, slot.rstrip("0123456789")}]
    return any(_same(found, value) for found in named or [found for _, found in rest])


def printed(value: Any) -> Any:
    """Return plain data with decimals as text: a number without a unit, to be asked about."""
    if isinstance(value, Decimal):
        return str(value)
    if isinstance(value, dict):
        return {key: printed(item) for key, item in value.items()}
    return [printed(item) for item in value] if isinstance(value, list) else value


def _at(draft: Mapping[str, Any], path: str) -> object:
    """Return what stands at a path; None where nothing does."""
    found: Any = draft
    for part in path.split("."):
        found = found.get(part) if isinstance(found, Mapping) else None
    return found


def _window(window: object, parts: tuple[str, ...], value: str) -> bool:
    """True for the length or the end that was given, and no other beside it."""
    if not isinstance(window, dict):
        return False
    ends = [part for part in _ENDS["window"] if part in window]
    return len(ends) == 1 and ends[0] in parts and _same(window[ends[0]], value)


def _leaves(value: Any, key: str) -> Iterator[tuple[str, Any]]:
    """Return every value that is no container, with the key that it stands under."""
    if isinstance(value, dict):
        for name, item in value.items():
            yield from _leaves(item, name)
    elif isinstance(value, list):
        for item in value:
            yield from _leaves(item, key)
    else:
        yield key, value


def _same(found: object, value: str) -> bool:
    """True for the same text, number or quantity; `yes` and `no` answer a truth value."""
    if isinstance(found, bool):
        return value.lower() in (("yes", "true") if found else ("no", "false"))
    text = str(found)
    if text == value:
        return True
    first, second = _measure(text), _measure(value)
    return first is not None and second is not None and _amount(first) == _amount(second)


def _measure(text: str) -> Measure | None:
    try:
        return read_measure_text(text, tokenize(text))
    except MalformedError:
        return None


def _amount(said: Measure) -> tuple[object, object]:
    return said.dimension, said.amount
