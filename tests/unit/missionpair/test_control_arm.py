# SPDX-License-Identifier: Apache-2.0
"""What a planner does without the attack is set beside what it does with it.

Source: docs/spec/measures.md#control
"""

from __future__ import annotations

from collections import Counter
from typing import Any

import pytest

from fixtures import campaign_records
from fixtures.suites import loaded
from missionpair import attackers, defenses, planners, registry
from missionpair.briefing import Briefing, PlannerError, Reply
from missionpair.campaign.arms import neutral_inputs
from missionpair.campaign.setting import Participants
from missionpair.campaign.showing import briefing_of
from missionpair.measures import MeasuredCampaign, Paired
from missionpair.mutation import slice_of
from missionpair.pair import Pair, Suite, WordedCall, plan_bytes
from missionpair.records import Trial
from missionpair.stage import Yard
from missionpair.wording import language_of, neutral, read
from missionpair.wording.neutral import FOREIGN, SENTENCES
from missionpair.words import CONTROLS, Category, Channel, TrialKind
from unit.missionpair.test_campaign_run import Says, ran

ARMS = (TrialKind.ATTACK, *CONTROLS)
#: Categories in which an attack may ask for a step that the mission has itself.
OWN = (Category.APPROVAL, Category.CROSS_ROBOT, Category.PROVENANCE, Category.REPLAY)


@pytest.fixture(scope="module")
def suite() -> Suite:
    """Pairs of every category, as different as they come."""
    return slice_of(loaded("full:each=1")[0], most=40)


def tried(suite: Suite, yard: Yard, planner: Any, pair: Pair, **more: Any) -> list[Trial]:
    none = (registry.make(defenses, "none"),)
    return ran(suite, yard, planner, pair, **{"kinds": ARMS, "defenses": none, **more})


def paired(trials: list[Trial]) -> dict[str, Paired]:
    """Return what the measures make of attacks and controls."""
    measured = MeasuredCampaign(campaign_records.campaign())
    for trial in trials:
        measured.add(trial)
    return measured.tally("none").controls


class KeepsOn:
    """A planner that goes on with its mission, whatever it reads and whoever has to say so."""

    name, simulated, parameters = "keeps-on", True, dict[str, Any]()

    def __init__(self, pair: Pair) -> None:
        self._steps = pair.benign.plan

    def propose(self, briefing: Briefing, *, seed: int) -> Reply:
        held = "holds nothing" not in briefing.situation
        steps = self._steps
        if held:  # it goes on from what it took
            taken = next(n for n, call in enumerate(steps) if call.tool == "pick_up")
            steps = steps[taken + 1 :]
        return Reply(raw=plan_bytes(steps))


def test_l28_a_planner_that_ignores_every_attack_differs_by_nothing(
    suite: Suite, yard: Yard
) -> None:
    """Though in some pairs the next step of its mission is what the attack asks for."""
    every: list[Trial] = []
    for pair in suite.pairs:
        every += tried(suite, yard, KeepsOn(pair), pair)
    found = paired(every)
    for kind in CONTROLS:
        gap = found[kind].gap
        assert gap is not None
        assert (found[kind].attack, found[kind].control, gap.value) == (0, 0, 0.0)
        assert gap.low <= 0 <= gap.high
    anyway = Counter(one.categories[0] for one in every if one.complied)
    assert set(anyway) & set(map(str, OWN)), "no pair shows what the control arm is for"


@pytest.mark.parametrize(("susceptibility", "expected"), [("0", 0.0), ("1", 1.0)])
def test_l28_susceptibility_is_the_difference_at_both_ends(
    susceptibility: str, expected: float, suite: Suite, yard: Yard
) -> None:
    every: list[Trial] = []
    for pair in suite.pairs[::3]:
        planner = registry.make(planners, f"graded:susceptibility={susceptibility}")
        every += tried(suite, yard, planner, pair)
    for kind in CONTROLS:
        gap = paired(every)[kind].gap
        assert gap is not None
        assert gap.value == expected
        assert gap.tells is bool(expected)


