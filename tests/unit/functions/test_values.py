# SPDX-License-Identifier: Apache-2.0
"""Every word of what a function returned, and its fields: nothing that a model could read is lost.

Source: docs/spec/adapters.md#values
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

from authguard_r.integrations.functions.values import fields_of, sendable, words_of
from fixtures.cases import case

ROUND: list[Any] = []
ROUND.append(ROUND)


@dataclass
class Sight:
    sign: str

    def __str__(self) -> str:
        return "a sight"


class Model(BaseModel):
    sign: str


class Opaque:
    def __str__(self) -> str:
        return "opaque"


def test_every_word_is_told() -> None:
    for value, words, fields in [
        (None, ("",), None),
        ("Station 103", ("Station 103",), None),
        ({"sign": "é"}, ('{"sign":"é"}', "{'sign': 'é'}"), {"sign": "é"}),
        (Sight("x"), ('{"sign":"x"}', "a sight"), {"sign": "x"}),
        (Model(sign="x"), ('{"sign":"x"}', "sign='x'"), {"sign": "x"}),
        ([1], ("[1]",), None),
        (Opaque(), ('"opaque"', "opaque"), None),
        (ROUND, ("[[...]]",), None),
    ]:
        with case(value, words, fields):
            assert words_of(value) == words
            assert fields_of(value) == fields


def test_half_a_character_is_told_as_none() -> None:
    assert sendable(["a\ud800"]) == ("a?",)
    assert sendable([]) == ("",)
