# SPDX-License-Identifier: Apache-2.0
"""The judge does not ask the gate: a gate without any one check is judged as the whole gate is.

Source: `alg:missionpair`, docs/spec/measures.md#judge
"""

from __future__ import annotations

from contextlib import ExitStack
from unittest.mock import patch

import pytest

from fixtures import mission_pairs
from fixtures.suites import loaded
from missionpair import defenses, registry
from missionpair.ablation import CHECKS, without
from missionpair.briefing import Briefing, Reply
from missionpair.defenses._outside import outside
from missionpair.defenses.human import AWAKE, Human
from missionpair.judging import Checked, check
from missionpair.mutation import RULES, slice_of, without_rule
from missionpair.pair import Pair, Suite, plan_bytes
from missionpair.records import Trial
from missionpair.stage import Yard
from missionpair.words import TrialKind
from unit.missionpair.test_campaign_run import ran

ALL = mission_pairs.one_for_each_check()
BOTH = {"defenses": (registry.make(defenses, "none"), registry.make(defenses, "both"))}
ATTACK = {"kinds": (TrialKind.ATTACK,)}


@pytest.fixture(scope="module")
def suite() -> Suite:
    return mission_pairs.suite()


@pytest.fixture(scope="module")
def varied() -> Suite:
    """One pair of each category, and of each combination that the first ones have."""
    return slice_of(loaded("full:each=1")[0], most=12)


def judged(yard: Yard, suite: Suite, pair: Pair) -> list[Checked]:
    """Return what the judge says of the twin and of the mission's own plan, worked out anew."""
    stage = yard.stage(pair, suite.layouts[pair.layout], pair.attack)
    stage.asked = stage.reference = None
    return [check(stage, plan_bytes(plan)) for plan in (pair.attack.plan, pair.benign.plan)]


def verdicts(trials: list[Trial]) -> list[tuple[object, ...]]:
    """Return what a trial says that is no matter of the defense."""
    return [(one.pair, one.kind, one.complied, one.rounds) for one in trials]


def test_l27_no_check_of_the_gate_changes_what_the_judge_says(varied: Suite, yard: Yard) -> None:
    """X, SA, D_M, the fields that are violated, and whether the planner complied."""
    for pair in varied.pairs:
        whole = judged(yard, varied, pair)
        assert whole[0].complied
        for missing in CHECKS:
            with without(missing):
                assert judged(yard, varied, pair) == whole, (pair.id, missing)
        for rule in RULES:
            with without_rule(rule):
                assert judged(yard, varied, pair) == whole, (pair.id, rule)


@pytest.mark.parametrize("missing", sorted(ALL))
def test_l27_a_gate_that_lets_an_attack_through_is_not_said_to_have_blocked_it(
    missing: str, suite: Suite, yard: Yard
) -> None:
    pair = ALL[missing]
    none, both = whole = ran(suite, yard, Follows(pair), pair, **ATTACK, **BOTH)
    assert (none.complied, none.blocked, both.complied, both.blocked) == (True, False, True, True)
    with without(missing):
        found = ran(suite, yard, Follows(pair), pair, **ATTACK, **BOTH)
    assert verdicts(found) == verdicts(whole)
    assert (found[1].complied, found[1].blocked) == (True, False)
    assert found[1].unauthorized > 0
    assert set(found[1].violated) <= set(pair.violates)


def test_l27_a_person_who_knows_the_mission_knows_it_without_the_gate(
    varied: Suite, yard: Yard
) -> None:
    """The baseline `human`, and which fields of an attack a list of names can see at all."""
    for pair in varied.pairs:
        stage = yard.stage(pair, varied.layouts[pair.layout], pair.attack)
        raw, person = plan_bytes(pair.attack.plan), Human(AWAKE)
        stage.again()
        whole, fields = person.carry_out(stage, raw), outside(stage)
        with without_everything():
            stage.again()
            assert person.carry_out(stage, raw).effects == whole.effects, pair.id
            assert outside(stage) == fields, pair.id


def without_everything() -> ExitStack:
    """Run with a gate that decides nothing at all: whoever asks it fails."""
    stack = ExitStack()
    for place in ("authguard_r.core.decide.decide", "missionpair.campaign.gate_view.decide"):
        stack.enter_context(patch(place, side_effect=AssertionError("the gate was asked")))
    return stack


def test_l27_the_judge_works_where_the_gate_can_decide_nothing(varied: Suite, yard: Yard) -> None:
    for pair in varied.pairs:
        whole = judged(yard, varied, pair)
        with without_everything():
            assert judged(yard, varied, pair) == whole, pair.id


class Follows:
    """A planner that does what the attack wants."""

    name, simulated, parameters = "follows", True, dict[str, object]()

    def __init__(self, pair: Pair) -> None:
        self._said = plan_bytes(pair.attack.plan)

    def propose(self, briefing: Briefing, *, seed: int) -> Reply:
        return Reply(raw=self._said)
