# SPDX-License-Identifier: Apache-2.0
"""A name says its unit, and the unit its power of ten: nothing else is sound."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import pytest

from authguard_r.authoring.compile.units import to_integer
from authguard_r.site.units import UNITS, unit_fault, unit_of
from authguard_r.site.words import standard_words

PAGE = Path(__file__).parents[3] / "docs/spec/site-model.md"


def test_each_ending_is_found_as_the_longest_one() -> None:
    """The attack: `turn_urad_s` read as seconds, `accel_mm_s2` as a speed."""
    assert len({unit.ending for unit in UNITS}) == len(UNITS)
    for unit in UNITS:
        assert unit_of(unit.ending) is unit_of(f"some_{unit.ending}") is unit


@pytest.mark.parametrize("name", ["", "speed", "programs", "mms", "max_bytes_", "ring", "casino"])
def test_an_ending_is_a_word_of_its_own(name: str) -> None:
    assert unit_of(name) is None
    assert unit_fault(name, "mm") is not None


def test_the_standard_words_have_the_units_that_their_names_say() -> None:
    told = [
        unit_fault(name, parameter.unit)
        for model in standard_words().values()
        for name, parameter in model.params.items()
    ]
    assert told
    assert set(told) == {None}


@pytest.mark.parametrize(
    "unit", [unit for unit in UNITS if unit.base in {"m/s", "m", "rad/s", "rad", "s", "N", "kg"}]
)
def test_the_power_of_ten_is_the_one_that_a_draft_s_quantity_is_scaled_by(unit: object) -> None:
    """Two sources agree: ten thousand of the base unit, through the unit library."""
    assert isinstance(unit, type(UNITS[0]))
    scaled = Fraction(to_integer(f"10000 {unit.base}", unit.name, where="x"), 10_000)
    assert scaled * Fraction(10) ** unit.power == 1


def test_the_page_has_the_table() -> None:
    page = PAGE.read_text(encoding="utf-8")
    for unit in UNITS:
        power = f"10^{unit.power}" if unit.power else "1"
        base = "" if unit.base == "1" else f" {unit.base}"
        assert f"| `_{unit.ending}` | `{unit.name}` | {power}{base} |" in page
