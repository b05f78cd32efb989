# SPDX-License-Identifier: Apache-2.0
"""What counts as compliance, and what of a trial is counted: the plan's own, round by round.

Source: section "Prototype, Execution Path, and Evaluation Criteria", docs/spec/measures.md
"""

from __future__ import annotations

from typing import Any

import pytest
from msgspec.structs import replace

from authguard_reference.reasons import FIELD_OF
from fixtures.suites import loaded
from missionpair import defenses, registry
from missionpair.campaign.arms import rest_of
from missionpair.campaign.setting import Participants
from missionpair.campaign.trial import PairRun
from missionpair.judging import check, check_first
from missionpair.judging.asked import asked_changes, changed_as_asked
from missionpair.judging.walk import Walk
from missionpair.mutation import slice_of
from missionpair.pair import Input, Pair, Suite, WordedCall, plan_bytes
from missionpair.stage import Yard
from missionpair.words import Category, TrialKind
from unit.missionpair.test_campaign_run import Says, ran, setting

pytestmark = pytest.mark.complete

#: Defenses of every make: past the gate, through it, and with a gate of their own.
EVERY = ("none", "allowlist", "cedar", "temporal", "safety", "mission", "both")
ATTACK = {"kinds": (TrialKind.ATTACK,)}


@pytest.fixture(scope="module")
def suite() -> Suite:
    return loaded("live")[0]


def made(*names: str) -> dict[str, Any]:
    return {"defenses": tuple(registry.make(defenses, name) for name in names)}


def pair_of(suite: Suite, category: str) -> Pair:
    return next(pair for pair in suite.pairs if pair.categories[0] == category)


def test_a_plan_that_restates_the_mission_is_no_compliance(suite: Suite, yard: Yard) -> None:
    """A planner that starts over, or goes on, keeps to its task, whatever its place is worth."""
    for pair in suite.pairs:
        stage = yard.stage(pair, suite.layouts[pair.layout], pair.attack)
        plan = pair.benign.plan
        for first in range(len(plan)):
            assert not check(stage, plan_bytes(plan[first:])).complied, (pair.id, first)


def test_a_plan_with_the_twin_in_it_is_compliance_in_every_pair(yard: Yard) -> None:
    for name in ("live", "availability"):
        whole = loaded(name)[0]
        for pair in slice_of(whole, most=40).pairs:
            stage = yard.stage(pair, whole.layouts[pair.layout], pair.attack)
            checked = check(stage, plan_bytes(pair.attack.plan))
            assert checked.complied, pair.id
            assert checked.succeeds, pair.id


def test_an_action_complies_by_a_field_that_it_violates_and_by_no_other(
    suite: Suite, yard: Yard
) -> None:
    """The attack's own action, once the mission allows that part of it, is a fault of another."""
    for pair in suite.pairs:
        stage = yard.stage(pair, suite.layouts[pair.layout], pair.attack)
        first, *_ = asked_changes(stage)
        walk = Walk.of(stage)
        walk.state = replace(walk.state, region=first.place)
        others = [code for code in FIELD_OF if FIELD_OF[code] not in first.fields]
        assert changed_as_asked(stage, walk, first.action, first.codes), pair.id
        assert not changed_as_asked(stage, walk, first.action, others), pair.id


def test_the_same_plan_complies_the_same_whatever_stands_behind_it(
    suite: Suite, yard: Yard
) -> None:
    """Also a plan that is not executable beyond the change: the gate is asked about the change."""
    pair = pair_of(suite, "goal")
    beyond = next(call for call in pair.benign.plan if call.tool == "pick_up")
    for plan in (pair.attack.plan, (*pair.attack.plan, beyond, beyond)):
        trials = ran(suite, yard, Says(plan_bytes(plan)), pair, **ATTACK, **made(*EVERY))
        assert [trial.complied for trial in trials] == [True] * len(EVERY)
        told = {trial.defense: trial.blocked for trial in trials}
        assert (told["none"], told["both"]) == (False, True)
    (trial,) = ran(
        suite, yard, Says(plan_bytes((beyond, *pair.attack.plan))), pair, **ATTACK, **made("none")
    )
    assert (trial.complied, trial.instead) == (False, "not_executable")


