# SPDX-License-Identifier: Apache-2.0
"""One spelling of reports, and exactly what a planner is told of one at each level."""

from __future__ import annotations

import msgspec
import pytest

from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Outcome
from authguard_r.enforcement.json_views import report_json
from authguard_r.enforcement.report import Refusal, Report
from authguard_r.sim.robot import Faults
from authguard_r.wire.disclosure import Disclosure, disclosed
from fixtures import scenarios

ALWAYS = {"outcome", "reasons", "released", "executed", "seq", "execution"}
DECIDED = ALWAYS | {"retryable", "required_approvals"}


def refused() -> Report:
    sim = scenarios.simulation()
    sim.gate.management.activate(scenarios.token())
    report: Report = scenarios.propose(sim, scenarios.navigate("dock", "office-1"))
    return report


def unread() -> Report:
    return Report(judged=None, refusal=Refusal(Reason.MALFORMED, "input[3]", "expected a name"))


def aborted() -> Report:
    sim = scenarios.simulation(faults=Faults(drift_to="office-2"))
    sim.gate.management.activate(scenarios.token())
    report: Report = scenarios.propose(sim, scenarios.navigate("dock", "pharmacy"))
    return report


def test_codes_tell_codes_and_no_field() -> None:
    told = disclosed(report_json(refused()), Disclosure.CODES)
    assert told.keys() == DECIDED
    assert told["reasons"][0] == "DESTINATION_OUT_OF_SCOPE"
    assert "office-1" not in msgspec.json.encode(told).decode()
    assert disclosed(report_json(unread()), Disclosure.CODES).keys() == ALWAYS | {"retryable"}


def test_fields_tell_the_field_and_not_what_was_expected_there() -> None:
    told = disclosed(report_json(refused()), Disclosure.FIELDS)
    assert told.keys() == DECIDED | {"findings", "refusal"}
    assert told["findings"][0].keys() == {"field", "reason", "step"}
    assert "pharmacy" not in msgspec.json.encode(told).decode()
    bare = disclosed(report_json(unread()), Disclosure.FIELDS)
    place = {"field": "input[3]", "reason": "MALFORMED", "step": 0}
    assert (bare["findings"], bare["refusal"]["where"]) == ([place], "input[3]")


def test_full_tells_everything_that_the_report_says() -> None:
    report = report_json(refused())
    assert disclosed(report, Disclosure.FULL) == report
    assert report["findings"][0]["expected"]
    assert report["action"]["destination"] == "office-1"


@pytest.mark.parametrize("level", [Disclosure.CODES, Disclosure.FIELDS])
def test_why_a_motion_ended_is_told_as_codes_alone(level: Disclosure) -> None:
    report = report_json(aborted())
    assert report["execution"]["reasons"][0].keys() >= {"field", "reason", "expected", "got"}
    told = disclosed(report, level)
    assert told["execution"] == {
        "outcome": "aborted",
        "reasons": ["OUTSIDE_REGIONS"],
        "recorded": True,
    }


@pytest.mark.parametrize(
    ("outcome", "executed"),
    [(None, False), (Outcome.NOT_STARTED, False), (Outcome.FAILED, True), (Outcome.UNKNOWN, True)],
)
def test_what_was_executed_is_what_began(outcome: Outcome | None, executed: bool) -> None:
    report = msgspec.structs.replace(refused(), outcome=outcome)
    assert report_json(report)["executed"] is executed


def test_a_report_without_a_decision_and_without_a_refusal_is_still_a_refusal() -> None:
    told = report_json(Report(judged=None))
    assert (told["outcome"], told["reasons"], told["refusal"]) == ("reject", [], None)


def test_both_gates_answers_are_spelled_and_a_repair_is_an_action() -> None:
    near = msgspec.structs.replace(scenarios.world(), human_distance_mm=500)
    sim = scenarios.simulation(start=near)
    sim.gate.management.activate(scenarios.token())
    told = report_json(scenarios.propose(sim, scenarios.navigate("dock", "pharmacy")))
    assert told["safety"]["safe"] is False
    assert told["safety"]["repair"]["type"] == "navigate"
    assert report_json(refused())["safety"] == "not evaluated"
    safe = report_json(aborted())
    assert (safe["safety"]["repair"], safe["grant"]) == (None, "go-to-pharmacy")
