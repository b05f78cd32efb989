# SPDX-License-Identifier: Apache-2.0
"""Human quantities to integers, exactly.

`0.8 m/s` into millimeters per second is 800; `0.8` alone has no unit and is asked about; a
quantity that is no whole number of the target's unit is refused, never rounded, because a person
signs what it says.
"""

from __future__ import annotations

from fractions import Fraction
from functools import cache
from typing import Any

from authguard_r.core.errors import ClarificationError, MalformedError
from authguard_r.core.identifiers import MAX_INTEGER


def to_integer(value: str | int, unit: str, *, where: str) -> int:
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
    number, _, spelled = value.strip().partition(" ")
    if not spelled:
        raise ClarificationError(
            f"`{value}` has no unit; which one is meant?", field=where, candidates=(unit,)
        )
    try:
        exact = Fraction(number)
    except (ValueError, ZeroDivisionError) as error:
        raise MalformedError(f"expected a number and a unit, got `{value}`", where=where) from error
    scaled = exact * _factor(spelled, unit, where)
    if scaled.denominator != 1:
        raise MalformedError(f"`{value}` is no whole number of {unit}", where=where)
    return _in_range(scaled.numerator, where)


def _factor(spelled: str, unit: str, where: str) -> Fraction:
    """Return how many `unit` one `spelled` is, exactly."""
    registry = _registry()
    try:
        one = registry.Quantity(Fraction(1), registry.parse_units(spelled))
        return Fraction(one.to(registry.parse_units(unit)).magnitude)
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
        raise MalformedError("expected a quantity that an integer can hold", where=where)
    return value
