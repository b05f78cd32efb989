# SPDX-License-Identifier: Apache-2.0
"""Sides of a line and stopping distances, in exact integers."""

from __future__ import annotations

import random

import pytest

from authguard_r.core.geometry import Point
from authguard_r.site.shapes import side, stopping_margin


@pytest.mark.parametrize(
    ("point", "wanted"), [((0, 1), 1), ((5, 0), 0), ((0, -1), -1), ((-5, 0), 0)]
)
def test_left_is_one_and_right_is_minus_one(point: Point, wanted: int) -> None:
    assert side((0, 0), (10, 0), point) == wanted


def test_a_stopping_margin_covers_reaction_and_braking_rounded_up() -> None:
    dice = random.Random("stopping")
    for _ in range(10_000):
        margin, speed = dice.randint(0, 1_000), dice.randint(-5_000, 5_000)
        reaction, brake = dice.randint(0, 2_000), dice.randint(1, 5_000)
        got = stopping_margin(margin, speed, reaction_ms=reaction, brake_mm_s2=brake)
        exact = margin + abs(speed) * reaction / 1_000 + speed * speed / (2 * brake)
        assert exact - 1e-6 <= got < exact + 2
    assert stopping_margin(150, 0, reaction_ms=500, brake_mm_s2=1_000) == 150
    assert stopping_margin(150, 800, reaction_ms=200, brake_mm_s2=1_000) == 150 + 160 + 320
    assert stopping_margin(0, -1, reaction_ms=1, brake_mm_s2=1_000) == 2
