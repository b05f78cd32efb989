# SPDX-License-Identifier: Apache-2.0
"""The paper's motivating scenario, end to end (section "Motivating Scenario")."""

from __future__ import annotations

from authguard_r.core.standing import Outcome
from authguard_r.sim.robot import Faults
from fixtures import scenarios


def test_the_first_leg_is_carried_out() -> None:
    sim = scenarios.simulation()
    sim.gate.management.activate(scenarios.token())
    report = scenarios.propose(sim, scenarios.navigate("dock", "pharmacy"))
    assert report.outcome is Outcome.SUCCEEDED
    assert sim.robot.state.region == "pharmacy"


def test_a_robot_that_leaves_its_way_is_stopped_and_the_reason_recorded() -> None:
    sim = scenarios.simulation(faults=Faults(drift_to="office-1"))
    sim.gate.management.activate(scenarios.token())
    report = scenarios.propose(sim, scenarios.navigate("dock", "pharmacy"))
    assert report.outcome is Outcome.ABORTED
    assert [str(f.reason) for f in report.reasons] == ["OUTSIDE_REGIONS"]
    assert sim.robot.state.speed_mm_s == 0
