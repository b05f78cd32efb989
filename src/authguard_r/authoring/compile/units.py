# SPDX-License-Identifier: Apache-2.0
"""Human quantities to integers, exactly.

`0.8 m/s` into millimeters per second is 800; `0.8` alone has no unit and is asked about; a
quantity that is no whole number of the target's unit is refused, never rounded, because a person
signs what it says.
"""

from __future__ import annotations

import re
from fractions import Fraction
from functools import cache
from typing import Any

from authguard_r.authoring.compile.draft import Quantity
from authguard_r.core.errors import ClarificationError, MalformedError
from authguard_r.core.identifiers import MAX_INTEGER
from authguard_r.site.formatting import quantity

#: What people write for a target unit; offered when a number comes without one.
_SPELLED: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("ms", ("s", "min", "h")),
    ("millikelvin", ("K",)),
    ("mm/s", ("m/s", "km/h")),
    ("mm", ("m", "cm")),
    ("mN", ("N",)),
    ("byte", ("MB", "kB")),
    ("microradian", ("rad",)),
    ("microradian/s", ("rad/s",)),
)
#: Short numbers and plain units only: an exponent of a billion digits would never come back.
_QUANTITY = re.compile(
    r"(?P<number>[+-]?[0-9]{1,20}(?:[./][0-9]{1,20})?)"
    r"(?: *(?P<unit>[A-Za-z%µ°]{1,24}(?:/[A-Za-z]{1,24})?(?:\^2)?))?"
)


def to_integer(value: Quantity, unit: str, *, where: str) -> int:
    """Return the quantity as a whole number of `unit`.

    Args:
        value: `0.8 m/s`, or an integer that is in `unit` already.
        unit: the target, as the site's vocabulary spells it.
        where: the draft field, for questions and messages.

    Raises:
        ClarificationError: a number without its unit.
        MalformedError: another dimension, no whole number, or out of range.
    """
    if isinstance(value, int):
        return _in_range(value, where)
    text = str(value).strip()
    read = _QUANTITY.fullmatch(text)
    if read is None:
        raise MalformedError(f"expected a number and a unit, got `{text[:80]}`", where=where)
    number, spelled = read["number"], read["unit"]
    if spelled is None:
        raise ClarificationError(
            f"`{number}` has no unit; which one is meant?",
            field=where,
            candidates=tuple(f"{number} {spelling}" for spelling in _spellings(unit)),
        )
    return _in_range(_scaled(number, spelled, unit, where), where)


def _scaled(number: str, spelled: str, unit: str, where: str) -> int:
    shown = f"{number} {spelled}"
    try:
        exact = Fraction(number)
    except ZeroDivisionError as error:
        raise MalformedError(f"expected a number and a unit, got `{shown}`", where=where) from error
    zero, scaled = (_converted(n, spelled, unit, where) for n in (Fraction(0), exact))
    if scaled.denominator != 1:
        raise MalformedError(f"`{shown}` is no whole number of {unit}", where=where)
    if zero:  # 22 degC is 295.15 K as a point on the scale and 22 K as a difference
        raise MalformedError(
            f"expected a unit that counts from zero, got `{shown}`; as a point on its scale it is "
            f"`{quantity(scaled.numerator, unit)}`",
            where=where,
        )
    return scaled.numerator


def _spellings(unit: str) -> tuple[str, ...]:
    return (*dict(_SPELLED).get(unit, ()), unit)


def _converted(number: Fraction, spelled: str, unit: str, where: str) -> Fraction:
    """Return how many `unit` so many `spelled` are, exactly."""
    registry = _registry()
    try:
        given = registry.Quantity(number, registry.parse_units(spelled))
        return Fraction(given.to(registry.parse_units(unit)).magnitude)
    except Exception as error:
        raise MalformedError(
            f"expected a quantity in {unit} or like it, got `{spelled}`", where=where
        ) from error


@cache
def _registry() -> Any:
    """Load the unit definitions once; exact fractions, no floats."""
    from pint import UnitRegistry

    return UnitRegistry(non_int_type=Fraction)


def _in_range(value: int, where: str) -> int:
    if abs(value) > MAX_INTEGER:
        raise MalformedError("expected a quantity that fits into an integer", where=where)
    return value
