# SPDX-License-Identifier: Apache-2.0
"""From a template draft to a template: the mission's draft is compiled for every combination.

Where the compiled missions differ, one hole's values must stand, in every combination; else the
draft is refused. What comes out is filled again and compared with what the compiler said: the
derivation is trusted in nothing. How-to: docs/howto/templates.md
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from math import prod
from typing import Any, cast

import msgspec
from msgspec import Struct

from authguard_r.authoring.compile.answers import compile_plain
from authguard_r.authoring.compile.draft import DraftRate, Quantity
from authguard_r.authoring.compile.questions import CompileQuestions
from authguard_r.authoring.compile.units import to_integer
from authguard_r.core.encoding import encode
from authguard_r.core.errors import MalformedError
from authguard_r.core.mission import Mission
from authguard_r.core.quantities import Now, to_timestamp
from authguard_r.core.reasons import Reason
from authguard_r.enforcement.templates.expansion import combinations, filled, shown_window
from authguard_r.enforcement.templates.template import (
    BY_INSTANCE,
    MAX_COMBINATIONS,
    SETS,
    HoleName,
    Path,
    Template,
    Value,
    hole_of,
    place_of,
    require_sound,
    rule_of,
)
from authguard_r.site.model import Site
from authguard_r.site.strict import convert

#: `{station}` in a task; other braces are text.
_IN_TEXT = re.compile(r"\{([a-z0-9][a-z0-9_.:-]{0,63})\}")
_Spelled = dict[HoleName, dict[Value, Quantity]]
_Cases = list[tuple[dict[HoleName, Value], Any]]


class DraftHole(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A hole: what its values are, and all of them.

    Args:
        kind: `object`, `region` or `integer`.
        values: ids as the site's model has them; integers, or with `unit` quantities.
        unit: the unit that the template counts in; quantities are turned into it.
    """

    kind: str
    values: tuple[str | int, ...]
    unit: str | None = None


class TemplateDraft(
    Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, rename={"for_": "for"}
):
    """What a person writes: a mission draft with holes, and how far it may be used.

    Args:
        template: its name.
        mission: a mission draft without name, version and window; `{hole: NAME}` stands for a
            value, and `{NAME}` inside the task's text.
        holes: at least two values for each.
        instances: most missions ever.
        rate: most missions in a window.
        for_: longest validity of one mission.
        lasts: how long missions may be made of it, from the moment of compiling; or
        not_after: the last instant.
    """

    template: str
    mission: dict[str, Any]
    holes: dict[str, DraftHole] = {}
    instances: int | None = None
    rate: DraftRate = DraftRate()
    for_: Quantity | None = None
    lasts: Quantity | None = None
    not_after: str | None = None


def compile_template(plain: object, site: Site, *, now: Now) -> Template:
    """Return the template that a draft means at this site.

    Args:
        plain: as read from YAML; trusted in nothing.
        site: gives the words their meaning.
        now: the instant from which `lasts` counts.

    Raises:
        ClarificationError: what only a person can say, every question at once.
        MalformedError: not a draft, or one whose missions differ otherwise than by its holes.
    """
    draft = convert(plain, TemplateDraft, where="draft")
    spelled = {HoleName(name): _spelled(name, hole) for name, hole in draft.holes.items()}
    said = _said(draft, spelled, now)
    cases = _compiled(draft, said, spelled, site)
    mission = {
        name: _derived([(fill, case[name]) for fill, case in cases], (name,))
        for name in cases[0][1]
        if name not in BY_INSTANCE and name != "task"
    }
    mission["task"] = _task(draft)
    template = convert({**said, "mission": mission}, Template, where="draft")
    require_sound(template)
    for fill, case in cases:
        if _plain(filled(template, fill)) != case:  # pragma: no cover - derived place by place
            raise MalformedError("its missions differ by more than its holes", where="draft")
    return template


def template_bytes(template: Template) -> bytes:
    """Return the canonical bytes, with a final newline for files."""
    return encode(template) + b"\n"


def _spelled(name: str, hole: DraftHole) -> dict[Value, Quantity]:
    """Return each value as the template has it, with its spelling in the draft."""
    if hole.unit is None:
        return {value: value for value in hole.values}
    where = f"holes.{name}.values"
    return {to_integer(value, hole.unit, where=where): value for value in hole.values}


def _said(draft: TemplateDraft, spelled: _Spelled, now: Now) -> dict[str, Any]:
    """Return everything but the mission; every question is asked at once."""
    asked = CompileQuestions()
    instances = asked.given(draft.instances, "How many missions may be made of it?", "instances")
    count = asked.given(draft.rate.count, "How many missions in a while?", "rate.count")
    per_ms = asked.integer(draft.rate.per, "ms", field="rate.per")
    for_ms = asked.integer(draft.for_, "ms", field="for")
    not_after = draft.not_after
    if not_after is None:
        lasts = asked.integer(
            draft.lasts, "ms", field="lasts", question="How long may missions be made of it?"
        )
        not_after = None if lasts is None else _later(now, lasts)
    elif draft.lasts is not None:
        raise MalformedError("expected `lasts` or `not_after`", where="not_after")
    asked.require_none()
    holes = {
        name: {"kind": hole.kind, "values": sorted(spelled[HoleName(name)], key=_by_kind)}
        for name, hole in draft.holes.items()
    }
    return {
        "schema": "authguard-r/template/1",
        "template": draft.template,
        "holes": holes,
        "instances": instances,
        "rate": {"count": count, "per_ms": per_ms},
        "for_ms": for_ms,
        "not_after": not_after,
    }


