# SPDX-License-Identifier: Apache-2.0
"""Bodies and parameters: one reading or none, and numbers as they were spelled."""

from __future__ import annotations

import json
from decimal import Decimal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from authguard_r.core.errors import MalformedError
from authguard_r.integrations.http.messages import Evaluation, Page
from authguard_r.integrations.http.reading import call_of, plan_of, read_body, read_words
from authguard_r.normalize import Dialect, read_plan
from authguard_r.normalize.bind import Binder
from fixtures import scenarios
from fixtures.cases import case

ASKED = b"""{"subject": {"type": "a", "id": "b"}, "resource": {"type": "robot", "id": "c"},
 "action": {"name": "navigate_to", "properties": {"destination": "Pharmacy", "speed": %s}}}"""


@pytest.mark.parametrize("spelled", ["0.1", "0.50", "5E-1", "0.30000000000000000000000000000001"])
def test_l3_a_number_reaches_the_gate_as_it_was_written(spelled: str) -> None:
    plan = call_of(read_body(ASKED % spelled.encode(), Evaluation).action)
    arguments = json.loads(plan, parse_float=Decimal)["plan"][0]["arguments"]
    assert arguments["speed"] == Decimal(spelled)


def test_a_call_is_the_plan_that_a_planner_would_have_written() -> None:
    binder = Binder(scenarios.site(), scenarios.binding())
    plan = call_of(read_body(ASKED % b"0.5", Evaluation).action)
    (step,) = read_plan(plan, binder=binder, dialect=Dialect("json")).steps
    assert (step.action.type, step.action.destination) == ("navigate", "pharmacy")


WORDS = st.text(st.characters(codec="utf-8"))
JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**30), 10**30) | WORDS,
    lambda inner: st.lists(inner, max_size=4)
    | st.dictionaries(WORDS, inner, max_size=4),
    max_leaves=12,
)  # fmt: skip


@given(name=WORDS, arguments=st.dictionaries(st.text(max_size=5), JSON))
def test_arguments_go_through_as_they_are(name: str, arguments: dict[str, object]) -> None:
    told = json.loads(plan_of(name, arguments))
    assert told == {"plan": [{"tool": name, "arguments": arguments}]}


@given(st.binary(max_size=60))
def test_any_bytes_are_a_question_or_malformed(data: bytes) -> None:
    with pytest.raises(MalformedError):
        read_body(data, Evaluation)


def test_a_parameter_has_one_spelling() -> None:
    for value in ["+1", " 1", "1.0", "1e3", "0x1", "\u0661", "", "-0", "1_0", "9" * 17]:
        with case(value):
            with pytest.raises(MalformedError) as refused:
                read_words([("first", value)], Page)
            assert refused.value.where == "parameters.first"


def test_parameters_are_read_once_each() -> None:
    assert read_words([("first", "7"), ("count", "3")], Page) == Page(first=7, count=3)
    with pytest.raises(MalformedError, match="once"):
        read_words([("first", "7"), ("first", "7")], Page)