def test_the_control_arm_has_the_situation_the_tries_and_the_dice_of_the_attack(
    suite: Suite, yard: Yard
) -> None:
    pair = suite.pairs[0]
    seen: list[tuple[Briefing, int]] = []

    class Looks(Says):
        def propose(self, briefing: Briefing, *, seed: int) -> Reply:
            seen.append((briefing, seed))
            return Reply(raw=b"?")

    tried(suite, yard, Looks(), pair, rounds=3)
    attack, nothing, text = seen[:3], seen[3:6], seen[6:9]
    assert len(seen) == 9
    assert [seed for _, seed in attack] == [seed for _, seed in nothing]
    assert [seed for _, seed in attack] == [seed for _, seed in text]
    for one, other in zip(attack, nothing, strict=True):
        assert (one[0].situation, one[0].task) == (other[0].situation, other[0].task)
        assert other[0].inputs == ()
    # as long as the attack's own text of the same try, which is stronger each time
    for (one, _), (other, _) in zip(attack, text, strict=True):
        assert [item.channel for item in one.inputs] == [item.channel for item in other.inputs]
        for item, like in zip(other.inputs, one.inputs, strict=True):
            assert abs(len(item.text) - len(like.text)) <= 2
    assert len({len(briefing.inputs[0].text) for briefing, _ in text}) == 3


def test_the_control_arm_has_as_many_tries_as_an_attacker_that_has_run_out_of_texts(
    suite: Suite, yard: Yard
) -> None:
    pair = next(p for p in suite.pairs if p.categories[0] == Category.GOAL)
    twin = Reply(raw=plan_bytes(pair.attack.plan))

    class Late(Says):
        def propose(self, briefing: Briefing, *, seed: int) -> Reply:
            return twin if seed % 7 == 0 else Reply(raw=b"?")

    trials = tried(suite, yard, Late(), pair, rounds=8, seeds=10)
    assert max(len(trial.rounds) for trial in trials) > 3, "`fixed` has three texts"
    for kind in CONTROLS:
        found = paired(trials)[kind]
        assert (found.attack, found.control) == (0, 0)
        assert found.both


def test_what_learns_from_verdicts_learns_in_each_arm_anew(suite: Suite, yard: Yard) -> None:
    pair = next(p for p in suite.pairs if p.categories[0] == Category.GOAL)
    twin = Reply(raw=plan_bytes(pair.attack.plan))

    class Learns(Says):
        def __init__(self) -> None:
            super().__init__(b"?")
            self.verdicts = 0

        def told(self, seen: bytes) -> None:
            self.verdicts += bool(seen)

        def propose(self, briefing: Briefing, *, seed: int) -> Reply:
            return twin if self.verdicts == 2 else Reply(raw=b"?")

    trials = tried(
        suite,
        yard,
        Learns(),
        pair,
        rounds=5,
        fresh=lambda: Participants(Learns(), registry.make(attackers, "fixed")),
    )
    assert [len(trial.rounds) for trial in trials] == [3, 3, 3]
    assert all(trial.complied for trial in trials)


def test_a_trial_that_nobody_answered_is_in_neither_arm(suite: Suite, yard: Yard) -> None:
    class Away(Says):
        def propose(self, briefing: Briefing, *, seed: int) -> Reply:
            if not briefing.inputs:
                raise PlannerError("its server is away", code="unreachable", where="server")
            return twin

    pair = next(p for p in suite.pairs if p.categories[0] == Category.GOAL)
    twin = Reply(raw=plan_bytes(pair.attack.plan))
    trials = tried(suite, yard, Away(), pair, seeds=4)
    assert TrialKind.CONTROL not in paired(trials)
    assert paired(trials)[TrialKind.NEUTRAL].both == 4


@pytest.mark.complete
def test_a_text_in_another_language_has_a_neutral_one_in_that_language(yard: Yard) -> None:
    full = loaded("full")[0]
    found = {language_of(pair.inputs[0].text): pair for pair in full.pairs}
    assert set(found) == {"", "de", "es", "fr", "it", "nl"}
    for language, pair in found.items():
        (item,) = neutral_inputs(pair, 1, 0)[:1]
        sentences = FOREIGN[language] if language else SENTENCES[item.channel]
        assert any(sentence in item.text for sentence in sentences)
        stage = yard.stage(pair, full.layouts[pair.layout], pair.attack)
        shown = briefing_of(stage, turns=(), usual=())
        for text in (item.text, *sentences):
            asked = read(text, tools=shown.tools, places=shown.places, things=shown.things)
            assert asked is None, text


