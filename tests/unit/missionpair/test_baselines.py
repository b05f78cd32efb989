# SPDX-License-Identifier: Apache-2.0
"""Baselines with a fair chance, honest plans that are not ideal, and an attacker whom codes help.

Source: docs/spec/defenses.md, docs/spec/measures.md#deviation-tries-leakage
"""

from __future__ import annotations

from collections import Counter
from typing import Any

import pytest

from fixtures import campaign_records
from fixtures.suites import loaded
from missionpair import attackers, defenses, planners, registry
from missionpair.campaign.worker import require_reader
from missionpair.defenses import Defense, DefenseError
from missionpair.execution import ExecutedPlan
from missionpair.measures import MeasuredCampaign, mean_difference
from missionpair.mutation import slice_of
from missionpair.pair import Pair, Suite, plan_bytes
from missionpair.records import Trial
from missionpair.stage import Yard
from missionpair.words import Access, Category, TrialKind
from unit.missionpair.test_campaign_run import ran

pytestmark = pytest.mark.complete

ATTACK, BENIGN = (TrialKind.ATTACK,), (TrialKind.BENIGN,)


@pytest.fixture(scope="module")
def suite() -> Suite:
    return slice_of(loaded("full:each=1")[0], most=48)


def made(spec: str) -> Defense:
    found: Defense = registry.make(defenses, spec)
    return found


def attacked(defense: Defense, suite: Suite, pair: Pair, yard: Yard) -> ExecutedPlan:
    layout = suite.layouts[pair.layout]
    stage = yard.stage(pair, layout, pair.attack, safety_gate=defense.safety_gate)
    stage.show(pair.inputs)
    defense.begin(seed=0)
    return defense.carry_out(stage, plan_bytes(pair.attack.plan))


def let_through(spec: str, suite: Suite, yard: Yard) -> Counter[str]:
    """Return how many attacks of each category a defense lets through."""
    found: Counter[str] = Counter()
    for pair in suite.pairs:
        carried = attacked(made(spec), suite, pair, yard)
        found[pair.categories[0]] += any(not effect.authorized for effect in carried.effects)
    return found


def is_done(spec: str, suite: Suite, pair: Pair, yard: Yard) -> bool:
    defense = made(spec)
    stage = yard.stage(pair, suite.layouts[pair.layout], pair.benign)
    defense.begin(seed=0)
    return defense.carry_out(stage, plan_bytes(pair.benign.plan)).completed


@pytest.mark.parametrize("spec", ["cedar:context=full", "pertool"])
def test_a_baseline_stops_no_benign_run(spec: str, suite: Suite, yard: Yard) -> None:
    failed = [pair.id for pair in suite.pairs if not is_done(spec, suite, pair, yard)]
    assert failed == []


def test_cedar_with_what_its_caller_remembers_stops_what_it_cannot_know_itself(
    suite: Suite, yard: Yard
) -> None:
    plain, full = (let_through(f"cedar:context={c}", suite, yard) for c in ("action", "full"))
    for category in (Category.REPLAY, Category.APPROVAL, Category.PROVENANCE):
        assert full[category] < plain[category], category
    assert sum(full.values()) < sum(plain.values())
    assert all(full[category] <= plain[category] for category in plain)


def test_a_policy_for_each_tool_stops_values_and_no_rows(suite: Suite, yard: Yard) -> None:
    found = let_through("pertool", suite, yard)
    assert found[Category.PARAMETER] == 0
    assert found[Category.REPLAY] > 0
    assert found[Category.APPROVAL] > 0


@pytest.mark.parametrize("name", ["hijacked", "adversary", "noisy", "prober"])
def test_a_rule_is_not_scored_with_a_planner_that_reads_none(name: str) -> None:
    with pytest.raises(DefenseError, match=f"`prompt` is a rule for the planner, and `{name}`"):
        require_reader(planners.make(name), (made("none"), made("prompt")))
    require_reader(planners.make(name), (made("none"), made("both")))
    require_reader(planners.make("graded"), (made("prompt"),))


def benign(suite: Suite, yard: Yard, spec: str, **more: Any) -> list[Trial]:
    found: list[Trial] = []
    for pair in suite.pairs:
        given = {"kinds": BENIGN, "defenses": (made("both"),), **more}
        found += ran(suite, yard, planners.make(spec), pair, **given)
    return found


def test_honest_plans_that_are_not_ideal_are_refused_now_and_then(suite: Suite, yard: Yard) -> None:
    """FRR of work as it comes; of the author's own plans it is 0 by construction."""
    few = slice_of(suite, most=16)
    ideal = benign(few, yard, "noisy:share=0")
    assert all(trial.completed for trial in ideal)
    real = benign(few, yard, "noisy:share=0.4", seeds=3)
    refused = [trial for trial in real if not trial.completed]
    assert 0 < len(refused) < len(real)
    assert sum(trial.unauthorized for trial in real) == 0
    assert {trial.by for trial in refused} <= {"authorization", "world"}


def test_who_sees_codes_finds_the_attack_in_fewer_tries(yard: Yard) -> None:
    """The interval leaves 0 out: codes say which check is missing."""
    full = loaded("full:each=1")[0]
    pairs = [pair for pair in full.pairs if pair.categories == (Category.OBJECT,)][::4]
    spreads = {}
    for access in (Access.WHITE, Access.BLACK):
        measured = MeasuredCampaign(campaign_records.campaign())
        for pair in pairs:
            more = {"kinds": ATTACK, "rounds": 80, "access": access}
            more |= {"attacker": registry.make(attackers, "search")}
            more |= {"defenses": (made("weakened:without=check_object"),)}
            for trial in ran(full, yard, planners.make("prober"), pair, **more):
                measured.add(trial)
        spreads[access] = measured.tally("weakened-object").rounds
    gap = mean_difference(spreads[Access.WHITE], spreads[Access.BLACK])
    assert gap is not None
    assert gap.high < 0, gap


def test_a_gate_without_a_check_is_asked_for_by_its_name() -> None:
    with pytest.raises(DefenseError, match=r"one of check_certificate, .*check_destination"):
        made("weakened:without=check_nothing")
    assert made("weakened:without=check_route").name == "weakened-route"
