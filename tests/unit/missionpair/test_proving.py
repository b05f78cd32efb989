# SPDX-License-Identifier: Apache-2.0
"""The self-check finds nothing in our suites, and finds every false label in a broken pair."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from fixtures.suites import loaded
from missionpair.missions.amend import amended
from missionpair.pair import Pair, PriorAct, Scenario, Suite, WordedCall
from missionpair.proving import Disagreement, prove, prove_pair
from missionpair.stage import Yard

pytestmark = pytest.mark.complete

#: Every how-manieth pair of each suite a quick run proves.
SLICES = {"live": 12, "updates": 17, "availability": 50, "stress": 61, "full": 197}


@pytest.fixture(scope="module")
def hand() -> Suite:
    return loaded("hand")[0]


def of(suite: Suite, name: str) -> Pair:
    return next(pair for pair in suite.pairs if pair.id == name)


def told(suite: Suite, pair: Pair, yard: Yard) -> dict[str, str]:
    found: dict[str, str] = {}
    for item in prove_pair(suite, pair, yard):
        found[item.part] = f"{found.get(item.part, '')} {item.what}"
    return found


@pytest.mark.parametrize("name", SLICES)
def test_a_slice_of_each_suite_is_what_its_author_says(name: str, yard: Yard) -> None:
    suite = loaded(name)[0]
    assert prove(suite, pairs=suite.pairs[:: SLICES[name]], yard=yard) == ()


def test_plans_that_begin_with_steps_of_the_mission_are_what_their_author_says(yard: Yard) -> None:
    # five pairs of a cell are made in five ways: a step that is a multiple of five sees one of them
    suite = loaded("full")[0]
    longer = [pair for pair in suite.pairs if len(pair.attack.plan) > 2]
    assert prove(suite, pairs=longer[::41], yard=yard) == ()


def test_hand_made_attacks_and_controls_are_what_their_author_says(hand: Suite, yard: Yard) -> None:
    quick = [pair for pair in hand.pairs if pair.id not in {"hand.availability", "hand.replay"}]
    seen: list[tuple[int, tuple[Disagreement, ...]]] = []
    found = prove(hand, pairs=quick, yard=yard, progress=lambda n, here: seen.append((n, here)))
    assert found == ()
    assert seen == [(number, ()) for number in range(1, len(quick) + 1)]


def test_a_wrong_label_is_found_with_what_differs(hand: Suite, yard: Yard) -> None:
    pair = replace(of(hand, "hand.goal"), violates=("OBJECT_OUT_OF_SCOPE",))
    expected = "declared OBJECT_OUT_OF_SCOPE, the oracle finds DESTINATION_OUT_OF_SCOPE"
    assert told(hand, pair, yard) == {"attack": f" {expected}"}


def test_a_wrong_reason_is_found(hand: Suite, yard: Yard) -> None:
    pair = replace(of(hand, "hand.goal"), reasons=("EXPIRED",))
    said = told(hand, pair, yard)["attack"]
    assert "expected a refusal with EXPIRED, got one by authorization" in said


def test_a_twin_that_is_authorized_after_all_is_found(hand: Suite, yard: Yard) -> None:
    pair = of(hand, "hand.parameter")
    plan = (WordedCall("navigate_to", {"destination": "Station 101", "speed": 0.7}),)
    pair = replace(pair, attack=replace(pair.attack, plan=plan))
    said = told(hand, pair, yard)["attack"]
    assert "the oracle finds nothing" in said
    assert "the gate let 1 of 1 actions through" in said
    assert "got one by nobody with nothing" in said


def test_a_twin_that_cannot_be_carried_out_is_found(hand: Suite, yard: Yard) -> None:
    pair = of(hand, "hand.object")
    plan = (WordedCall("pick_up", {"object": "Sharps Bin", "force": 12}),)
    pair = replace(pair, attack=replace(pair.attack, plan=plan))
    assert "action 1 cannot be carried out" in told(hand, pair, yard)["attack"]


def test_a_twin_that_is_not_safe_is_found(hand: Suite, yard: Yard) -> None:
    pair = of(hand, "hand.parameter")
    plan = (WordedCall("navigate_to", {"destination": "Station 101", "speed": 1.6}),)
    pair = replace(pair, attack=replace(pair.attack, plan=plan))
    said = told(hand, pair, yard)
    assert "the safety model does not accept action 1" in said["attack"]
    assert "stopped it after 0 of 1" in said["update"]


def test_an_update_that_authorizes_nothing_is_found(hand: Suite, yard: Yard) -> None:
    pair = replace(
        of(hand, "hand.approval"), update=(PriorAct(do="approve", by=("supervisor-1",)),)
    )
    said = told(hand, pair, yard)
    assert said == {"update": " authorization stopped it after 0 of 1 with APPROVAL_REQUIRED"}


def test_a_benign_run_that_the_mission_does_not_have_is_found(hand: Suite, yard: Yard) -> None:
    pair = of(hand, "hand.parameter")
    draft = amended(pair.missions["v1"], "go-to-pharmacy", repeat=1, starts=1)
    twice = pair.benign.plan * 2
    pair = replace(pair, missions={**pair.missions, "v1": draft})
    pair = replace(pair, benign=replace(pair.benign, plan=twice))
    assert "authorization stopped it after 1 of 2" in told(hand, pair, yard)["benign"]


def test_a_pair_that_cannot_be_staged_is_found(hand: Suite, yard: Yard) -> None:
    pair = of(hand, "hand.goal")
    nowhere = replace(pair, layout="nowhere")
    assert set(told(hand, nowhere, yard)) == {"benign", "attack", "update", "rest"}
    unread = replace(pair, attack=replace(pair.attack, plan=(WordedCall("fly", {}),)))
    assert "fly" in told(hand, unread, yard)["attack"]
    late = Scenario(robot="courier-1", before=(PriorAct(do="activate", mission="v1"),) * 2)
    again = replace(pair, attack=replace(late, plan=pair.attack.plan))
    assert "activate" in told(hand, again, yard)["attack"]


def test_work_that_is_not_left_is_found(hand: Suite, yard: Yard) -> None:
    pair = of(hand, "hand.goal")
    assert pair.rest
    forbidden = replace(pair, rest=pair.attack.plan)
    stopped = " authorization stopped it after 0 of 1 with DESTINATION_OUT_OF_SCOPE"
    assert told(hand, forbidden, yard) == {"rest": stopped}
    elsewhere = replace(pair, rest=pair.rest[1:])
    assert "stopped it after 0 of 2" in told(hand, elsewhere, yard)["rest"]


def test_without_a_yard_one_is_made_and_goes(hand: Suite) -> None:
    assert prove(hand, pairs=(of(hand, "hand.parameter"),)) == ()


@pytest.mark.nightly
@pytest.mark.parametrize(
    "name", ["hand", "live", "updates", "availability", "long", "stress", "full"]
)
def test_every_pair_of_every_suite_is_what_its_author_says(name: str) -> None:
    suite = loaded(name)[0]
    with Yard() as own:
        assert prove(suite, yard=own) == ()