def _by_kind(value: str | int) -> tuple[bool, int, str]:
    return isinstance(value, str), 0 if isinstance(value, str) else value, str(value)


def _later(now: Now, length_ms: int) -> str:
    try:
        return to_timestamp(now.utc_ms + length_ms)
    except (OverflowError, ValueError) as error:
        raise MalformedError("expected an instant before the year 10000", where="lasts") from error


def _compiled(draft: TemplateDraft, said: dict[str, Any], spelled: _Spelled, site: Site) -> _Cases:
    """Return the mission of every combination as plain data, compiled like any other draft."""
    count = prod(len(hole["values"]) for hole in said["holes"].values())
    if not 0 < count <= MAX_COMBINATIONS:
        raise MalformedError(
            f"expected 1 to {MAX_COMBINATIONS} combinations, got {count}", where="holes"
        )
    # a template of the right types whose mission is not looked at yet, to be filled from
    frame = convert({**said, "mission": {}}, Template, where="draft")
    taken = {"mission", "version", "supersedes", "window"}.intersection(draft.mission)
    if taken:
        raise MalformedError("expected to be left to the instance", where=f"mission.{min(taken)}")
    first, last = shown_window(frame)
    fixed = {
        "mission": f"{frame.template}.instance",
        "window": {"not_before": first, "expiry": last},
    }
    found: _Cases = []
    for fill in combinations(frame):
        written = {name: spelled[name][value] for name, value in fill.items()}
        task = _put(draft.mission.get("task"), fill, "mission.task")
        plain = cast("dict[str, Any]", _put(draft.mission, written, "mission"))
        plain |= {**fixed, "task": task} if "task" in plain else fixed
        mission: Mission = compile_plain(plain, site, now=Now(0, 0), nonce="A" * 22)
        found.append((fill, _plain(mission)))
    return found


def _plain(mission: Mission) -> dict[str, Any]:
    return cast("dict[str, Any]", msgspec.json.decode(encode(mission)))


def _put(value: object, fill: Mapping[HoleName, Quantity], where: str) -> object:
    """Return a part of the draft with values where holes stand."""
    name = hole_of(value)
    if name is not None:
        return _value(name, fill, where)
    if isinstance(value, dict):
        items = cast("dict[str, object]", value).items()
        return {key: _put(item, fill, f"{where}.{key}") for key, item in items}
    if isinstance(value, list):
        listed = cast("list[object]", value)
        return [_put(item, fill, f"{where}[{n}]") for n, item in enumerate(listed)]
    if where == "mission.task" and isinstance(value, str):
        return _IN_TEXT.sub(lambda m: str(_value(HoleName(m[1]), fill, where)), value)
    return value


def _value(name: HoleName, fill: Mapping[HoleName, Quantity], where: str) -> Quantity:
    if name not in fill:
        raise MalformedError(f"there is no hole `{name}`", where=where, reason=Reason.NAME_UNKNOWN)
    return fill[name]


def _task(draft: TemplateDraft) -> object:
    """Return the task's parts: text and holes in turn; plain text when there is no hole in it."""
    parts = _IN_TEXT.split(str(draft.mission["task"]))
    if len(parts) == 1:
        return parts[0]
    return [{"hole": p} if n % 2 else p for n, p in enumerate(parts) if p]


def _derived(cases: _Cases, path: Path) -> Any:
    """Return what stands at a place of the template, given what stands there in each mission."""
    first = cases[0][1]
    if all(node == first for _, node in cases):
        return first
    if rule_of(path) in SETS:
        return _derived_set(cases, path)
    if all(isinstance(node, dict) and node.keys() == first.keys() for _, node in cases):
        return {key: _derived([(f, n[key]) for f, n in cases], (*path, key)) for key in first}
    if all(isinstance(node, list) and len(node) == len(first) for _, node in cases):
        return [
            _derived([(f, n[number]) for f, n in cases], (*path, number))
            for number in range(len(first))
        ]
    for name in sorted(cases[0][0]):
        if all(node == fill[name] for fill, node in cases):
            return {"hole": name}
    raise _differs(path)


def _derived_set(cases: _Cases, path: Path) -> list[Any]:
    """Return a list that is a set: what is always in it, then the holes whose values are."""
    fixed = sorted(set.intersection(*(set(node) for _, node in cases)))
    names = [name for name in sorted(cases[0][0]) if all(f[name] in n for f, n in cases)]
    holes = [name for name in names if any(f[name] not in fixed for f, _ in cases)]
    for fill, node in cases:
        if sorted([*fixed, *(str(fill[name]) for name in holes)]) != list(node):
            raise _differs(path)
    return [*fixed, *({"hole": name} for name in holes)]


def _differs(path: Path) -> MalformedError:
    return MalformedError(
        "the missions differ here by more than one hole's value", where=place_of(path)
    )
