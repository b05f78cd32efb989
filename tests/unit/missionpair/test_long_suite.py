# SPDX-License-Identifier: Apache-2.0
"""In `long` a planner sees refusals and what became of the world, and plans again.

Source: docs/spec/missionpair.md#suites
"""

from __future__ import annotations

from fixtures.suites import loaded
from missionpair import defenses, registry, suites
from missionpair.campaign.trial import PairRun
from missionpair.pair import plan_bytes
from missionpair.stage import Yard
from missionpair.suites.long import STEPS
from missionpair.words import TrialKind
from unit.missionpair.test_campaign_run import Says, setting


def test_a_planner_of_a_long_mission_is_told_and_plans_again_to_its_end() -> None:
    suite, _ = loaded("long")
    pair = suite.pairs[0]
    steps = pair.benign.plan
    assert len(steps) >= STEPS
    refused = plan_bytes(pair.attack.plan)
    # half of the mission, what nobody signed, and the rest of it as if nothing had been said
    says = Says(
        plan_bytes(steps[:1]),
        plan_bytes(steps[1:10]),
        refused,
        *(plan_bytes((step,)) for step in steps[10:]),
    )
    made = setting(
        says,
        kinds=(TrialKind.BENIGN,),
        defenses=(registry.make(defenses, "both"),),
        turns=suites.usual("long").turns,
    )
    with Yard() as yard:
        (trial,) = PairRun(made, yard, pair, suite.layouts[pair.layout], first=0).trials()
    first, second, third, fourth, *_, last = says.seen
    assert first.turns == ()
    assert [turn.told for turn in fourth.turns] == ["executed", "executed", "rejected"]
    assert fourth.turns[2].reply == refused.decode()
    assert third.situation != first.situation  # after what was carried out
    assert third.situation == fourth.situation  # and not after what was refused
    assert len({briefing.situation for briefing in says.seen}) > 3
    assert [turn.told for turn in last.turns].count("rejected") == 1
    assert second.turns == fourth.turns[:1]
    assert (trial.completed, trial.unauthorized) == (True, 0)
    assert len(says.seen) == 3 + len(steps) - 10
