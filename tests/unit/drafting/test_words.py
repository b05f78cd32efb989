# SPDX-License-Identifier: Apache-2.0
"""Tokens, names, quantities and times: what is read is exactly what was said."""

from __future__ import annotations

from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from authguard_r.authoring.drafting import frames
from authguard_r.authoring.drafting.lexicon import Sort, read_lexicon
from authguard_r.authoring.drafting.measures import (
    Daytime,
    instants,
    read_daytime,
    read_measure_text,
    read_number,
)
from authguard_r.authoring.drafting.profile import measure, read_profile
from authguard_r.authoring.drafting.tokens import TokenKind, runs, tokenize
from authguard_r.core.errors import MalformedError
from fixtures import household_sites, scenarios
from fixtures.cases import case
from unit.drafting.drafts import NOW_MS

LEXICON = read_lexicon(scenarios.site(), reserved=frames.reserved())


def ids(text: str) -> tuple[str, ...]:
    tokens = tokenize(text)
    match = LEXICON.match(tokens, 0)
    if match is None or match.size != len(tokens):
        return ()
    return tuple(ref.id for ref in match.refs)


def test_tokens() -> None:
    for text, kinds in [
        ("go to 101", ["word", "word", "number"]),
        ("at 14:30.", ["word", "clock", "mark"]),
        ("by 2026-01-31T14:30:00Z", ["word", "instant"]),
        ("package-p1", ["word", "word", "number"]),
        ("0.8 m/s", ["number", "word", "mark", "word"]),
        ("don't", ["word"]),
        ("1-2", ["number", "mark", "number"]),
        ("14:301", ["number", "mark", "number"]),
        ("a - b", ["word", "mark", "word"]),
    ]:
        with case(text, kinds):
            assert [str(token.kind) for token in tokenize(text)] == kinds


@given(st.text(min_size=1, max_size=60))
def test_tokens_lose_nothing_but_space_and_joints(text: str) -> None:
    try:
        tokens = tokenize(text)
    except MalformedError as refused:
        place = refused.where
        assert place.startswith("sentence")
        return
    kept = "".join(token.text for token in tokens)
    bare = "".join(text.split())
    assert kept == bare or kept.replace("-", "").replace("_", "") == bare.replace("-", "").replace(
        "_", ""
    )
    assert all(text[token.at :].startswith(token.text) for token in tokens)
    assert all(token.kind is not TokenKind.MARK or len(token.text) == 1 for token in tokens)


def test_a_name_means_its_owners_and_nothing_alike() -> None:
    for text, found in [
        ("Station 101", ("station-101",)),
        ("STATION-101", ("station-101",)),
        ("nurse station 101", ("station-101",)),
        ("station 10 1", ()),
        ("stations 101", ("station-101",)),
        ("station", ("station-101", "station-102", "station-103")),
        ("offices", ("office-1", "office-2")),
        ("medicine", ("package-p1", "package-p2")),
        ("sharps bin", ("sharps-bin",)),
        ("bin", ("sharps-bin",)),
        ("sharps", ()),
        ("director's office", ("office-1",)),
        ("courier-1", ("courier-1",)),
        ("st\u0430tion 101", ()),
        ("pharmacies", ("pharmacy",)),
    ]:
        with case(text, found):
            assert ids(text) == found


def test_the_longest_name_is_meant() -> None:
    lexicon = read_lexicon(household_sites.site("desk lamp", "desk"), reserved=frames.reserved())
    match = lexicon.match(tokenize("desk lamp"), 0)
    assert match is not None
    assert [(ref.sort, ref.id) for ref in match.refs] == [(Sort.OBJECT, "desklamp")]


def test_a_thing_cannot_take_a_word_of_the_grammar() -> None:
    taken = read_lexicon(scenarios.site(), reserved={"pharmacy"})
    assert taken.match(tokenize("pharmacy"), 0) is None
    assert taken.match(tokenize("Pharmacy Desk A"), 0) is not None


@given(st.sampled_from(sorted(scenarios.site().regions) + sorted(scenarios.site().objects)))
def test_every_id_of_the_site_means_itself(item: str) -> None:
    assert ids(item) == (item,)
    assert ids(item.replace("-", " ").title()) == (item,)
    assert runs(item) == runs(item.upper())


