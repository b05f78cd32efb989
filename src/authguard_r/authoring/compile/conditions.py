# SPDX-License-Identifier: Apache-2.0
"""What conditions on attested state can tell apart: nothing, something, or everything.

A condition that every value satisfies looks like a guard and has no effect; conditions that no
value satisfies together keep two grants apart. Only what a variable's name says of its range is
known here: no site attests what an estimator will send. Spec page: docs/spec/lint.md
"""

from __future__ import annotations

from collections.abc import Iterable

from authguard_r.core.identifiers import MAX_INTEGER
from authguard_r.core.mission import Comparison, Guard

#: What the end of a variable's name says of its range; anything else is any integer.
_RANGES = (("_permille", 0, 1_000), ("_percent", 0, 100))
_NEVER_NEGATIVE = ("_ms", "_mm", "_mm_s", "_g", "_bytes")


def real_guards(guards: Iterable[Guard], given: Iterable[Guard] = ()) -> tuple[Guard, ...]:
    """Return the guards that some value fails; the others hold nothing back.

    Args:
        guards: conditions that are to hold something back.
        given: conditions that hold anyway; what follows from them is no further condition.
    """
    held = tuple(given)
    return tuple(guard for guard in guards if not _always_holds(guard, held))


def can_hold(guards: Iterable[Guard]) -> bool:
    """True when each variable has a value that satisfies every condition on it."""
    conditions = tuple(guards)
    return all(
        _can_hold([guard for guard in conditions if guard.variable == variable])
        for variable in {guard.variable for guard in conditions}
    )


def _can_hold(guards: list[Guard]) -> bool:
    """True when one value may satisfy every condition on one variable."""
    fixed = [guard.value for guard in guards if guard.comparison is Comparison.EQ]
    if fixed:
        return all(_satisfies(fixed[0], guard) for guard in guards)
    span = _span(guards, -MAX_INTEGER, MAX_INTEGER)
    return span is not None and span[0] <= span[1]


def _always_holds(guard: Guard, given: tuple[Guard, ...]) -> bool:
    """True when no value that the variable can have makes the condition false."""
    if any(
        (guard.variable, guard.comparison, guard.value, type(guard.value))
        == (other.variable, other.comparison, other.value, type(other.value))
        for other in given
    ):
        return True
    bound = guard.value
    if isinstance(bound, bool) or not isinstance(bound, int):
        return False  # of words and truth values each condition leaves some out
    first, last = _range(guard.variable)
    same = [other for other in given if other.variable == guard.variable]
    first, last = _span(same, first, last) or (first, last)
    return {
        Comparison.EQ: first == bound == last,
        Comparison.NE: not first <= bound <= last,
        Comparison.LT: last < bound,
        Comparison.LE: last <= bound,
        Comparison.GT: first > bound,
        Comparison.GE: first >= bound,
    }[guard.comparison]


def _range(variable: str) -> tuple[int, int]:
    """Return the values that an integer of this name can have."""
    for ending, first, last in _RANGES:
        if variable.endswith(ending):
            return first, last
    return (0 if variable.endswith(_NEVER_NEGATIVE) else -MAX_INTEGER), MAX_INTEGER


def _span(guards: Iterable[Guard], first: int, last: int) -> tuple[int, int] | None:
    """Return the integers from `first` to `last` that the orders leave; None when one has none."""
    for guard in guards:
        value = guard.value
        if guard.comparison is Comparison.NE:
            continue
        if isinstance(value, bool) or not isinstance(value, int):
            return None  # only integers have an order
        if guard.comparison in {Comparison.GE, Comparison.GT, Comparison.EQ}:
            first = max(first, value + (guard.comparison is Comparison.GT))
        if guard.comparison in {Comparison.LE, Comparison.LT, Comparison.EQ}:
            last = min(last, value - (guard.comparison is Comparison.LT))
    return first, last


def _satisfies(value: object, guard: Guard) -> bool:
    """True when the value fulfils the condition; types are compared before values."""
    bound = guard.value
    if type(value) is not type(bound):
        return False
    if guard.comparison is Comparison.EQ:
        return value == bound
    if guard.comparison is Comparison.NE:
        return value != bound
    if isinstance(value, bool) or not isinstance(value, int) or not isinstance(bound, int):
        return False
    return {
        Comparison.LT: value < bound,
        Comparison.LE: value <= bound,
        Comparison.GT: value > bound,
        Comparison.GE: value >= bound,
    }[guard.comparison]
