# SPDX-License-Identifier: Apache-2.0
"""A template as it is signed, and where a hole may stand in it.

A hole stands for one identifier or one integer, never for a part of a mission's shape: which grants
there are, with which tools, how often, in which order and who must approve stands in the template
alone. Spec page: docs/spec/template.md
"""

from __future__ import annotations

from collections.abc import Iterator
from enum import StrEnum
from math import prod
from typing import TYPE_CHECKING, Annotated, Any, Literal, NewType, cast

from msgspec import Meta, Struct

from authguard_r.core import identifiers as ids
from authguard_r.core.errors import MalformedError
from authguard_r.core.mission import Rate
from authguard_r.core.quantities import to_ms
from authguard_r.core.reasons import Reason

#: Most combinations of values: each of them is held to the schema and shown before signing.
MAX_COMBINATIONS = 4_096
#: Deepest nesting of a template's mission; a mission needs seven.
MAX_DEPTH = 12
#: No dot, so that `TEMPLATE.` begins the missions of one template only; short enough for them.
TEMPLATE_ID = r"\A[a-z0-9][a-z0-9_:-]{0,39}\Z"
#: What an instance says, or a fixed rule; a template that says it too would have two answers.
BY_INSTANCE = frozenset({"mid", "version", "supersedes", "nonce", "not_before", "expiry"})

#: Longest validity of one mission, a leap year in milliseconds, and most missions in one window.
MAX_FOR_MS, MAX_RATE = 31_622_400_000, 1_000

if TYPE_CHECKING:  # checkers want plain types below `NewType`; msgspec wants the patterns
    _Name = str
else:
    _Name = Annotated[str, Meta(pattern=TEMPLATE_ID)]
TemplateId = NewType("TemplateId", _Name)
HoleName = NewType("HoleName", ids.Identifier)
Value = ids.Identifier | ids.Integer
#: Names and numbers from the mission's root to a value; numbers are written as -1 in rules.
Path = tuple[str | int, ...]


class HoleKind(StrEnum):
    """What the values of a hole are, and so where it may stand."""

    OBJECT = "object"
    REGION = "region"
    INTEGER = "integer"


class _SignedTemplate(
    Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True
):
    """The manner of every signed struct: closed, immutable, one spelling."""


class Hole(_SignedTemplate, frozen=True, kw_only=True):
    """A name for one value of a finite set.

    Args:
        kind: what the values are.
        values: all of them, sorted, each once.
    """

    kind: HoleKind
    values: Annotated[tuple[Value, ...], Meta(min_length=1, max_length=256)]


class Template(_SignedTemplate, frozen=True, kw_only=True):
    """What an operator signs once for many missions.

    Args:
        schema: version of this language.
        template: its name; the missions of its instances are called `NAME.something`.
        mission: a mission as plain data, without what an instance says; `{"hole": NAME}` stands
            where a single value does, and `task` may be a list of texts and holes.
        holes: every hole with its values.
        instances: most missions that a gate ever makes of it.
        rate: most missions in a window of the gate's monotonic clock.
        for_ms: longest validity of one mission, in milliseconds.
        not_after: no mission of it is valid later.
    """

    schema: Literal["authguard-r/template/1"]
    template: TemplateId
    mission: dict[str, Any]
    holes: dict[HoleName, Hole]
    instances: ids.Positive
    rate: Rate
    for_ms: Annotated[int, Meta(ge=1, le=MAX_FOR_MS)]
    not_after: ids.Timestamp


_GUARDED = (HoleKind.OBJECT, HoleKind.REGION, HoleKind.INTEGER)
_ROW: Path = ("actions", -1, "alternatives", -1)
#: Every place where a hole may stand, with the kinds that may.
PLACES: dict[Path, tuple[HoleKind, ...]] = {
    ("task", -1): _GUARDED,
    ("objects", -1): (HoleKind.OBJECT,),
    ("regions", -1): (HoleKind.REGION,),
    ("limits", -1, "low"): (HoleKind.INTEGER,),
    ("limits", -1, "high"): (HoleKind.INTEGER,),
    ("guards", -1, "value"): _GUARDED,
    (*_ROW, "object"): (HoleKind.OBJECT,),
    (*_ROW, "source"): (HoleKind.REGION,),
    (*_ROW, "destination"): (HoleKind.REGION,),
    (*_ROW, "regions", -1): (HoleKind.REGION,),
    ("actions", -1, "limits", -1, "low"): (HoleKind.INTEGER,),
    ("actions", -1, "limits", -1, "high"): (HoleKind.INTEGER,),
    ("actions", -1, "guards", -1, "value"): _GUARDED,
    ("actions", -1, "done_when", -1, "value"): _GUARDED,
}
#: Lists that are sets: they are sorted once they are filled.
SETS: frozenset[Path] = frozenset({("objects",), ("regions",), (*_ROW, "regions")})


