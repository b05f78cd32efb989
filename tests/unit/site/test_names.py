# SPDX-License-Identifier: Apache-2.0
"""Names that a reviewer could take for each other are refused; others are not."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from authguard_r.site.names import shown, skeleton
from fixtures.cases import case

ROOT = Path(__file__).resolve().parents[3]
CONFUSABLES = ROOT.parent / "shared" / "external" / "confusables" / "woodgern_confusables.txt"

LOOK_ALIKE = [
    ("Office 1", "office 1"),
    ("Office 1", "Office  1"),
    ("Office 1", "Office\u00a01"),
    ("Office 1", "Office-1"),
    ("Office 1", "Office l"),
    ("Office 1", "Office I"),
    ("Office 1", "0ffice 1"),
    ("Office 1", "\u041effice 1"),  # Cyrillic O
    ("Office 1", "Offi\u0441e 1"),  # Cyrillic es
    ("Office 1", "\uff2fffice 1"),  # full width
    ("Office 1", "Office\u200b 1"),  # zero-width space
    ("Office 1", "Office\u202d 1"),  # bidirectional override
    ("Office 1", "O\ufb03ce 1"),  # a ligature
    ("Office 1", "\u00d3ffice 1"),  # an accent
    ("Office 1", "Office \u0661".replace("\u0661", "\uff11")),
    ("Bay", "\u0412ay"),
    ("corner", "comer"),
    ("wavve", "wawe"),
    ("Stra\u00dfe", "STRASSE"),
]


def test_names_that_look_alike_have_one_skeleton() -> None:
    for one, other in LOOK_ALIKE:
        with case(one, other):
            assert skeleton(one) == skeleton(other)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("Office 1", "Office 2"),
        ("Office 1", "Office 11"),
        ("Office 1", "Offices 1"),
        ("Room 101", "Room 102"),
        ("P1", "P2"),
        ("/cmd_vel", "/cmd_vel/"),
        ("north", "south"),
    ],
)
def test_names_that_a_reviewer_can_tell_apart_have_two(one: str, other: str) -> None:
    assert skeleton(one) != skeleton(other)


@pytest.mark.parametrize("name", ["-", "_.:", "\u200b", "\u0301"])
def test_a_name_of_which_nothing_is_left_stands_for_itself(name: str) -> None:
    assert skeleton(name) == name


@given(st.text())
def test_case_and_space_never_make_another_name(name: str) -> None:
    assert skeleton(f" {name}\t".strip() or "x") == skeleton(name.strip() or "x")
    assert skeleton(skeleton(name).upper()) == skeleton(skeleton(name))


@given(st.text())
def test_a_name_in_a_message_is_short_printable_ascii(name: str) -> None:
    told = shown(name)
    assert told.isascii()
    assert told == "" or told.isprintable()
    assert len(told) <= 700
    assert shown("Office 1") == "Office 1"


@pytest.mark.external
@pytest.mark.skipif(not CONFUSABLES.is_file(), reason=f"no public test data at {CONFUSABLES}")
def test_published_look_alikes_of_letters_and_digits_are_mostly_caught() -> None:
    """The list has rare scripts too; what a text can hide among Latin letters must be caught."""
    pairs = []
    for line in CONFUSABLES.read_text(encoding="utf-8-sig").splitlines():
        fields = [field.strip() for field in line.split("#")[0].split(";")]
        if len(fields) >= 3:
            twin, original = ("".join(chr(int(c, 16)) for c in f.split()) for f in fields[:2])
            if len(twin) == 1 and original.isascii() and original.isalnum():
                pairs.append((twin, original))
    common = [
        (twin, original)
        for twin, original in pairs
        if 0x0400 <= ord(twin) <= 0x045F or 0xFF00 <= ord(twin) <= 0xFF5A or ord(twin) >= 0x1D400
    ]
    missed = [hex(ord(twin)) for twin, original in common if skeleton(twin) != skeleton(original)]
    assert len(common) > 700
    assert len(missed) <= len(common) // 10, missed
