# SPDX-License-Identifier: Apache-2.0
"""How integers are spread: counts in bounded memory, with percentiles.

Values below 1,024 are counted exactly. Above, a value keeps its ten leading bits, so a percentile
is within 1 in 1,024 of an observed value, for every number of values.
"""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction

_EXACT_BITS = 10
_MASK = (1 << _EXACT_BITS) - 1


class Spread:
    """Counts of values that are integers and not negative."""

    __slots__ = ("counts", "most", "n", "total")

    def __init__(self) -> None:
        self.counts: dict[int, int] = {}
        self.n = 0
        self.total = 0
        self.most = 0

    def add(self, value: int) -> None:
        """Count one value.

        Raises:
            ValueError: it is negative.
        """
        key = value
        if value > _MASK:
            shift = value.bit_length() - _EXACT_BITS
            key = shift << _EXACT_BITS | value >> shift
        elif value < 0:
            raise ValueError(f"`{value}` is negative")
        self.counts[key] = self.counts.get(key, 0) + 1
        self.n += 1
        self.total += value
        if value > self.most:  # noqa: PLR1730 - called ten times for each trial
            self.most = value

    def merge(self, other: Spread) -> None:
        """Count what another one has counted."""
        for key, count in other.counts.items():
            self.counts[key] = self.counts.get(key, 0) + count
        self.n += other.n
        self.total += other.total
        self.most = max(self.most, other.most)

    def items(self) -> Iterator[tuple[int, int]]:
        """Yield each value with its count, from the smallest.

        The middle of values that share their leading bits represents all of them.
        """
        for key in sorted(self.counts):
            shift = key >> _EXACT_BITS
            low = (key & _MASK) << shift
            yield min(low + ((1 << shift) >> 1), self.most), self.counts[key]

    def quantile(self, permille: int) -> int | None:
        """Return the nearest-rank quantile: the smallest value that so many do not exceed."""
        return self._at(-(-permille * self.n // 1_000)) if self.n else None

    @property
    def mean(self) -> Fraction | None:
        """The arithmetic mean, exact; None of nothing."""
        return Fraction(self.total, self.n) if self.n else None

    @property
    def median(self) -> Fraction | None:
        """The value in the middle, or half way between the two there; None of nothing."""
        if not self.n:
            return None
        return Fraction(self._at((self.n + 1) // 2) + self._at(self.n // 2 + 1), 2)

    def _at(self, rank: int) -> int:
        """Return the value of a rank, counted from 1."""
        seen = 0
        for value, count in self.items():
            seen += count
            if seen >= rank:
                return value
        raise IndexError(rank)