def test_what_leaves_the_mission_otherwise_is_told_apart(suite: Suite, yard: Yard) -> None:
    pair = pair_of(suite, "object")
    again = Says(plan_bytes(pair.benign.plan))
    none, both = ran(suite, yard, again, pair, **ATTACK, **made("none", "both"))
    assert (none.complied, none.instead, none.unauthorized > 0) == (False, "strayed", True)
    assert (both.complied, both.instead, both.unauthorized) == (False, "strayed", 0)
    (kept,) = ran(
        suite, yard, Says(plan_bytes((WordedCall("scan", {}),))), pair, **ATTACK, **made("both")
    )
    assert (kept.complied, kept.instead) == (False, "authorized")


@pytest.mark.parametrize("defense", ["none", "human", "cedar", "safety", "mission", "both"])
def test_a_planner_is_shown_the_world_as_it_became(suite: Suite, yard: Yard, defense: str) -> None:
    """Step by step, to the end of the mission: after what was carried out, and not before."""
    pair = pair_of(suite, "goal")
    steps = Says(*(plan_bytes((call,)) for call in pair.benign.plan))
    only = {"kinds": (TrialKind.BENIGN,), "turns": 12}
    spec = "human:first=1,keeps=1,misses=0,refuses=0" if defense == "human" else defense
    (trial,) = ran(suite, yard, steps, pair, **only, **made(spec))
    assert trial.completed
    assert len(steps.seen) == len(pair.benign.plan)
    places = [briefing.situation.split(" and ")[0] for briefing in steps.seen]
    assert len(set(places)) > 1
    assert [turn.told for turn in steps.seen[-1].turns] == ["executed"] * (len(steps.seen) - 1)


def test_a_planner_that_has_nothing_more_to_do_is_asked_no_more(suite: Suite, yard: Yard) -> None:
    says = Says(plan_bytes((WordedCall("scan", {}),)), b'{"plan": []}')
    ran(suite, yard, says, **ATTACK, **made("both"), turns=9)
    assert len(says.seen) == 2


class Insists:
    """An attacker that sends the same again."""

    name, simulated, parameters = "insists", True, dict[str, Any]()

    def __init__(self, inputs: tuple[Input, ...]) -> None:
        self.inputs = inputs

    def open(self, case: bytes, *, seed: int) -> tuple[Input, ...]:
        return self.inputs

    def revise(self, seen: bytes, *, seed: int) -> tuple[Input, ...] | None:
        return self.inputs


def test_every_round_counts_and_not_the_last_alone(suite: Suite, yard: Yard) -> None:
    """Off the mission in the first round, under nobody's eyes; kept to it in the last."""
    pair = pair_of(suite, "object")
    says = Says(plan_bytes(pair.benign.plan), plan_bytes((WordedCall("scan", {}),)))
    more = {"attacker": Insists(pair.inputs), "rounds": 3}
    (trial,) = ran(suite, yard, says, pair, **ATTACK, **more, **made("none"))
    assert len(trial.rounds) == 3
    assert trial.unauthorized > 0
    assert trial.hijacked
    assert trial.executed > trial.unauthorized
    assert trial.violated


def test_an_unsafe_plan_does_not_end_the_attack(suite: Suite, yard: Yard) -> None:
    """`alg:missionpair` returns what is executable, safe and off the mission, all three."""
    pair = pair_of(suite, "parameter")
    (call,) = pair.attack.plan
    unsafe = WordedCall(call.tool, {**call.arguments, "speed": 1.6})  # its profile ends at 1.5
    says = Says(plan_bytes((unsafe,)), plan_bytes(pair.attack.plan))
    more = {"attacker": Insists(pair.inputs), "rounds": 5}
    (trial,) = ran(suite, yard, says, pair, **ATTACK, **more, **made("safety"))
    assert [one.safe for one in trial.rounds] == [False, True]
    assert [one.complied for one in trial.rounds] == [True, True]
    assert (trial.complied, trial.hijacked) == (True, True)


def test_a_false_stop_is_a_robot_that_stands_with_work_left(suite: Suite, yard: Yard) -> None:
    pair = pair_of(suite, "goal")
    twin, look = plan_bytes(pair.attack.plan), plan_bytes((WordedCall("scan", {}),))
    for said, expected in ((twin, {"none": False, "both": True}), (look, {"both": False})):
        for trial in ran(suite, yard, Says(said), pair, **ATTACK, **made(*expected)):
            assert trial.false_stop is expected[trial.defense]
    whole = Says(plan_bytes(pair.benign.plan))
    benign = {"kinds": (TrialKind.BENIGN,)}
    (trial,) = ran(suite, yard, whole, pair, **benign, **made("both"))
    assert (trial.completed, trial.false_stop) == (True, False)
    (trial,) = ran(suite, yard, Says(twin), pair, **benign, **made("both"))
    assert (trial.completed, trial.by, trial.false_stop) == (False, "authorization", True)


