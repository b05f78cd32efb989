# SPDX-License-Identifier: Apache-2.0
"""What a tool may mean, where the site and its fields leave one answer; else nothing.

A field is mapped when all its words are places or things of the site, or when its name ends in a
unit and the type has one quantity of that unit. A tool gets a type when exactly one of the site's
fits all of that. Everything else has a constant or is refused. How-to: docs/howto/onboarding.md
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from decimal import Decimal
from fractions import Fraction
from typing import Any

import msgspec
from msgspec import Struct

from authguard_r.authoring.onboarding.calls import SeenField, SeenWay, WayKey
from authguard_r.authoring.onboarding.skeleton import UNHELD
from authguard_r.core.identifiers import (
    MAX_INTEGER,
    ActionType,
    Identifier,
    ParameterId,
    ToolId,
    is_identifier,
)
from authguard_r.normalize.binding import Binding, ToolBinding, binding_faults
from authguard_r.site.model import ActionModel, Site
from authguard_r.site.strict import convert
from authguard_r.site.units import unit_of

#: Endings of a field's name that say its unit: SI base and power of ten. One letter is a unit
#: only behind another word: `duration_s`, not `s`.
_ENDINGS: dict[str, tuple[str, int]] = {
    "m_s": ("m/s", 0),
    "mps": ("m/s", 0),
    "cm_s": ("m/s", -2),
    "mm_s": ("m/s", -3),
    "rad_s": ("rad/s", 0),
    "rad": ("rad", 0),
    "radians": ("rad", 0),
    "m": ("m", 0),
    "meters": ("m", 0),
    "cm": ("m", -2),
    "mm": ("m", -3),
    "s": ("s", 0),
    "sec": ("s", 0),
    "seconds": ("s", 0),
    "ms": ("s", -3),
    "milliseconds": ("s", -3),
    "n": ("N", 0),
    "newtons": ("N", 0),
    "mn": ("N", -3),
    "kg": ("kg", 0),
    "bytes": ("byte", 0),
    "percent": ("1", -2),
    "permille": ("1", -3),
}
_LONGEST_FIRST = sorted(_ENDINGS, key=len, reverse=True)
_WORDS = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|[0-9]+")
#: Names under which a region is where an action starts.
_STARTS = frozenset({"source", "from", "start", "origin"})
#: A value that was always the same counts as constant from so many calls on.
_OFTEN = 2
#: Longest word that is taken for a name, in characters.
_NAME = 60
#: Longest note on a field, in characters.
_NOTE = 200
_TEXTS = ("text",)
_NUMBERS = ("whole number", "number")


class Meaning(Struct, frozen=True, kw_only=True):
    """The proposal's decision for one way.

    Args:
        key: the tool, and what it reaches.
        plain: the way as a binding holds it.
        understood: whether it has a type that can be granted.
        fits: the types that its fields fit; one when it is understood.
        notes: what was seen of each field, and why it stands as it does.
        unknown: words that no place and no thing of the site is called, by field.
        near: the types that would fit if it gave what they must have, each with what that is.
        kept: whether it is as a person bound it.
        about: what is said of it; empty: what it fits.
    """

    key: WayKey
    plain: dict[str, Any]
    understood: bool
    fits: tuple[ActionType, ...]
    notes: dict[str, str]
    unknown: dict[str, dict[str, int]]
    near: tuple[tuple[ActionType, tuple[str, ...]], ...] = ()
    kept: bool = False
    about: str = ""


class _Found(Struct):
    """The fields of a way, by what they may be."""

    regions: list[str]
    objects: list[str]
    amounts: dict[str, tuple[str, str, int]]


class Meanings:
    """Reads ways with the words of one site.

    Args:
        site: the site.
    """

    def __init__(self, site: Site) -> None:
        self._site = site
        self._regions = {name for r, m in site.regions.items() for name in (r, *m.names)}
        self._objects = {name for o, m in site.objects.items() for name in (o, *m.names)}
        able = {kind for robot in site.robots.values() for kind in robot.profile.tools}
        self._kinds = {
            kind: model
            for kind, model in site.vocabulary.items()
            if not model.state_writing and (not able or kind in able)
        }

    def of(self, key: WayKey, way: SeenWay) -> Meaning:
        """Return what a way means; refused whole when that is not plain."""
        fields = {path: f for path, f in way.fields.items() if key[1] is None or path != key[1][0]}
        found = self._found(fields)
        fits = {
            kind: mapped
            for kind, model in self._kinds.items()
            if (mapped := _fit(found, model, fields, way.count)) is not None
        }
        named = [kind for kind in fits if _is_named(kind, key[0])]
        certain = named or [kind for kind in fits if fits[kind]]
        if len(certain) == 1:
            plain = self._understood(key, certain[0], fits[certain[0]], fields, way.count)
            if self._is_sound(key[0], plain):
                return self._meaning(key, plain, tuple(certain), fields, is_understood=True)
        plain = {"type": UNHELD, "tool": UNHELD, **_when(key)}
        plain["arguments"] = {path: {"use": "refused"} for path in fields}
        made = self._meaning(key, plain, tuple(certain or fits), fields, is_understood=False)
        near = () if certain else tuple(self._near(found, fields, way.count))
        return msgspec.structs.replace(made, near=near)

    def _near(
        self, found: _Found, fields: dict[str, SeenField], count: int
    ) -> Iterator[tuple[ActionType, tuple[str, ...]]]:
        """Yield the types that every place, thing and amount fits, and what they lack then.

        A number alone says too little: only a way that names a place or a thing is near anything.
        """
        if not found.regions and not found.objects:
            return
        for kind, model in self._kinds.items():
            mapped = _mapped(found, model, fields, count)
            lacking = _lacking(mapped or {}, model, fields, count)
            if mapped and lacking and all(name.startswith("params.") for name in lacking):
                yield kind, lacking

    def _meaning(
        self,
        key: WayKey,
        plain: dict[str, Any],
        fits: tuple[ActionType, ...],
        fields: dict[str, SeenField],
        *,
        is_understood: bool,
    ) -> Meaning:
        return Meaning(
            key=key,
            plain=plain,
            understood=is_understood,
            fits=fits,
            notes={path: describe(field) for path, field in fields.items()},
            unknown={
                path: words
                for path, field in fields.items()
                if (words := self._unknown(field)) and plain["arguments"][path]["use"] == "refused"
            },
        )

    def _found(self, fields: dict[str, SeenField]) -> _Found:
        found = _Found([], [], {})
        for path, field in fields.items():
            words = set(field.words)
            settled = field.are(*_TEXTS) and not field.crowded
            if settled and words <= self._regions and not words & self._objects:
                found.regions.append(path)
            elif settled and words <= self._objects and not words & self._regions:
                found.objects.append(path)
            elif field.are(*_NUMBERS) and (amount := _amount(path)) is not None:
                found.amounts[path] = amount
        return found

    def _unknown(self, field: SeenField) -> dict[str, int]:
        """Return words that could be names, and that the site has for nothing."""
        return {
            word: count
            for word, count in field.words.items()
            if word not in self._regions | self._objects
            and 0 < len(word) <= _NAME
            and word.isprintable()
        }

    def _understood(
        self,
        key: WayKey,
        kind: ActionType,
        mapped: dict[str, dict[str, Any]],
        fields: dict[str, SeenField],
        count: int,
    ) -> dict[str, Any]:
        model = self._kinds[kind]
        plain: dict[str, Any] = {"type": kind, "tool": self._tool(kind, key[0]), **_when(key)}
        targets = {argument["to"] for argument in mapped.values()}
        if "source" in model.fields and "source" not in targets:
            plain["attested"] = ["source"]
        plain["arguments"] = {
            path: mapped.get(path) or _constant(field, count) or {"use": "refused"}
            for path, field in fields.items()
        }
        return plain

    def _tool(self, kind: ActionType, name: str) -> str:
        """Return the one tool of the site's robots for a type, else the tool's own name."""
        tools: set[ToolId] = set()
        for robot in self._site.robots.values():
            tools.update(robot.profile.tools.get(kind, ()))
        if len(tools) == 1:
            return tools.pop()
        made = re.sub(r"[^a-z0-9_.:-]", "-", name.lower()).strip("_.:-")[:64]
        return made if is_identifier(made) else "tool"

    def _is_sound(self, name: str, plain: dict[str, Any]) -> bool:
        binding = Binding(
            schema="authguard-r/binding/1",
            id=Identifier("proposed"),
            tools={name: convert(plain, ToolBinding, where=name)},
        )
        return not any(binding_faults(binding, self._site))


def _when(key: WayKey) -> dict[str, Any]:
    return {} if key[1] is None else {"when": {key[1][0]: key[1][1]}}


def _fit(
    found: _Found, model: ActionModel, fields: dict[str, SeenField], count: int
) -> dict[str, dict[str, Any]] | None:
    """Return what a type maps of a way's fields, None when it does not fit them.

    It fits when every field that is a place, a thing or an amount has one target in the type, and
    every target that the type must have has a field that was always there.
    """
    mapped = _mapped(found, model, fields, count)
    if mapped is None or _lacking(mapped, model, fields, count):
        return None
    for path, argument in mapped.items():
        if fields[path].count < count:
            argument["optional"] = True
    return mapped


def _mapped(
    found: _Found, model: ActionModel, fields: dict[str, SeenField], count: int
) -> dict[str, dict[str, Any]] | None:
    """Return the target of each field, None when a place, a thing or an amount has none."""
    mapped: dict[str, dict[str, Any]] = {}
    starts = [path for path in found.regions if path.rpartition(".")[2].lower() in _STARTS]
    ends = [path for path in found.regions if path not in starts]
    for target, paths in (("source", starts), ("destination", ends), ("object", found.objects)):
        if len(paths) > 1 or (paths and target not in model.fields):
            return None
        mapped |= {path: {"use": "mapped", "to": target} for path in paths}
    for path, amount in found.amounts.items():
        scaled = _parameter(amount, model)
        taken = {argument["to"] for argument in mapped.values()}
        if scaled is not None and scaled["to"] not in taken:
            mapped[path] = {"use": "mapped", **scaled}
        elif _constant(fields[path], count) is None:
            return None
    return mapped


def _lacking(
    mapped: dict[str, dict[str, Any]], model: ActionModel, fields: dict[str, SeenField], count: int
) -> tuple[str, ...]:
    """Return the targets that a type must have and that no field always gives, in order."""
    always = {a["to"] for path, a in mapped.items() if fields[path].count == count}
    needed: set[str] = {field for field in model.fields if field not in {"route", "source"}}
    needed |= {f"params.{name}" for name, p in model.params.items() if p.required}
    return tuple(sorted(needed - always))


def _parameter(amount: tuple[str, str, int], model: ActionModel) -> dict[str, Any] | None:
    """Return the one parameter of a type that an amount can be, with the factor between them."""
    stem, base, power = amount
    fits: dict[ParameterId, int] = {}
    for name in model.params:
        unit = unit_of(name)
        if unit is not None and unit.base == base and not name.endswith(("_no", "_count")):
            fits[name] = power - unit.power
    exact = [name for name in fits if name.rpartition("_")[0].startswith(stem) and stem]
    chosen = exact if len(exact) == 1 else list(fits)
    if len(chosen) != 1:
        return None
    factor = Fraction(10) ** fits[chosen[0]]
    return {"to": f"params.{chosen[0]}", **({} if factor == 1 else {"per_unit": str(factor)})}


def _amount(path: str) -> tuple[str, str, int] | None:
    """Return what the name of a field says of its unit: the rest of the name, base and power."""
    name = path.rpartition(".")[2].lower()
    for ending in _LONGEST_FIRST:
        stem = name.removesuffix(f"_{ending}")
        if stem != name and stem:
            return (stem, *_ENDINGS[ending])
        if name == ending and len(ending) > 2:
            return ("", *_ENDINGS[ending])
    return None


def _constant(field: SeenField, count: int) -> dict[str, Any] | None:
    """Return how a field is fixed that always had one value, in every call; None when it is not."""
    value = field.only
    if value is None or count < _OFTEN or field.count != count or field.crowded:
        return None
    if isinstance(value, Decimal):
        if value != value.to_integral_value():
            text = format(value.normalize(), "f")
            return {"use": "fixed", "decimal": text} if len(text) <= 20 else None
        value = int(value)
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) > MAX_INTEGER:
        return None
    return {"use": "fixed", "value": value}


def _is_named(kind: ActionType, tool: str) -> bool:
    """True when a tool's name has the words of a type, in order and side by side."""
    wanted = kind.split("_")
    words = [word.lower() for word in _WORDS.findall(tool)]
    return any(words[n : n + len(wanted)] == wanted for n in range(len(words)))


def describe(field: SeenField) -> str:
    """Return what was seen of a field, in words of ours but for the planner's own, cut short."""
    kinds = ", ".join(f"{count} x {kind}" for kind, count in field.kinds.items())
    parts = [kinds]
    if field.low is not None:
        parts.append(f"from {str(field.low)[:40]} to {str(field.high)[:40]}")
    if field.crowded:
        parts.append("too many or too long to list")
    if field.words:
        told = [f"{word[:40]!a} x {n}" for word, n in list(field.words.items())[:8]]
        more = len(field.words) - len(told)
        told += [f"{more} more"] if more > 0 else []
        parts.append(", ".join(told))
    return "; ".join(parts)[:_NOTE]
