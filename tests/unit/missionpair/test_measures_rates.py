# SPDX-License-Identifier: Apache-2.0
"""Shares, intervals, differences and spreads: against published values and against their laws."""

from __future__ import annotations

import math
import statistics
from fractions import Fraction
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

import authguard_reference as oracle
from fixtures.cases import case
from missionpair.measures import Gap, Proportion, Spread, difference, mean_difference
from missionpair.measures.resample import binomial

Z = 1.959963984540054

#: Every interval that the paper prints, and four of Newcombe's (Statistics in Medicine 17, 857).
WILSON = [
    (0, 10, "0.00", "0.28"),
    (1, 10, "0.02", "0.40"),
    (2, 10, "0.06", "0.51"),
    (6, 10, "0.31", "0.83"),
    (7, 10, "0.40", "0.89"),
    (8, 10, "0.49", "0.94"),
    (10, 10, "0.72", "1.00"),
    (11, 60, "0.11", "0.30"),
    (12, 60, "0.12", "0.32"),
    (50, 60, "0.72", "0.91"),
    (36, 60, "0.47", "0.71"),
    (81, 263, "0.2553", "0.3662"),
    (15, 148, "0.0624", "0.1605"),
    (0, 20, "0.0000", "0.1611"),
    (1, 29, "0.0061", "0.1718"),
]
#: Newcombe's eight examples of method 10 (Statistics in Medicine 17, 873).
NEWCOMBE = [
    ((56, 70), (48, 80), "0.0524", "0.3339"),
    ((9, 10), (3, 10), "0.1705", "0.8090"),
    ((6, 7), (2, 7), "0.0582", "0.8062"),
    ((5, 56), (0, 29), "-0.0381", "0.1926"),
    ((0, 10), (0, 20), "-0.1611", "0.2775"),
    ((0, 10), (0, 10), "-0.2775", "0.2775"),
    ((10, 10), (0, 20), "0.6791", "1.0000"),
    ((10, 10), (0, 10), "0.6075", "1.0000"),
]


@st.composite
def rates(draw: st.DrawFn, least: int = 1) -> Proportion:
    n = draw(st.integers(least, 5_000))
    return Proportion(draw(st.integers(0, n)), n)


def test_wilson_is_what_others_published() -> None:
    for k, n, low, high in WILSON:
        with case(k, n, low, high):
            digits = len(low.partition(".")[2])
            ends = Proportion(k, n).interval
            assert ends is not None
            assert tuple(f"{end:.{digits}f}" for end in ends) == (low, high)


@given(rates())
def test_wilsons_ends_are_where_the_score_test_turns(rate: Proportion) -> None:
    # (p^ - p)^2 = z^2 p (1 - p) / n holds at both ends and at no other p
    ends = rate.interval
    assert ends is not None
    assert 0 <= ends[0] <= rate.k / rate.n + 1e-12
    assert rate.k / rate.n - 1e-12 <= ends[1] <= 1
    for end in ends:
        left, right = (rate.k / rate.n - end) ** 2, Z * Z * end * (1 - end) / rate.n
        assert left == pytest.approx(right, abs=1e-9)


@given(rates())
def test_wilson_of_the_rest_is_the_mirror_image(rate: Proportion) -> None:
    ends, rest = rate.interval, rate.rest.interval
    assert ends is not None
    assert rest is not None
    assert (1 - rest[1], 1 - rest[0]) == pytest.approx(ends, abs=1e-12)


@given(rates())
def test_every_rate_is_the_oracles(rate: Proportion) -> None:
    assert rate.value == oracle.uasr(rate.k, rate.n) == oracle.btcr(rate.k, rate.n)
    assert rate.value == oracle.scmhr([1] * rate.k + [0] * (rate.n - rate.k))
    assert rate.interval == oracle.wilson(rate.k, rate.n)


def test_a_share_of_nothing_is_undefined_and_never_0() -> None:
    nothing = Proportion(0, 0)
    assert (nothing.value, nothing.interval, nothing.bound) == (None, None, None)
    assert difference(nothing, Proportion(1, 2)) is None
    assert difference(Proportion(1, 2), nothing) is None


@given(st.integers(1, 100_000))
def test_the_rule_of_three_is_never_below_the_exact_bound(n: int) -> None:
    bound = Proportion(0, n).bound
    assert bound is not None
    assert 1 - math.exp(math.log(0.05) / n) <= float(bound) <= 1
    assert bound == min(Fraction(1), Fraction(3, n))
    assert Proportion(1, n).bound is None


