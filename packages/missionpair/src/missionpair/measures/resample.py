# SPDX-License-Identifier: Apache-2.0
"""The interval of a difference of means, by a bootstrap with a fixed seed.

Resamples are drawn from counts, not from values: a million trials cost no more than a hundred.
"""

from __future__ import annotations

from random import Random

from missionpair.measures.rates import Gap
from missionpair.measures.spread import Spread

#: Of every interval: the same figures give the same interval.
SEED = 20260115
RESAMPLES = 1_000
_SMALL = 32


def mean_difference(first: Spread, second: Spread) -> Gap | None:
    """Return the difference of two means with its percentile interval.

    None where one of them has fewer than two values: drawing one value again and again shows
    nothing of how it might have differed. Values that are all the same have an interval of no
    width, which says no more.
    """
    if first.mean is None or second.mean is None or min(first.n, second.n) < 2:
        return None
    random = Random(SEED)  # noqa: S311 - dice of a published seed, not of a secret
    drawn = sorted(_mean(first, random) - _mean(second, random) for _ in range(RESAMPLES))
    low, high = drawn[RESAMPLES // 40], drawn[RESAMPLES - 1 - RESAMPLES // 40]
    return Gap(float(first.mean - second.mean), low, high)


def _mean(spread: Spread, random: Random) -> float:
    """Return the mean of as many values, drawn with replacement: a multinomial by its parts."""
    left, weight, total = spread.n, spread.n, 0
    for value, count in spread.items():
        drawn = left if count == weight else binomial(left, count / weight, random)
        total += drawn * value
        left, weight = left - drawn, weight - count
    return total / spread.n


def binomial(n: int, share: float, random: Random) -> int:
    """Draw how many of n come out, each with the same share: exact, in log n steps.

    The middle one of n sorted uniform numbers is beta distributed; what lies on its other side is
    a smaller problem of the same kind.
    """
    found = 0
    while n > _SMALL:
        above = 1 + n // 2
        middle = random.betavariate(above, n - above + 1)
        if middle >= share:
            n, share = above - 1, share / middle
        else:
            found += above
            n, share = n - above, (share - middle) / (1 - middle)
    return found + sum(random.random() < share for _ in range(n))