def test_quantities_are_exact() -> None:
    for text, spelled, amount in [
        ("0.8 m/s", "0.8 m/s", 800),
        ("2 meters per second", "2 m/s", 2000),
        ("3.6 km/h", "3.6 km/h", 1000),
        ("1 km/h", "1 km/h", Fraction(2500, 9)),
        ("thirty seconds", "30 s", 30_000),
        ("twenty five minutes", "25 min", 1_500_000),
        ("20 %", "20 %", 200),
        ("twenty percent", "20 %", 200),
        ("10 MB", "10 MB", 10_000_000),
        ("20 N", "20 N", 20_000),
        ("15min", "15 min", 900_000),
    ]:
        with case(text, spelled, amount):
            found = read_measure_text(text, tokenize(text))
            assert found is not None
            assert (found.text, found.amount) == (spelled, amount)


@pytest.mark.parametrize("text", ["30", "m/s", "30 parsecs", "30 s or so", "few seconds", "1,5 s"])
def test_what_is_no_quantity_is_none(text: str) -> None:
    assert read_measure_text(text, tokenize(text)) is None


def test_numbers_in_words() -> None:
    assert read_number(tokenize("forty two"), 0) == ("42", 2)
    assert read_number(tokenize("sixty"), 0) == ("60", 1)
    assert read_number(tokenize("many"), 0) is None
    assert read_number((), 0) is None


def test_times_of_day_keep_every_meaning() -> None:
    for text, time in [
        ("14:30", Daytime((14,), 30, 1)),
        ("2:30", Daytime((2, 14), 30, 1)),
        ("02:30", Daytime((2,), 30, 1)),
        ("2:30 pm", Daytime((14,), 30, 2)),
        ("2 pm", Daytime((14,), 0, 2)),
        ("12 am", Daytime((0,), 0, 2)),
        ("two o'clock", Daytime((2, 14), 0, 2)),
        ("half past two", Daytime((2, 14), 30, 3)),
        ("quarter to one", Daytime((0, 12), 45, 3)),
        ("ten past twelve", Daytime((0, 12), 10, 3)),
        ("noon tomorrow", Daytime((12,), 0, 2, day=1)),
        ("14:30 UTC today", Daytime((14,), 30, 3, day=0, utc=True)),
        ("3 p.m.", Daytime((15,), 0, 5)),
    ]:
        with case(text, time):
            assert read_daytime(tokenize(text), 0) == time


@pytest.mark.parametrize(
    "text", ["25:00", "14:75", "half past thirteen", "123", "soon", "half of it"]
)
def test_what_is_no_time_is_none(text: str) -> None:
    found = read_daytime(tokenize(text), 0)
    assert found is None or found.size < len(tokenize(text))


def test_only_instants_to_come_are_candidates() -> None:
    assert instants(Daytime((9,), 0, 1), now_ms=NOW_MS) == ("2026-01-02T09:00:00Z",)
    assert instants(Daytime((24,), 0, 1, day=0), now_ms=NOW_MS) == ("2026-01-02T00:00:00Z",)
    assert instants(Daytime((9,), 0, 1, day=0), now_ms=NOW_MS) == ()


def test_the_profile_is_whole_and_named() -> None:
    profile = read_profile()
    assert measure(profile.slack).amount == 5000
    with pytest.raises(MalformedError, match="expected one of conservative"):
        read_profile(name="bold")
    with pytest.raises(MalformedError):
        measure("a lot")


def test_the_profile_names_no_thing_place_person_or_data_right() -> None:
    text = str(read_profile())
    site = scenarios.site()
    for word in (*site.objects, *site.regions, *site.robots, "operator-1", "transmit"):
        assert f"'{word}'" not in text


def test_every_verb_opens_a_frame_with_roles() -> None:
    assert {verb.frame for verb in frames.VERBS.values()} == set(frames.VerbFrame)
    for name in ("turning", "closing", "putting", "pouring"):
        assert any((stem,) in frames.VERBS for stem in frames.gerund(name))
    assert frames.gerund("ring") == frames.gerund("red") == ()
