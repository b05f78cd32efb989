# SPDX-License-Identifier: Apache-2.0
"""The standard vocabulary: sound, closed, and part of a site only where the site names it."""

from __future__ import annotations

from importlib.resources import files
from typing import Any

import msgspec
import pytest

from authguard_r.core.errors import MalformedError
from authguard_r.site.check import faults
from authguard_r.site.model import ActionModel, site_digest
from authguard_r.site.source import parse_site, read_yaml
from authguard_r.site.words import standard_words, with_words
from fixtures import scenarios
from fixtures.cases import case

SITE = (scenarios.HOSPITAL / "site.yaml").read_text(encoding="utf-8")
BARE = SITE.partition("vocabulary:")[0]
HALL = "regions: {}\nobjects: {}\nrobots: {}\n"
HEAD = f"schema: authguard-r/site/1\nid: hall\nversion: 1\n{HALL}"


def refused(text: str) -> str:
    with pytest.raises(MalformedError) as caught:
        parse_site(text, where="x")
    return caught.value.where


def test_the_standard_vocabulary_is_sound_as_a_site_s_own() -> None:
    site = msgspec.structs.replace(scenarios.site(), vocabulary=standard_words())
    assert faults(site) == ()


def test_changing_the_words_one_was_given_changes_nobody_else_s() -> None:
    words = standard_words()
    words.clear()
    assert "navigate" in standard_words()


def test_what_writes_a_robot_s_beliefs_is_marked_so_that_no_planner_gets_it() -> None:
    words = standard_words()
    beliefs = ("set_pose", "edit_map", "set_parameter", "manage_nodes", "run_program")
    assert all(words[word].state_writing for word in beliefs)


def test_every_word_says_how_badly_it_can_hurt() -> None:
    """Nothing is harmless because somebody forgot to say."""
    text = files("authguard_r.site").joinpath("words.yaml").read_text(encoding="utf-8")
    plain: Any = read_yaml(text, where="words.yaml")
    assert [word for word, model in plain.items() if "physical" not in model] == []
    words = standard_words()
    assert words["cruise"].physical == 3
    assert words["slice"].physical == words["throw"].physical == words["move_arm"].physical == 2
    assert words["read_metadata"].physical == words["wait"].physical == 0
    assert [word for word, model in words.items() if model.moves and not model.physical] == []


@pytest.mark.parametrize("physical", [-1, 4, "true", "high", "1.0"])
def test_an_impact_is_one_of_four(physical: Any) -> None:
    text = f"{HEAD}vocabulary:\n  hum: {{fields: [], physical: {physical}}}\n"
    assert refused(text) == "x:vocabulary.hum.physical"


def test_a_site_may_take_over_all_words() -> None:
    assert parse_site(f"{HEAD}words: standard\n", where="x").vocabulary == standard_words()


def test_a_site_may_take_over_some_words_beside_its_own() -> None:
    text = f"{HEAD}words: [navigate, pick]\nvocabulary:\n  hum: {{fields: []}}\n"
    found = parse_site(text, where="x").vocabulary
    assert found == {
        "navigate": standard_words()["navigate"],
        "pick": standard_words()["pick"],
        "hum": ActionModel(fields=()),
    }


def test_a_site_without_words_keeps_its_digest_and_one_with_them_is_what_it_spells_out() -> None:
    """A later release of the standard vocabulary changes no signed site."""
    own = parse_site(SITE, where="x")
    assert site_digest(own) == site_digest(scenarios.site())
    assert set(own.vocabulary) == set(scenarios.site().vocabulary)
    words = sorted(own.vocabulary)
    same = [word for word in words if own.vocabulary[word] == standard_words()[word]]
    assert "wait" in same
    assert site_digest(parse_site(f"{SITE}words: [{', '.join(same)}]\n", where="x")) == site_digest(
        own
    )


def test_none_of_the_words_is_none() -> None:
    assert parse_site(f"{HEAD}words: []\nvocabulary: {{}}\n", where="x").vocabulary == {}


def test_words_that_are_not_the_standard_s_are_refused_in_their_place() -> None:
    for words, where in [
        ("all", "x:words"),
        ("Standard", "x:words"),
        ("", "x:words"),
        ("{navigate: 1}", "x:words"),
        ("true", "x:words"),
        ("[fly]", "x:words[0]"),
        ("[navigate, Navigate]", "x:words[1]"),
        ("[navigate, 1]", "x:words[1]"),
        ("[navigate, [pick]]", "x:words[1]"),
        ("[navigate, pick, navigate]", "x:words[2]"),
    ]:
        with case(words, where):
            assert refused(f"{HEAD}words: {words}\n") == where


def test_a_word_with_another_content_than_the_standard_s_is_refused() -> None:
    """The attack: `words` in the open, and further down a `set_pose` that may be granted."""
    text = f"{HEAD}words: [set_pose]\nvocabulary:\n  set_pose: {{fields: [destination]}}\n"
    assert refused(text) == "x:vocabulary.set_pose"


def test_a_broken_vocabulary_beside_words_is_refused_in_its_place() -> None:
    assert refused(f"{HEAD}words: standard\nvocabulary: 5\n") == "x:vocabulary"
    assert refused(f"{HEAD}words: [pick]\nvocabulary: {{pick: 5}}\n") == "x:vocabulary.pick"
    assert refused(f"{HEAD}words: [pick]\nvocabulary: {{hum: 5}}\n").startswith("x:vocabulary")


@pytest.mark.parametrize("data", [None, [], "words", 5])
def test_data_that_is_no_site_comes_back_as_it_is(data: Any) -> None:
    assert with_words(data, where="x") == data


def test_a_site_may_add_that_a_word_runs_beside_others_and_nothing_else() -> None:
    """What two parts of a machine do to each other is known where the machine is described."""
    word = msgspec.to_builtins(standard_words())["announce"]
    assert not any(model.beside for model in standard_words().values())

    def taken(**own: object) -> Any:
        own_words = {"announce": {**word, "beside": True, **own}}
        return with_words({"words": ["announce"], "vocabulary": own_words}, where="s")

    assert taken()["vocabulary"]["announce"]["beside"] is True
    with pytest.raises(MalformedError):
        taken(privacy=1)
