# SPDX-License-Identifier: Apache-2.0
"""Numbers of planners and tools, to integers in the site's units and back, exactly.

A planner's decimal is rounded against it; what a tool is given is never more than the integer
that was authorized. Spec pages: docs/spec/normalize.md, docs/spec/binding.md#rebuilding
"""

from __future__ import annotations

import struct
from decimal import Decimal, localcontext
from fractions import Fraction
from math import inf
from typing import Any

from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import MAX_INTEGER
from authguard_r.core.reasons import Reason
from authguard_r.normalize.binding import Argument
from authguard_r.site.model import Parameter, Rounding

#: What a coordinate of a position is held to.
COORDINATE = Parameter(
    unit="mm", low=-MAX_INTEGER, high=MAX_INTEGER, rounding=Rounding.POSITION, required=True
)


def scale(
    value: Any, parameter: Parameter, *, per_unit: Fraction, where: str, offset: int = 0
) -> int:
    """Return a planner's number as an integer in the parameter's unit, rounded against it.

    Args:
        value: an `int` or exact `Decimal`; truth values, text and everything else are refused.
        parameter: the target.
        per_unit: the target's units in one of the planner's.
        where: the place, for messages.
        offset: what is added, in the target's unit.

    Raises:
        MalformedError: not a number, a remainder in a count, or outside the type's range.
    """
    if isinstance(value, bool) or not isinstance(value, int | Decimal):
        raise _refusal(Reason.VALUE_INVALID, "expected a number", where)
    top, bottom = value.as_integer_ratio()
    more, less = per_unit.as_integer_ratio()
    top, bottom = top * more, bottom * less
    whole, left = divmod(top + offset * bottom, bottom)
    if left:
        exact = Fraction(_at_own_width(value)) * per_unit + offset
        is_whole = exact.denominator == 1
        whole = exact.numerator if is_whole else _rounded(exact, parameter.rounding, where)
    if not parameter.low <= whole <= parameter.high or abs(whole) > MAX_INTEGER:
        message = f"expected {_range_text(parameter, per_unit, offset)}, got {value}"
        raise _refusal(Reason.VALUE_OUT_OF_RANGE, message, where)
    return whole


def _range_text(parameter: Parameter, per_unit: Fraction, offset: int) -> str:
    """Return a range as who wrote the number counts, and in the parameter's unit."""
    own = f"{parameter.low} to {parameter.high} {parameter.unit}"
    if per_unit == 1 and not offset:
        return own
    ends = ((end - offset) / per_unit for end in (parameter.low, parameter.high))
    return f"{' to '.join(f'{float(end):.6g}' for end in ends)} ({own})"


def _at_own_width(value: int | Decimal, *, wide: int = 13) -> int | Decimal:
    """Return the shortest number that is the same in 32 bits, when a double spells exactly those.

    A message with `float32` fields prints 0.8 as 0.800000011920929.

    Args:
        value: as it was written.
        wide: digits from which it may be such a number.
    """
    if len(Decimal(value).as_tuple().digits) < wide:
        return value
    double = float(value)
    if Decimal(repr(double)) != value or _single(double) != double:
        return value
    shorter = (f"{double:.{digits}g}" for digits in range(1, 10))
    return next(Decimal(text) for text in shorter if _single(float(text)) == double)


def _single(number: float) -> float:
    """Return the nearest number of 32 bits; infinite when there is none."""
    try:
        return float(struct.unpack("<f", struct.pack("<f", number))[0])
    except OverflowError:
        return inf


def _rounded(exact: Fraction, rounding: Rounding, where: str) -> int:
    if rounding is Rounding.COUNT:
        raise _refusal(Reason.VALUE_INVALID, "expected a whole number", where)
    if rounding is Rounding.POSITION:
        return round(exact)
    toward_zero = abs(exact.numerator) // exact.denominator
    return (toward_zero + 1) * (1 if exact > 0 else -1)


def unscale(value: int, argument: Argument, parameter: Parameter) -> int | Decimal | None:
    """Return a parameter's integer as the tool's number; None when no number is read as it.

    Exact where the tool's unit has an exact decimal. Where it has none (radians into degrees) the
    decimal is cut toward zero: the tool is never given more than was authorized.

    Args:
        value: in the parameter's unit.
        argument: the argument that carries it.
        parameter: whose rounding reads it back.
    """
    per_unit = Fraction(argument.per_unit)
    exact = (value - argument.offset) / per_unit
    if exact.denominator == 1:
        return exact.numerator
    digits = _digits(exact.denominator)
    if digits is None:
        digits = len(str(int(per_unit))) + 3
    cut = abs(exact.numerator) * 10**digits // exact.denominator
    with localcontext() as context:
        context.prec = 99
        found = (Decimal(cut) * (1 if exact > 0 else -1)).scaleb(-digits).normalize()
    try:
        read = scale(found, parameter, per_unit=per_unit, where="", offset=argument.offset)
    except MalformedError:  # a count would be read with a remainder
        return None
    return found if read == value and not argument.whole else None


def _digits(bottom: int) -> int | None:
    """Return after how many digits the decimals of a fraction end; None when they never do."""
    counts = {2: 0, 5: 0}
    for prime in counts:
        while bottom % prime == 0:
            bottom //= prime
            counts[prime] += 1
    return max(counts.values()) if bottom == 1 else None


def _refusal(reason: Reason, message: str, where: str) -> MalformedError:
    return MalformedError(message, where=where, reason=reason)