def test_newcombe_is_what_he_published() -> None:
    for first, second, low, high in NEWCOMBE:
        with case(first, second, low, high):
            gap = difference(Proportion(*first), Proportion(*second))
            assert gap is not None
            assert (f"{gap.low:.4f}", f"{gap.high:.4f}") == (low, high)


@given(rates(), rates())
def test_a_difference_lies_in_its_interval_and_turns_with_its_sides(
    one: Proportion, two: Proportion
) -> None:
    gap, turned = difference(one, two), difference(two, one)
    assert gap is not None
    assert turned is not None
    assert -1 <= gap.low <= gap.value <= gap.high <= 1
    assert (-turned.high, -turned.low) == pytest.approx((gap.low, gap.high), abs=1e-12)
    assert gap.tells == (gap.low > 0 or gap.high < 0)


@given(st.lists(st.integers(0, 1_023), min_size=1))
def test_small_values_have_exact_percentiles(values: list[int]) -> None:
    spread = spread_of(values)
    assert spread.median == statistics.median(map(Fraction, values))
    assert spread.mean == Fraction(sum(values), len(values))
    for permille in (1, 500, 950, 990, 1_000):
        rank = math.ceil(Fraction(permille * len(values), 1_000))
        assert spread.quantile(permille) == sorted(values)[rank - 1]


@given(st.lists(st.integers(0, 10**13), min_size=1), st.sampled_from([1, 500, 950, 990, 1_000]))
def test_large_values_have_percentiles_within_one_in_1024(values: list[int], permille: int) -> None:
    spread = spread_of(values)
    exact = sorted(values)[math.ceil(Fraction(permille * len(values), 1_000)) - 1]
    found = spread.quantile(permille)
    assert found is not None
    assert abs(found - exact) * 1_024 <= exact
    assert found <= spread.most == max(values)
    assert spread.total == sum(values)


@given(st.lists(st.integers(0, 10**9)), st.lists(st.integers(0, 10**9)))
def test_spreads_add_up(one: list[int], two: list[int]) -> None:
    merged = spread_of(one)
    merged.merge(spread_of(two))
    whole = spread_of(one + two)
    assert list(merged.items()) == list(whole.items())
    assert (merged.n, merged.total, merged.most) == (whole.n, whole.total, whole.most)


def test_a_spread_of_nothing_is_undefined() -> None:
    spread = Spread()
    assert (spread.mean, spread.median, spread.quantile(500)) == (None, None, None)
    with pytest.raises(ValueError, match="negative"):
        spread.add(-1)
    with pytest.raises(IndexError):
        spread._at(1)


def test_a_spreads_memory_does_not_grow_with_its_values() -> None:
    spread, random = Spread(), Random(1)
    for _ in range(50_000):
        spread.add(random.getrandbits(random.randrange(1, 40)))
    assert len(spread.counts) <= 1_024 + 512 * 30


def test_a_bootstrap_is_the_same_again_and_around_the_difference() -> None:
    one, two = spread_of([1, 1, 2, 3] * 40), spread_of([2, 3, 3, 3] * 40)
    gap = mean_difference(one, two)
    assert gap == mean_difference(one, two)
    assert gap is not None
    assert gap.value == -1.0
    # by the normal approximation: the spread of either mean, joined
    half = Z * math.sqrt(
        statistics.pvariance([1, 1, 2, 3]) / 160 + statistics.pvariance([2, 3, 3, 3]) / 160
    )
    assert (gap.low, gap.high) == pytest.approx((-1 - half, -1 + half), abs=0.05)
    assert gap.tells


def test_a_bootstrap_of_fewer_than_two_values_is_undefined() -> None:
    many = spread_of([1, 2, 3])
    for few in (Spread(), spread_of([2])):
        assert mean_difference(few, many) is None
        assert mean_difference(many, few) is None
    assert mean_difference(spread_of([2, 2]), spread_of([1, 1])) == Gap(1.0, 1.0, 1.0)


def test_binomial_draws_have_their_mean_and_variance() -> None:
    random = Random(3)
    for n, share in ((10, 0.3), (33, 0.9), (1_000, 0.02), (1_000_000, 0.5)):
        drawn = [binomial(n, share, random) for _ in range(2_000)]
        sigma = math.sqrt(n * share * (1 - share))
        assert statistics.mean(drawn) == pytest.approx(n * share, abs=4 * sigma / math.sqrt(2_000))
        assert statistics.stdev(drawn) == pytest.approx(sigma, rel=0.1)
        assert all(0 <= count <= n for count in drawn)


def spread_of(values: list[int]) -> Spread:
    spread = Spread()
    for value in values:
        spread.add(value)
    return spread