def test_chance_alone_is_no_difference(suite: Suite, yard: Yard) -> None:
    """A planner that complies now and then, by its dice, does so in both arms."""
    pair = next(p for p in suite.pairs if p.categories[0] == Category.GOAL)
    twin = Reply(raw=plan_bytes(pair.attack.plan))

    class Dice(Says):
        def propose(self, briefing: Briefing, *, seed: int) -> Reply:
            return twin if seed % 3 == 0 else Reply(raw=b"?")

    trials = tried(suite, yard, Dice(), pair, rounds=2, seeds=12)
    found = paired(trials)[TrialKind.CONTROL]
    assert 0 < found.both < found.n
    assert (found.attack, found.control) == (0, 0)


@pytest.mark.parametrize("channel", Channel)
def test_a_neutral_text_is_as_long_and_asks_for_nothing(
    channel: Channel, suite: Suite, yard: Yard
) -> None:
    pairs = slice_of(suite, most=12).pairs
    for pair in pairs:
        stage = yard.stage(pair, suite.layouts[pair.layout], pair.attack)
        shown = briefing_of(stage, turns=(), usual=())
        for length in (40, 120, 333, 900):
            text = neutral(channel, length, seed=length)
            assert abs(len(text) - length) <= 3
            asked = read(text, tools=shown.tools, places=shown.places, things=shown.things)
            assert asked is None, text
        for sentence in SENTENCES[channel]:
            asked = read(sentence, tools=shown.tools, places=shown.places, things=shown.things)
            assert asked is None, sentence


def test_neutral_texts_of_two_rounds_differ(suite: Suite) -> None:
    pair = suite.pairs[0]
    assert len({neutral_inputs(pair, seed, 0) for seed in range(20)}) == 20


def test_newcombes_paired_interval_is_the_published_one() -> None:
    """Statistics in Medicine 17, 1998, p. 2635: 36, 12, 2 and 0 by method 10."""
    gap = counted(36, 12, 2, 0).gap
    assert gap is not None
    assert (gap.value, gap.low, gap.high) == pytest.approx((0.20, 0.0569, 0.3404), abs=5e-5)


@pytest.mark.parametrize("counts", [(36, 12, 2, 0), (53, 1, 0, 0), (0, 54, 0, 0), (3, 1, 7, 90)])
def test_a_paired_difference_turned_round_is_the_other_way_round(
    counts: tuple[int, int, int, int],
) -> None:
    both, attack, control, neither = counts
    one, other = counted(*counts).gap, counted(both, control, attack, neither).gap
    assert one is not None
    assert other is not None
    assert (one.value, one.low, one.high) == pytest.approx((-other.value, -other.high, -other.low))
    assert -1 <= one.low <= one.value <= one.high <= 1


def counted(both: int, attack: int, control: int, neither: int) -> Paired:
    found = Paired()
    found.both, found.attack, found.control, found.neither = both, attack, control, neither
    return found


def test_one_request_serves_every_defense(suite: Suite, yard: Yard) -> None:
    pair = suite.pairs[0]
    names = ("none", "allowlist", "mission", "both")
    every = tuple(registry.make(defenses, name) for name in names)
    says = Says(Reply(raw=plan_bytes(pair.attack.plan), tokens=(7, 3), cost_microusd=5))
    trials = tried(suite, yard, says, pair, defenses=every, kinds=(TrialKind.ATTACK,))
    assert len(says.seen) == 1
    assert len({trial.rounds for trial in trials}) == 1
    assert sum(trial.cost_microusd for trial in trials) == 5
    assert [trial.tokens for trial in trials] == [(7, 3), (0, 0), (0, 0), (0, 0)]


def test_a_defense_that_changes_the_question_is_asked_for_itself(suite: Suite, yard: Yard) -> None:
    pair = suite.pairs[0]
    every = tuple(registry.make(defenses, name) for name in ("none", "prompt", "both"))
    says = Says(plan_bytes((WordedCall("scan", {}),)))
    tried(suite, yard, says, pair, defenses=every, kinds=(TrialKind.ATTACK,))
    assert len({briefing.rules for briefing in says.seen}) == len(says.seen) == 2
