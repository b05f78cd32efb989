# SPDX-License-Identifier: Apache-2.0
"""From a sentence to motion: what was drafted, compiled and signed is enforced, and no more."""

from __future__ import annotations

from typing import Any

import pytest

from authguard_r.authoring.compile.answers import compile_plain
from authguard_r.authoring.drafting.profile import read_profile
from authguard_r.authoring.drafting.template import TemplateProposer
from authguard_r.core.action import Action
from authguard_r.core.standing import Outcome
from fixtures import scenarios

SENTENCE = "Carry P1 from the pharmacy to Nurse Station 101, then return to base"
FORCE = {"force_mn": 9_000}


def started(sentence: str, **options: Any) -> Any:
    """Return a gate on which the sentence's mission is active."""
    proposer = TemplateProposer(read_profile(), scenarios.START_MS)
    proposal = proposer.propose(
        sentence,
        scenarios.site(),
        robot=scenarios.RID,
        settled={"issuer": "operator-1", "window": "25 min"},
    )
    assert proposal.questions == ()
    mission = compile_plain(proposal.draft, scenarios.site(), now=scenarios.NOW, nonce="A" * 22)
    sim = scenarios.simulation(**options)
    sim.gate.management.activate(scenarios.token(mission))
    return sim


def hand(kind: str, item: str, at: str, **changes: Any) -> Action:
    fields = {"type": kind, "tool": "gripper", "object": item, "source": at, "params": FORCE}
    return Action(**{**fields, **changes})  # type: ignore[arg-type]


def test_the_delivery_that_was_said_is_carried_out() -> None:
    sim = started(SENTENCE)
    plan = [
        scenarios.navigate("dock", "pharmacy"),
        hand("pick", "package-p1", "pharmacy"),
        scenarios.navigate("pharmacy", "station-101"),
        hand("place", "package-p1", "station-101", destination="station-101"),
        scenarios.navigate("station-101", "dock"),
    ]
    assert [scenarios.propose(sim, action).outcome for action in plan] == [Outcome.SUCCEEDED] * 5
    assert sim.robot.state.places["package-p1"] == "station-101"
    assert sim.robot.state.region == "dock"


@pytest.mark.parametrize(
    ("action", "reason"),
    [
        (scenarios.navigate("dock", "station-101"), "DESTINATION_OUT_OF_SCOPE"),
        (scenarios.navigate("dock", "office-1"), "DESTINATION_OUT_OF_SCOPE"),
        (scenarios.navigate("dock", "pharmacy", speed=900), "PARAMETER_OUT_OF_BOUNDS"),
        (hand("pick", "package-p2", "pharmacy"), "OBJECT_OUT_OF_SCOPE"),
        (Action(type="announce", tool="speaker"), "ACTION_OUT_OF_SCOPE"),
    ],
)
def test_what_was_not_said_is_refused(action: Action, reason: str) -> None:
    report = scenarios.propose(started(SENTENCE), action)
    assert report.outcome is None
    assert reason in [str(found) for found in report.judged.decision.reasons]


def test_a_return_on_low_battery_is_refused_while_the_battery_is_full() -> None:
    """The paper's case: the same motion, with the guard that the sentence asked for."""
    start = scenarios.world("pharmacy")
    home = scenarios.navigate("pharmacy", "dock")
    full = scenarios.propose(started("return to base when the battery is low", start=start), home)
    assert "GUARD_FALSE" in [str(found) for found in full.judged.decision.reasons]
    low = scenarios.msgspec.structs.replace(start, battery_permille=150)
    report = scenarios.propose(started("return to base when the battery is low", start=low), home)
    assert report.outcome is Outcome.SUCCEEDED
