# SPDX-License-Identifier: Apache-2.0
"""People who answer by a script: how long they take is stated, and the same for the same seed."""

from __future__ import annotations

import statistics
from random import Random

import pytest

from missionpair.approvers import Delay, DelayKind, read_delay


@pytest.mark.parametrize("text", ["fixed:2s", "exponential:3s", "lognormal:5s,0.8"])
def test_a_delay_is_drawn_again_alike_from_its_seed(text: str) -> None:
    delay = read_delay(text)
    drawn = [[delay.drawn_s(random) for _ in range(50)] for random in (Random(7), Random(7))]
    assert drawn[0] == drawn[1]
    assert all(seconds >= 0 for seconds in drawn[0])


@pytest.mark.parametrize(
    ("text", "middle"), [("fixed:2s", 2.0), ("exponential:3s", 3.0), ("lognormal:5s,0.8", 5.0)]
)
def test_a_delay_lies_around_what_it_states(text: str, middle: float) -> None:
    random, delay = Random(1), read_delay(text)
    drawn = [delay.drawn_s(random) for _ in range(4_000)]
    found = statistics.mean(drawn) if text.startswith("exp") else statistics.median(drawn)
    assert found == pytest.approx(middle, rel=0.1)


@pytest.mark.parametrize(
    "text", ["", "2s", "fixed:2", "fixed:2s,1", "lognormal:5s", "normal:5s,1", "fixed:-1s"]
)
def test_a_delay_that_states_no_distribution_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="expected fixed"):
        read_delay(text)


def test_nobody_who_takes_no_time_waits() -> None:
    for kind in DelayKind:
        assert Delay(kind=kind, median_s=0.0, sigma=1.0).drawn_s(Random(0)) == 0.0
