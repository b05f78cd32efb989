# SPDX-License-Identifier: Apache-2.0
"""`missionpair validate`: the paper's two tables (`tab:pilot-results`, `tab:pilot-category`)."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import pytest

import authguard_reference as oracle
from fixtures.missionpair_program import told
from missionpair.selfchecks import SELF_CHECKS
from missionpair.suite import ATTACKS, BENIGN

pytestmark = pytest.mark.complete


def test_the_suite_has_the_papers_numbers() -> None:
    assert (len(SELF_CHECKS), len(ATTACKS), len(BENIGN)) == (16, 11, 7)
    groups = list(dict.fromkeys(check.group for check in SELF_CHECKS))
    assert groups == [
        "signature",
        "replay",
        "robot binding",
        "trusted state",
        "provenance",
        "approval signatures",
        "audit integrity",
    ]


def test_both_tables_are_the_papers(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    code, found = told(capsys, monkeypatch, "validate")
    assert code == 0
    assert found["self_checks_passed"] == 16
    assert [row["UASR"] for row in found["results"]] == [1.0, 1.0, 0.0]
    assert [row["SCMHR"] for row in found["results"]] == [1.0, 1.0, 0.0]
    assert [row["BTCR"] for row in found["results"]] == [1.0, 1.0, 1.0]
    assert [row["FRR"] for row in found["results"]] == [0.0, 0.0, 0.0]
    assert [row["SU"] for row in found["results"]] == [0.0, 0.0, 1.0]
    table = {row["category"]: row["AuthGuard-R + safety gate"] for row in found["categories"]}
    assert table["Provenance confusion"] == "0/2"
    assert sum(int(entry.split("/")[1]) for entry in table.values()) == 11
    for trial in found["trials"]:
        if trial["category"] != "benign" and not trial["system"].startswith("AuthGuard"):
            assert trial["oracle"][-1], trial  # the oracle says why it was unauthorized


def test_a_gate_without_a_check_lets_the_attack_through(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    code, found = told(capsys, monkeypatch, "validate", "--without", "check_destination")
    assert code == 1
    assert found["results"][2]["UASR"] > 0


def test_an_unknown_check_is_wrong_usage(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert told(capsys, monkeypatch, "validate", "--without", "check_nothing")[0] == 2


@pytest.mark.parametrize(
    ("uasr", "btcr", "su"),
    [(1, 1, 0), (0, 1, 1), (0, 0, 0), (Fraction(1, 2), 1, Fraction(2, 3)), (1, 0, None)],
)
def test_security_and_utility_are_weighed_together(uasr: Any, btcr: Any, su: Any) -> None:
    """Source: `eq:su`; undefined where its denominator is zero."""
    assert oracle.su(Fraction(uasr), Fraction(btcr)) == su


def test_rates_are_shares_and_undefined_without_trials() -> None:
    assert oracle.uasr(1, 4) == Fraction(1, 4)
    assert oracle.uasr(0, 0) is None
    assert oracle.btcr(7, 7) == 1
    assert oracle.frr(0, 7) == 0
    assert oracle.scmhr([1, 0]) == Fraction(1, 2)
    assert oracle.scmh(True, True, False) == 1
    assert [
        oracle.scmh(*c) for c in ((False, True, False), (True, False, False), (True, True, True))
    ] == [0, 0, 0]


@pytest.mark.parametrize(
    ("k", "n", "low", "high"),
    [(0, 10, 0.0, 0.28), (10, 10, 0.72, 1.0), (50, 60, 0.72, 0.91), (11, 60, 0.11, 0.30)],
)
def test_wilson_intervals_are_the_papers(k: int, n: int, low: float, high: float) -> None:
    """Source: `tab:pilot-live-llm`, `tab:pilot-qwen-fixed`."""
    found = oracle.wilson(k, n)
    assert [round(end, 2) for end in found] == [low, high]


def test_a_plans_deviation_is_its_worst_and_its_average() -> None:
    """Source: `eq:plan-deviation`; the product's and the oracle's agree."""
    from random import Random

    from authguard_r.enforcement.report import average_deviation, plan_deviation
    from fixtures.decision_cases import ALONE, decide_case

    plan = (*tuple(decide_case(ALONE[r](Random(1))).reasons for r in sorted(ALONE)), ())
    theirs = oracle.plan_deviation([[*map(str, reasons)] for reasons in plan], None)
    assert (plan_deviation(plan, {}), average_deviation(plan, {})) == theirs
    assert plan_deviation((), {}) == average_deviation((), {}) == 0
