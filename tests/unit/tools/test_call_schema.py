# SPDX-License-Identifier: Apache-2.0
"""The schema that a model is shown promises nothing that its binding refuses."""

from __future__ import annotations

import json
from copy import deepcopy
from typing import Any

import jsonschema
import pytest

from authguard_r.core.errors import MalformedError
from authguard_r.integrations.tools.argument_schema import MAX_NAMES
from authguard_r.integrations.tools.call_schema import narrowed
from authguard_r.normalize.bind import Binder
from authguard_r.normalize.dialects import Call
from authguard_r.normalize.parse import read_json
from fixtures.cases import case
from unit.normalize.bound import NOTED, REFUSED, fixed, load, mapped, site, square

WORDS = {"slow": 200, "fast": 800}
GO: dict[str, Any] = {
    "type": "navigate",
    "tool": "base",
    "attested": ["source"],
    "arguments": {
        "to": mapped("destination"),
        "speed": mapped("params.speed_mm_s", per_unit="1000", optional=True, default=500),
        "camera": REFUSED,
        "why": NOTED,
        "plan.tree": fixed("", optional=True),
        "plan.raw": REFUSED,
        "extra.raw": REFUSED,
    },
}
SCHEMA: dict[str, Any] = {
    "type": "object",
    "properties": {
        "to": {"type": "string", "description": "where to"},
        "speed": {"type": "number", "description": "How fast."},
        "camera": {"type": "boolean"},
        "why": {"type": "string"},
        "plan": {
            "type": "object",
            "properties": {"tree": {"type": "string"}, "raw": {"type": "string"}},
            "required": ["raw", "tree"],
        },
        "extra": {"type": "object", "properties": {"raw": {"type": "string"}}},
    },
    "required": ["speed", "camera", "why", "extra"],
}


def shown(tool: Any = GO, schema: dict[str, Any] = SCHEMA) -> dict[str, Any]:
    place = site(hall=square(9_000, names=("The Hall",)))
    return narrowed(schema, "go", load({"go": tool}, place), place)


def test_names_ranges_and_units_are_spelled_out_and_refused_fields_left_out() -> None:
    before = deepcopy(SCHEMA)
    assert shown() == {
        "type": "object",
        "properties": {
            "to": {
                "type": "string",
                "description": "where to",
                "enum": ["Square 1", "Square 2", "Square 3", "The Hall"],
            },
            "speed": {
                "type": "number",
                "description": "How fast, in m/s",
                "minimum": 0.001,
                "maximum": 3,
                "default": 0.5,
            },
            "why": {"type": "string"},
            "plan": {"type": "object", "properties": {"tree": {"enum": [""]}}, "required": []},
        },
        "required": ["to"],
    }
    assert before == SCHEMA


def test_a_call_that_keeps_to_the_schema_is_bound_and_its_near_misses_are_not() -> None:
    place = site(hall=square(9_000, names=("The Hall",)))
    binding = load({"go": GO}, place)
    closed = {**narrowed(SCHEMA, "go", binding, place), "additionalProperties": False}
    binder = Binder(place, binding)
    for text in (
        '{"to": "The Hall"}',
        '{"to": "Square 2", "speed": 3}',
        '{"to": "Square 2", "speed": 0.001, "why": "asked", "plan": {"tree": ""}}',
    ):
        with case(text):
            jsonschema.validate(json.loads(text), closed)
            binder.bind(Call("go", read_json(text, where="a"), "a"))
    for text in (
        "{}",
        '{"to": "the hall"}',
        '{"to": "The Hall", "speed": 3.1}',
        '{"to": "The Hall", "camera": true}',
        '{"to": "The Hall", "plan": {"tree": "x"}}',
        '{"to": "The Hall", "extra": {"raw": ""}}',
    ):
        with case(text):
            with pytest.raises(jsonschema.ValidationError):
                jsonschema.validate(json.loads(text), closed)
            with pytest.raises(MalformedError):
                binder.bind(Call("go", read_json(text, where="a"), "a"))


def test_words_of_a_parameter_are_its_enum() -> None:
    pace = mapped("params.speed_mm_s", values=WORDS)
    tool = {**GO, "arguments": {"to": mapped("destination"), "speed": pace}}
    assert shown(tool)["properties"]["speed"]["enum"] == ["slow", "fast"]


def test_what_only_one_of_several_ways_refuses_stays() -> None:
    ways = [
        {**GO, "when": {"mode": "a"}, "arguments": {"to": mapped("destination"), "camera": REFUSED,
         "speed": mapped("params.speed_mm_s", per_unit="1000")}},
        {**GO, "when": {"mode": "b"}, "arguments": {"to": mapped("destination"), "camera": NOTED,
         "speed": mapped("params.speed_mm_s", per_unit="1000")}},
    ]  # fmt: skip
    assert shown(ways)["properties"]["camera"] == SCHEMA["properties"]["camera"]


def test_a_site_with_too_many_names_spells_none_and_a_tool_without_binding_is_left_alone() -> None:
    many = {f"r{n}": square(9_000 + 3_000 * n, names=(f"Room {n}",)) for n in range(MAX_NAMES)}
    place = site(**many)
    found = narrowed(SCHEMA, "go", load({"go": GO}, place), place)
    assert found["properties"]["to"] == {"type": "string", "description": "where to"}
    assert narrowed(SCHEMA, "other", load({"go": GO}, place), place) is SCHEMA


@pytest.mark.parametrize("schema", [{}, {"properties": []}, {"properties": {"to": True}}])
def test_a_schema_that_says_nothing_is_shown_as_it_is(schema: dict[str, Any]) -> None:
    assert shown(schema=schema) == schema
