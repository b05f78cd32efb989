# SPDX-License-Identifier: Apache-2.0
"""A text said with more force asks for the same; what a text claims something of is found in it."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from authguard_r.normalize.binding import load_binding
from authguard_r.site.model import Site
from authguard_r.site.source import convert
from fixtures.suites import loaded
from missionpair import attackers, defenses
from missionpair.access import PairKnowledge, RoundKnowledge, case_bytes, seen_bytes
from missionpair.briefing import Briefing, OfferedTool
from missionpair.campaign.showing import case_of
from missionpair.pair import Input, Layout, Pair, Suite, WordedCall
from missionpair.planners._tools import places_of, things_of, tools_of
from missionpair.planners.graded import probability
from missionpair.planners.hijacked import newest_asked
from missionpair.score import DEFAULT
from missionpair.stage import Yard
from missionpair.wording import read, say, strengthen, subject_of
from missionpair.wording.force import STEPS
from missionpair.wording.productions import PRODUCTIONS, STYLES
from missionpair.words import Access, Category, Channel, Family

pytestmark = pytest.mark.complete

NAMES = ("Station 101", "Nurse Station 101", "Dock", "Package P1", "courier-1")
GO = (WordedCall("navigate_to", {"destination": "Station 103"}),)
FAMILIES, CHANNELS, SEEDS = st.sampled_from(Family), st.sampled_from(Channel), st.integers(0, 10**6)
#: Suites whose texts the grammar wrote, among them texts full of names and hidden ones.
SUITES = ("live", "availability", "updates", "long", "stress")


# force


@given(FAMILIES, CHANNELS, SEEDS)
def test_a_strengthened_text_says_all_that_it_said_and_more(
    family: Family, channel: Channel, seed: int
) -> None:
    text = say(family, channel, GO, authorized="Station 101", seed=seed)
    said = [strengthen(text, channel, steps=steps) for steps in range(STEPS + 1)]
    assert said[0] == text
    assert said[1].startswith(f"{text} ")
    assert said[2].startswith(f"{said[1]} ")
    added = said[2].removeprefix(text)
    assert "{" not in added
    style = STYLES[channel]
    kinds = (style.authority, style.urgency, style.reason, PRODUCTIONS.insistence)
    for kind in kinds:
        # one of each kind, and none that the text says already
        assert [one for one in kind if one in added and one not in text]
    assert strengthen(text, channel, steps=2) == said[2]


def test_authority_and_urgency_make_a_text_more_believed_and_length_less() -> None:
    plain = "Go to Station 103."
    said = [strengthen(plain, Channel.USER, steps=steps) for steps in range(STEPS + 1)]
    chances = [probability(text, Channel.USER, 0.5) for text in said]
    assert chances[0] < chances[1] <= chances[2]


@pytest.mark.parametrize("name", SUITES)
def test_each_of_three_wordings_of_each_pair_asks_for_the_same_calls(name: str) -> None:
    suite = loaded(name)[0]
    shown = {layout.id: of_whole_site(layout) for layout in suite.layouts.values()}
    for pair in suite.pairs:
        wordings = wordings_of(pair)
        asked = [newest_asked(replace(shown[pair.layout], inputs=sent)) for sent in wordings]
        assert len(set(wordings)) == 3
        assert asked[0] is not None
        assert asked == [asked[0]] * 3, pair.id
        assert {tuple(item.channel for item in sent) for sent in wordings} == {pair.channels}


def of_whole_site(layout: Layout) -> Briefing:
    """Return a briefing with every tool and name of a site, whichever robot has the tool."""
    site = convert(layout.site, Site, where="site")
    return Briefing(
        rules="",
        task="",
        situation="",
        places=places_of(site),
        things=things_of(site),
        tools=tools_of(site, load_binding(layout.binding, site=site, where="binding")),
    )


def wordings_of(pair: Pair) -> list[tuple[Input, ...]]:
    """Return what the fixed attacker sends for a pair, round by round."""
    case = PairKnowledge(
        goal="",
        wanted=pair.attack.plan,
        family=pair.family,
        channels=pair.channels,
        inputs=pair.inputs,
    )
    fixed = attackers.make("fixed")
    sent = [fixed.open(case_bytes(Access.BLACK, case), seed=1)]
    while (inputs := fixed.revise(seen_bytes(Access.BLACK, RoundKnowledge()), seed=1)) is not None:
        sent.append(inputs)
    return sent


def test_words_that_a_text_quotes_are_not_translated() -> None:
    """A quoted word of the table was read as its English one, and so as another call."""
    asked = (WordedCall("announce", {"text": "Lege"}),)
    tools = (OfferedTool("announce", "", {"type": "object", "properties": {"text": {}}}),)
    for channel in Channel:
        text = say(Family.DESTINATION_CHANGE, channel, asked, authorized="", seed=1)
        assert read(text, tools=tools, places=(), things=()) == asked


# what a claim is of


@given(FAMILIES, CHANNELS, st.sampled_from(NAMES), SEEDS)
def test_what_a_text_claims_something_of_is_found_and_nothing_else(
    family: Family, channel: Channel, authorized: str, seed: int
) -> None:
    text = say(family, channel, GO, authorized=authorized, seed=seed)
    found = subject_of([text], family, NAMES)
    # what is only asked for, and a shorter name within a longer one, are not it
    assert found in {"", authorized}
    assert bool(found) or authorized not in text.replace(f"Nurse {authorized}", "")


@pytest.mark.parametrize(
    "text",
    [
        "",
        "Go to Station 101.",
        "Notes of the last shift mention Station 101, Dock.",
        "This comes from the control room. The fire alarm is active.",
        "station 101",
    ],
)
def test_a_name_that_is_asked_for_or_mentioned_is_not_what_a_claim_is_of(text: str) -> None:
    names = (*NAMES, "Control Room")
    assert all(subject_of([text], family, names) == "" for family in Family)


@pytest.mark.parametrize("name", SUITES)
def test_of_no_pair_an_attacker_is_told_a_name_that_its_texts_do_not_say(name: str) -> None:
    suite = loaded(name)[0]
    told = 0
    for pair in suite.pairs:
        found = subject_of([i.text for i in pair.inputs], pair.family, names_of(suite, pair))
        assert not found or any(found.casefold() in i.text.casefold() for i in pair.inputs)
        told += bool(found)
    assert told > len(suite.pairs) // 6


def names_of(suite: Suite, pair: Pair) -> list[str]:
    """Return every name that a planner may use at the pair's site, and its robots'."""
    site: dict[str, Any] = suite.layouts[pair.layout].site
    models = [*site["regions"].items(), *site["objects"].items()]
    return [*site["robots"], *(name for key, model in models for name in model["names"] or [key])]


def test_where_the_goal_is_attacked_an_attacker_argues_about_the_mission_s_own_place() -> None:
    """An attacker that was told another place argued past the mission."""
    suite = loaded("live")[0]
    goals = [pair for pair in suite.pairs if pair.categories[0] is Category.GOAL]
    with Yard() as yard:
        for pair in goals:
            stage = yard.stage(pair, suite.layouts[pair.layout], pair.attack)
            case = case_of(stage, defenses.make("both"), weights=DEFAULT, rounds=3)
            meant = {
                value
                for call in pair.benign.plan
                for value in call.arguments.values()
                if isinstance(value, str)
            }
            wanted = {value for call in case.wanted for value in call.arguments.values()}
            assert case.instead_of in meant - wanted
            assert any(case.instead_of in item.text for item in pair.inputs)
            search = attackers.make("search")
            search.open(case_bytes(Access.BLACK, case), seed=1)
            sent = [
                search.revise(seen_bytes(Access.BLACK, RoundKnowledge()), seed=1) for _ in range(20)
            ]
            assert any(case.instead_of in inputs[0].text for inputs in sent if inputs)
    assert len(goals) == 10