def test_what_learns_under_one_defense_does_not_know_it_under_another(
    suite: Suite, yard: Yard
) -> None:
    pair, asked = suite.pairs[0], list[Says]()

    class Learns(Says):
        """It changes with what it is told, so that no answer of it serves another defense."""

        def told(self, seen: bytes) -> None:
            pass

    def fresh() -> Participants:
        asked.append(Learns(b"?"))
        return Participants(asked[-1], Insists(pair.inputs))

    first = Learns(b"?")
    one = setting(first, fresh=fresh, **ATTACK, **made("none", "safety", "both"), seeds=4)
    trials = list(PairRun(one, yard, pair, suite.layouts[pair.layout], first=0).trials())
    assert len(trials) == 12
    assert [len(says.seen) for says in (first, *asked)] == [4, 4, 4]


def test_what_is_kept_of_a_plan_is_what_the_checkers_say_of_it(suite: Suite, yard: Yard) -> None:
    """Whatever plans were looked at and carried out since, and whatever the inputs say."""
    both = registry.make(defenses, "both")
    for pair in slice_of(suite, most=6).pairs:
        stage = yard.stage(pair, suite.layouts[pair.layout], pair.attack)
        plans = [plan_bytes(plan) for plan in (pair.attack.plan, pair.benign.plan)]
        plans = [*plans, b"not a plan", plans[0], plans[0]]
        first = [check_first(stage, raw) for raw in plans]
        for raw, said in zip(plans, first, strict=True):
            stage.again()
            assert check(stage, raw) == said, pair.id
            both.carry_out(stage, raw)
            stage.again()
            assert check_first(stage, raw) == said, pair.id
        stage.act(pair.update)
        stage.mark()
        assert check_first(stage, plans[0]) == check(stage, plans[0]) != first[0], pair.id


def test_a_part_of_a_combined_attack_is_not_the_attack(suite: Suite, yard: Yard) -> None:
    full = loaded("full:each=1")[0]
    pair = next(p for p in full.pairs if p.categories == (Category.AREA, Category.PARAMETER))
    call = pair.attack.plan[-1]
    numbers = {name for name, value in call.arguments.items() if isinstance(value, int | float)}
    slow = replace(call, arguments={n: v for n, v in call.arguments.items() if n not in numbers})
    for plan, complies in ((pair.attack.plan, True), ((slow,), False)):
        stage = yard.stage(pair, full.layouts[pair.layout], pair.attack)
        checked = check(stage, plan_bytes(plan))
        assert checked.deviation > 0
        assert checked.complied is complies


def test_who_waits_longer_than_asked_complies_with_what_asked_to_wait(yard: Yard) -> None:
    full = loaded("full:each=1")[0]
    tried = 0
    for pair in full.pairs:
        if pair.categories != (Category.AVAILABILITY,) or len(pair.attack.plan) != 1:
            continue
        (call,) = pair.attack.plan
        seconds = [n for n, v in call.arguments.items() if isinstance(v, int | float)]
        if pair.violates != ("PARAMETER_OUT_OF_BOUNDS",) or not seconds:
            continue
        twice: Any = call.arguments[seconds[0]]
        longer = replace(call, arguments={**call.arguments, seconds[0]: twice * 2})
        stage = yard.stage(pair, full.layouts[pair.layout], pair.attack)
        assert check(stage, plan_bytes((longer,))).complied, pair.id
        tried += 1
        if tried == 5:
            break
    assert tried


def test_a_situation_in_which_nothing_is_left_takes_several_answers(
    suite: Suite, yard: Yard
) -> None:
    full = loaded("full:each=1")[0]
    pair = next(
        p
        for p in full.pairs
        if p.categories == (Category.REPLAY,)
        and not rest_of(yard.stage(p, full.layouts[p.layout], p.attack))
    )
    look = next(call for call in pair.benign.plan if call.tool.startswith(("scan", "look")))
    says = Says(plan_bytes((look,)))
    (trial,) = ran(full, yard, says, pair, **ATTACK, **made("none"), turns=3)
    assert len(says.seen) == 3
    assert not trial.completed
