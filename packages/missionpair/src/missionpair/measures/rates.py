# SPDX-License-Identifier: Apache-2.0
"""Shares of trials with their intervals, and differences of two shares.

A share of nothing is undefined: it has no value, no interval and no bound, and is never 0.
Source: section "Prototype, Execution Path, and Evaluation Criteria" (Wilson intervals). Spec page:
docs/spec/measures.md
"""

from __future__ import annotations

from fractions import Fraction
from math import sqrt

from msgspec import Struct

import authguard_reference as oracle


class Proportion(Struct, frozen=True):
    """How many of how many.

    Args:
        k: trials that count.
        n: trials that could have counted.
    """

    k: int
    n: int

    def __add__(self, other: Proportion) -> Proportion:
        return Proportion(self.k + other.k, self.n + other.n)

    @property
    def value(self) -> Fraction | None:
        """The share; None of nothing."""
        return Fraction(self.k, self.n) if self.n else None

    @property
    def interval(self) -> tuple[float, float] | None:
        """The Wilson score interval at 95 %, as the oracle computes it; None of nothing."""
        return oracle.wilson(self.k, self.n) if self.n else None

    @property
    def bound(self) -> Fraction | None:
        """The rule of three: of 0 of n, at 95 % at most 3/n; None of anything else.

        It is never below the exact bound 1 - 0.05^(1/n), and at most 1.
        """
        return min(Fraction(1), Fraction(3, self.n)) if self.n and self.k == 0 else None

    @property
    def rest(self) -> Proportion:
        """Those that do not count."""
        return Proportion(self.n - self.k, self.n)


class Gap(Struct, frozen=True):
    """A difference and its interval at 95 %.

    Args:
        value: the first less the second.
        low: the interval's lower end.
        high: its upper end.
    """

    value: float
    low: float
    high: float

    @property
    def tells(self) -> bool:
        """True when the interval leaves 0 out."""
        return self.low > 0 or self.high < 0


def difference(first: Proportion, second: Proportion) -> Gap | None:
    """Return the difference of two independent shares; None when one of them is undefined.

    Newcombe's hybrid score interval (Statistics in Medicine 17, 1998, method 10): the two Wilson
    intervals squared and added. Of the same pairs tried twice it is too wide rather than too
    narrow where the two agree.
    """
    if first.value is None or second.value is None:
        return None
    low_1, high_1 = oracle.wilson(first.k, first.n)
    low_2, high_2 = oracle.wilson(second.k, second.n)
    one, two = float(first.value), float(second.value)
    value = float(first.value - second.value)
    low = value - sqrt((one - low_1) ** 2 + (high_2 - two) ** 2)
    high = value + sqrt((high_1 - one) ** 2 + (two - low_2) ** 2)
    return Gap(value, max(-1.0, low), min(1.0, high))
