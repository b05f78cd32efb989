# SPDX-License-Identifier: Apache-2.0
"""d_j are protected fields with weights: each reason code violates one, and D_M weighs them."""

from __future__ import annotations

import re
from fractions import Fraction
from random import Random

import pytest

import authguard_reference as oracle
from authguard_r.audit.deviation import FIELD_OF, deviation, violated_fields
from authguard_r.core.mission import ProtectedField
from authguard_r.core.reasons import DECIDED, ORDER, Reason
from authguard_reference.reasons import FIELD_OF as ORACLE_FIELD_OF
from authguard_reference.reasons import FIELDS as ORACLE_FIELDS
from fixtures import scenarios
from fixtures.decision_cases import ALONE, accepted_case, decide_case

#: The fields that the paper protects.
FIELDS = {
    *("robot", "mission", "type", "tool", "object", "source", "destination", "route"),
    *("parameters", "state", "time", "provenance", "approval", "order", "use"),
}


def test_the_protected_fields_are_the_papers() -> None:
    assert {*map(str, ProtectedField)} == {*ORACLE_FIELDS} == FIELDS


def test_every_reason_that_decide_can_give_violates_the_one_field_that_the_oracle_names() -> None:
    assert {str(reason): str(FIELD_OF[reason]) for reason in DECIDED} == ORACLE_FIELD_OF
    assert {*FIELD_OF.values()} == {*ProtectedField}


def test_a_reason_that_compares_no_action_with_a_mission_violates_no_field() -> None:
    unread = {Reason.MALFORMED, Reason.NOT_CANONICAL, Reason.WRONG_KIND}
    normalizing = {r for r in Reason if ORDER[r] >= ORDER[Reason.INPUT_TOO_LARGE]}
    assert {*Reason} - {*FIELD_OF} == (unread | normalizing) - {Reason.NO_ACTIVE_MISSION}


def test_a_hijacked_destination_deviates_by_one_field_of_fifteen() -> None:
    hijacked = decide_case(ALONE["DESTINATION_OUT_OF_SCOPE"](Random(3)))
    assert violated_fields(hijacked.reasons) == (ProtectedField.DESTINATION,)
    assert deviation(hijacked.reasons, {}) == Fraction(1, 15)
    assert deviation(hijacked.reasons, {ProtectedField.DESTINATION: 6}) == Fraction(6, 20)
    assert deviation(hijacked.reasons, {ProtectedField.OBJECT: 6}) == Fraction(1, 20)


def test_the_page_of_fields_is_the_table() -> None:
    page = (scenarios.ROOT / "docs" / "spec" / "reason-codes.md").read_text(encoding="utf-8")
    told: dict[str, set[Reason]] = {}
    for line in page.partition("## Protected fields")[2].splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if cells[0] in FIELDS:
            told[cells[0]] = set(map(Reason, re.findall("`([A-Z_]+)`", cells[1])))
    for first, last in re.findall(
        "from `([A-Z_]+)` to `([A-Z_]+)`", page.partition("| mission |")[2]
    ):
        told["mission"] |= {
            r for r in Reason if ORDER[Reason(first)] <= ORDER[r] <= ORDER[Reason(last)]
        }
    assert told == {
        str(field): {reason for reason, one in FIELD_OF.items() if one is field}
        for field in ProtectedField
    }


def test_two_codes_of_one_field_count_once() -> None:
    codes = [Reason.SOURCE_OUT_OF_SCOPE, Reason.SOURCE_NOT_ATTESTED]
    assert deviation(codes, {}) == Fraction(1, 15)


def test_deviation_is_zero_exactly_for_what_complies_and_one_when_all_is_violated() -> None:
    assert deviation(decide_case(accepted_case(Random(1))).reasons, {}) == 0
    assert deviation(FIELD_OF, {}) == 1
    assert deviation([Reason.BUSY], {}) == 0


@pytest.mark.parametrize("reason", sorted(ALONE))
def test_the_deviation_of_each_reason_is_the_oracles(reason: str) -> None:
    found = decide_case(ALONE[reason](Random(3))).reasons
    assert 0 < deviation(found, {}) < 1
    weights = {FIELD_OF[Reason(reason)]: 10, ProtectedField.TIME: 3}
    plain = {str(field): weight for field, weight in weights.items()}
    assert deviation(found, weights) == oracle.action_deviation([*map(str, found)], plain)
