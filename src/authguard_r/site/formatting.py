# SPDX-License-Identifier: Apache-2.0
"""Signed values in the words of the person who signs them: exact, never rounded.

Two values that differ never read alike, and no text of a mission can pass for a line of ours.
"""

from __future__ import annotations

from authguard_r.core.identifiers import ActionType, ParameterId, RegionId
from authguard_r.core.mission import Comparison, Guard, Limit, Row
from authguard_r.site.durations import decimal, duration
from authguard_r.site.model import Site

#: For each unit of signed data, the unit that people read and the power of ten between them.
_READ: dict[str, tuple[str, int]] = {
    "mm/s": ("m/s", 3),
    "mm": ("m", 3),
    "mN": ("N", 3),
    "microradian": ("rad", 6),
    "microradian/s": ("rad/s", 6),
    "permille": ("%", 1),
    "millikelvin": ("K", 3),
    "milliliter": ("L", 3),
    "g": ("kg", 3),
}
#: What the end of a state variable's name says of its unit.
_ENDINGS = (
    ("_permille", "permille"),
    ("_mm_s", "mm/s"),
    ("_mm", "mm"),
    ("_mn", "mN"),
    ("_ms", "ms"),
    ("_g", "g"),
)
#: Stands where a unit would, so that no reader takes one type's unit for all.
_DISAGREEING = "in each type's own unit"
_BYTES = (("GB", 9), ("MB", 6), ("kB", 3))
_COMPARED = {
    Comparison.EQ: "is",
    Comparison.NE: "is not",
    Comparison.LT: "is below",
    Comparison.LE: "is at most",
    Comparison.GT: "is above",
    Comparison.GE: "is at least",
}


def quantity(value: int, unit: str) -> str:
    """Return a signed integer in the unit that people read: 800 of `mm/s` is `0.8 m/s`.

    A unit that is not known here is shown as it is signed.
    """
    if unit in {"ms", "millisecond"}:
        return duration(value)
    if unit == "byte":
        return _bytes(value)
    if unit == "count":
        return str(value)
    shown, power = _READ.get(unit, (unit, 0))
    return f"{decimal(value, power)} {shown}"


def limit(item: Limit, site: Site, kind: ActionType | None = None) -> str:
    """Return bounds: `speed_mm_s from 0.05 m/s to 0.8 m/s`.

    Args:
        item: the bounds, in the unit of the grant's type.
        site: gives the parameter its unit.
        kind: the type of the grant that they are of; None for bounds of the whole mission.
    """
    unit = unit_of(item.parameter, site, kind)
    return f"{item.parameter} from {quantity(item.low, unit)} to {quantity(item.high, unit)}"


def condition(guard: Guard) -> str:
    """Return a condition on attested state, with how old the reading may be."""
    value = guard.value
    if isinstance(value, bool):
        shown = str(value).upper()  # no identifier is upper case
    elif isinstance(value, int):
        shown = quantity(value, unit_in_name(guard.variable))
    else:
        shown = f'"{value}"'
    age = duration(guard.max_age_ms)
    return f"{guard.variable} {_COMPARED[guard.comparison]} {shown}, read at most {age} ago"


def unit_in_name(name: str) -> str:
    """Return the unit that a name ends with: `speed_mm_s` is in `mm/s`; a bare number else."""
    return next((unit for end, unit in _ENDINGS if name.endswith(end)), "count")


def row_words(item: Row) -> str:
    """Return one alternative in words, without what the site says of it."""
    parts = [str(item.object)] if item.object is not None else []
    places = [("from", item.source), ("to", item.destination)]
    way = " ".join(f"{word} {region}" for word, region in places if region is not None)
    parts += [way] if way else []
    parts += [f"within {', '.join(item.regions)}"] if item.regions else ["at any place"]
    return ", ".join(parts)


def row(item: Row, site: Site) -> str:
    """Return one alternative, with the regions and things in it that are not harmless."""
    marks = [
        f"{tag.upper()}: {region}"
        for region in item.regions
        for tag in tags_of(region, site)
        if tag in {"private", "restricted", "hazardous"}
    ]
    if item.object in site.objects and site.objects[item.object].kind == "hazardous":
        marks.append(f"HAZARDOUS: {item.object}")
    return row_words(item) + (f"  [{', '.join(marks)}]" if marks else "")


def times(count: int) -> str:
    """Return how often: `once`, `20 times`."""
    return "once" if count == 1 else f"{count} times"


def quoted(text: str) -> str:
    """Return free text on one line, between quotes, every mark that does not print spelled out.

    A task cannot end its line and go on as a line of the card, nor turn the reading direction.
    """
    marks = (
        mark if mark.isprintable() and mark not in {'"', "\\"} else f"\\u{{{ord(mark):x}}}"
        for mark in text
    )
    return f'"{"".join(marks)}"'


def unit_of(parameter: ParameterId, site: Site, kind: ActionType | None = None) -> str:
    """Return a parameter's unit at this site; a bare number when it has none here.

    Args:
        parameter: its id.
        site: whose vocabulary is read.
        kind: the type that the value is of; None for what holds for every type. Types that
            disagree then give the number no unit of its own, and it is shown as it is signed.
    """
    units = site_units(parameter, site, kind)
    return units[0] if len(units) == 1 else _DISAGREEING if units else "count"


def site_units(
    parameter: ParameterId, site: Site, kind: ActionType | None = None
) -> tuple[str, ...]:
    """Return the units that a parameter may have: its type's own, else every type's, sorted."""
    own = site.vocabulary.get(kind) if kind is not None else None
    if own is not None and parameter in own.params:
        return (own.params[parameter].unit,)
    models = (model.params.get(parameter) for model in site.vocabulary.values())
    return tuple(sorted({model.unit for model in models if model is not None}))


def tags_of(region: RegionId, site: Site) -> tuple[str, ...]:
    """Return a region's tags, none when the site does not know it."""
    model = site.regions.get(region)
    return () if model is None else model.tags


def _bytes(value: int) -> str:
    for shown, power in _BYTES:
        if value >= 10**power:
            return f"{decimal(value, power)} {shown}"
    return f"{value} bytes"
