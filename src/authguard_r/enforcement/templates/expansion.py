# SPDX-License-Identifier: Apache-2.0
"""From a template and values to the one mission that they mean, the same on every machine.

Filling puts values where holes stand, joins the task's parts, sorts the lists that are sets, and
adds what the instance says. Nothing else changes. Spec page: docs/spec/template.md#filling
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from itertools import product
from typing import Any, cast

import msgspec

from authguard_r.core.errors import MalformedError, RefusedError
from authguard_r.core.mission import Mission, require_schema
from authguard_r.core.quantities import to_ms, to_timestamp
from authguard_r.core.reasons import Reason
from authguard_r.enforcement.templates.template import (
    SETS,
    HoleName,
    Path,
    Template,
    Value,
    hole_of,
    rule_of,
)

Fill = Mapping[HoleName, Value]
#: What stands for the instance in the missions that a signer reads: no instant of theirs counts.
_SHOWN_FROM = "2000-01-01T00:00:00Z"


def combinations(template: Template) -> Iterator[dict[HoleName, Value]]:
    """Yield every combination of values, the first hole's values changing slowest."""
    names = sorted(template.holes)
    for values in product(*(template.holes[name].values for name in names)):
        yield dict(zip(names, values, strict=True))


def require_fill(template: Template, fill: Fill) -> None:
    """Refuse values that the template does not offer.

    Raises:
        RefusedError: a hole too many or too few (`SCHEMA_INVALID`), or a value outside its set
            (`VALUE_OUT_OF_RANGE`).
    """
    if set(fill) != set(template.holes):
        raise RefusedError(
            f"expected values for {_named(template.holes)}, got {_named(fill)}",
            reason=Reason.SCHEMA_INVALID,
            where="instance.fill",
        )
    for name, value in fill.items():
        if value not in template.holes[name].values:
            raise RefusedError(
                f"expected one of {_named(template.holes[name].values)}, got `{value}`",
                reason=Reason.VALUE_OUT_OF_RANGE,
                where=f"instance.fill.{name}",
            )


def _named(words: Iterable[object]) -> str:
    """Return names or values for people."""
    return ", ".join(f"`{word}`" for word in sorted(words, key=str)) or "none"


def expand(
    template: Template, fill: Fill, *, mid: str, nonce: str, not_before: str, expiry: str
) -> Mission:
    """Return the mission that a sound template means with these values.

    Args:
        template: sound (`require_sound`).
        fill: a value of its set for every hole (`require_fill`).
        mid: the mission's name.
        nonce: 22 characters of base64url.
        not_before: first second of validity.
        expiry: last instant of validity.

    Raises:
        MalformedError: this combination is no schema-valid mission (`SCHEMA_INVALID`).
    """
    said = {"mid": mid, "nonce": nonce, "not_before": not_before, "expiry": expiry, "version": 1}
    plain = {**cast("dict[str, Any]", _filled(template.mission, fill, ())), **said}
    try:
        mission = msgspec.convert(plain, Mission)
    except msgspec.ValidationError as error:
        text, _, place = str(error).partition(" - at ")
        where = "template.mission" + place.strip("`").removeprefix("$")
        raise MalformedError(
            f"{text[:1].lower()}{text[1:]}", where=where, reason=Reason.SCHEMA_INVALID
        ) from error
    require_schema(mission)
    return mission


def filled(template: Template, fill: Fill) -> Mission:
    """Return a combination as a signer reads it: as long as possible, without a name or a nonce.

    Raises:
        MalformedError: this combination is no schema-valid mission.
    """
    first, last = shown_window(template)
    return expand(
        template,
        fill,
        mid=f"{template.template}.instance",
        nonce="A" * 22,
        not_before=first,
        expiry=last,
    )


def shown_window(template: Template) -> tuple[str, str]:
    """Return a window of the longest validity that a mission of the template may have."""
    start = to_ms(_SHOWN_FROM, where="not_before")
    return _SHOWN_FROM, to_timestamp(start + template.for_ms)


def _filled(value: object, fill: Fill, path: Path) -> object:
    name = hole_of(value)
    if name is not None:
        return fill[name]
    if isinstance(value, dict):
        items = cast("dict[str, object]", value).items()
        return {key: _filled(item, fill, (*path, key)) for key, item in items}
    if not isinstance(value, list):
        return value
    listed = cast("list[object]", value)
    parts = [_filled(item, fill, (*path, number)) for number, item in enumerate(listed)]
    if path == ("task",):
        return "".join(str(part) for part in parts)
    # a set has one spelling for the same values; the schema refuses what cannot be sorted
    return sorted(parts, key=str) if rule_of(path) in SETS else parts
