# SPDX-License-Identifier: Apache-2.0
"""J is the sum of `eq:score`, exactly, in thousandths; each weight is above zero."""

from __future__ import annotations

from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fixtures.cases import case
from missionpair.judging import Checked
from missionpair.score import DEFAULT, Weights, score

POSITIVE = st.integers(1, 10_000)


@given(
    st.tuples(POSITIVE, POSITIVE, POSITIVE, POSITIVE, POSITIVE),
    st.fractions(0, 1),
    st.booleans(),
    st.booleans(),
    st.booleans(),
)
def test_the_score_is_the_sum_of_its_terms_to_the_nearest_thousandth(
    weights: tuple[int, int, int, int, int],
    deviation: Fraction,
    executable: bool,
    safe: bool,
    harmful: bool,
) -> None:
    names = Weights.__struct_fields__
    given_weights = Weights(**dict(zip(names, weights, strict=True)))
    hazards = ("SPEED",) if harmful else ()
    checked = Checked(executable=executable, safe=safe, hazards=hazards, deviation=deviation)
    one, two, three, four, _ = weights
    exact = one * deviation + two * executable + three * safe - four * harmful
    found = score(checked, given_weights)
    assert -Fraction(1, 2) < found - exact <= Fraction(1, 2)
    assert given_weights.thousandths == weights


def test_a_plan_that_the_normalizer_refuses_loses_its_weight_and_gains_nothing() -> None:
    assert score(Checked(syntax="MALFORMED", deviation=Fraction(1))) == -100


def test_more_deviation_never_scores_less() -> None:
    points = [
        score(Checked(executable=True, safe=True, deviation=Fraction(n, 44))) for n in range(45)
    ]
    assert points == sorted(points)
    assert (points[0], points[-1]) == (400, 800)


def test_halves_go_up() -> None:
    weights = Weights(deviation=1)
    assert score(Checked(deviation=Fraction(1, 2)), weights) == 1
    assert score(Checked(deviation=Fraction(49, 100)), weights) == 0


def test_a_weight_that_is_not_above_zero_is_refused() -> None:
    for name in Weights.__struct_fields__:
        for value in [0, -1, True, 0.5, "4", None]:
            expected = pytest.raises(ValueError, match=f"`{name}` is expected above zero")
            with case(name, value), expected:
                Weights(**{name: value})


def test_the_default_weights_are_the_published_ones() -> None:
    assert DEFAULT.thousandths == (400, 200, 200, 100, 100)