def require_sound(template: Template) -> None:
    """Hold a decoded template to the rules that its types cannot express, for all of its values.

    That a combination is a schema-valid mission is held when it is filled (`expansion.expand`).

    Raises:
        MalformedError: with reason `SCHEMA_INVALID` and the place of the first fault.
    """
    for place, fault in _faults(template):
        raise MalformedError(fault, where=place, reason=Reason.SCHEMA_INVALID)


def hole_of(value: object) -> HoleName | None:
    """Return the name of the hole that a value is, None when it is no hole."""
    if not isinstance(value, dict) or set(value) != {"hole"}:
        return None
    name = cast("dict[str, object]", value)["hole"]
    return HoleName(name) if isinstance(name, str) else None


def rule_of(path: Path) -> Path:
    """Return a path with every number as the -1 of the rules."""
    return tuple(-1 if isinstance(step, int) else step for step in path)


def place_of(path: Path) -> str:
    """Return a path as places are written: `mission.actions[1].alternatives[0].object`."""
    return "mission" + "".join(f"[{s}]" if isinstance(s, int) else f".{s}" for s in path)


def holes_in(template: Template) -> Iterator[tuple[Path, HoleName]]:
    """Yield every place of a hole, in the order of the mission's sorted fields."""
    for path, value in _leaves(template.mission, ()):
        name = hole_of(value)
        if name is not None:
            yield path, name


def _faults(template: Template) -> Iterator[tuple[str, str]]:
    for name, hole in template.holes.items():
        yield from _hole_faults(f"holes.{name}", hole)
    count = prod(len(hole.values) for hole in template.holes.values())
    if count > MAX_COMBINATIONS:
        yield "holes", f"expected at most {MAX_COMBINATIONS} combinations, got {count}"
    if template.rate.count > MAX_RATE:
        yield "rate.count", f"expected at most {MAX_RATE}"
    to_ms(template.not_after, where="not_after")
    for field in sorted(BY_INSTANCE.intersection(template.mission)):
        yield f"mission.{field}", "expected to be left to the instance"
    yield from _task_faults(template.mission.get("task"))
    used: set[HoleName] = set()
    for path, value in _leaves(template.mission, ()):
        named = hole_of(value)
        if named is not None:
            used.add(named)
            yield from _place_faults(template, path, named)
        elif not isinstance(value, str | bool | int):
            yield place_of(path), "expected text, an integer or a truth value"
    for name in sorted(set(template.holes).difference(used)):
        yield f"holes.{name}", "expected a hole that stands somewhere"


def _hole_faults(place: str, hole: Hole) -> Iterator[tuple[str, str]]:
    wanted = int if hole.kind is HoleKind.INTEGER else str
    if any(not isinstance(value, wanted) for value in hole.values):
        yield f"{place}.values", f"expected values of the kind `{hole.kind}`"
    elif any(not low < high for low, high in zip(hole.values, hole.values[1:], strict=False)):  # type: ignore[operator]
        yield f"{place}.values", "expected a sorted set without repeats"


def _task_faults(task: object) -> Iterator[tuple[str, str]]:
    """Yield parts of a task that are neither text nor a hole: there is one way to join them."""
    for number, part in enumerate(cast("list[object]", task) if isinstance(task, list) else ()):
        if not isinstance(part, str) and hole_of(part) is None:
            yield f"mission.task[{number}]", "expected text or a hole"


def _place_faults(template: Template, path: Path, name: HoleName) -> Iterator[tuple[str, str]]:
    hole, kinds = template.holes.get(name), PLACES.get(rule_of(path))
    if hole is None:
        yield place_of(path), f"expected a hole of this template, got `{name}`"
    elif kinds is None:
        yield place_of(path), "expected a value: no hole may stand here"
    elif hole.kind not in kinds:
        yield place_of(path), f"expected a hole of the kind {' or '.join(kinds)}"


def _leaves(value: object, path: Path) -> Iterator[tuple[Path, object]]:
    """Yield holes and everything that is neither list nor object; too deep is a leaf too."""
    if hole_of(value) is not None or len(path) > MAX_DEPTH:
        yield path, value
    elif isinstance(value, dict):
        for key, item in sorted(cast("dict[str, object]", value).items()):
            yield from _leaves(item, (*path, key))
    elif isinstance(value, list):
        for number, item in enumerate(cast("list[object]", value)):
            yield from _leaves(item, (*path, number))
    else:
        yield path, value
