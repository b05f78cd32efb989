# SPDX-License-Identifier: Apache-2.0
"""Laws of the grammar on any text: it answers or asks, and names nothing that was not named."""

from __future__ import annotations

import re
import string
from typing import Any

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from authguard_r.authoring.compile.answers import compile_plain
from authguard_r.authoring.drafting import frames
from authguard_r.authoring.drafting.proposal import DraftProposal
from authguard_r.authoring.drafting.restraint import LIMITING, limits
from authguard_r.core.errors import ClarificationError, MalformedError
from authguard_r.core.quantities import Now
from authguard_r.site.model import Site
from fixtures import household_sites, scenarios
from fixtures.amount import amount
from unit.drafting.drafts import GIVEN, NOW_MS, propose

AVOIDED = {"private", "restricted", "hazardous"}
KITCHEN = household_sites.site("Mug Fridge Apple Candle Microwave Knife Table Sink Desk Lamp Floor")


def _words(text: str) -> list[str]:
    return text.split()


HOSPITAL_WORDS = _words(
    "P1 P2 package packages medicine sharps bin office offices room station stations 101 102 103 1 "
    "pharmacy corridor dock base home director's isolation plant courier-1 lifter-1 battery low"
)
KITCHEN_WORDS = _words("mug fridge apple candle microwave knife sink floor water wine door kitchen")
GLUE = _words(
    "the a and then to in on from with using at by before until within when if is for of it them "
    "inside without recording storing do not after , . ; 2 30 0.8 s min m/s % 14:30 half past two "
    "gently quietly twice times low below turning off"
)
VERBS = sorted({" ".join(words) for words in frames.VERBS})
HOME_WORDS = {"base", "home", "dock", "return"}


def require_place(refused: MalformedError, place: str) -> None:
    assert refused.where
    assert refused.where.startswith(place)


def sentences(words: list[str]) -> st.SearchStrategy[str]:
    every = st.one_of(
        st.sampled_from(VERBS),
        st.sampled_from(words),
        st.sampled_from(words),
        st.sampled_from(GLUE),
    )
    return st.builds(
        lambda verb, rest: " ".join([verb, *rest]),
        st.sampled_from(VERBS),
        st.lists(every, max_size=14),
    )


def words_of(*texts: str) -> set[str]:
    """Return the letters-and-digits words of texts, with and without a plural s."""
    found = {
        word.lower()
        for text in texts
        for word in re.findall(r"[A-Z]+(?![a-z])|[A-Za-z][a-z]*|[0-9]+", text)
    }
    return found | {word.removesuffix("s") for word in found} | {text.lower() for text in texts}


def named(site: Site, sentence: str, settled: dict[str, str]) -> set[str]:
    """Return every id that a word of the sentence or an answer can have named."""
    said = words_of(sentence, *sentence.split())
    answers = {part for value in settled.values() for part in value.replace(",", " ").split()}
    found = set(answers)
    for item, thing in site.objects.items():
        if said & words_of(item, thing.kind, *thing.names):
            found.add(item)
    for region, place in site.regions.items():
        if said & words_of(region, *place.names):
            found.add(region)
    return found


def require_sound(
    site: Site, proposal: DraftProposal, sentence: str, settled: dict[str, str]
) -> None:
    """Hold a draft to the law: things named, places named or where named things are."""
    may = named(site, sentence, settled)
    robot = site.robots[proposal.draft["robot"]]
    homes = {str(site.objects[item].home) for item in may if item in site.objects}  # type: ignore[index]
    for grant in proposal.draft["grants"]:
        for row in grant["rows"]:
            assert row.get("object") in {None, *may}, (sentence, row)
            end = row.get("destination")
            assert end in {None, *may, *homes, robot.home}, (sentence, row)
            for region in row.get("regions", ()):
                free = not AVOIDED.intersection(site.regions[region].tags)
                assert free or region in may | homes, (sentence, row)


def answer_all(
    sentence: str, site: Site, robot: str, data: Any
) -> tuple[DraftProposal, dict[str, str]]:
    """Answer questions with drawn candidates until none is open or one needs words."""
    settled = dict(GIVEN)
    for _ in range(8):
        made = propose(sentence, site=site, robot=robot, given=settled)
        if not made.questions or any(not question.candidates for question in made.questions):
            break
        for question in made.questions:
            settled[question.field] = data.draw(st.sampled_from(question.candidates))
    return made, settled


@pytest.mark.parametrize("place", ["hospital", "kitchen"])
def test_no_draft_names_what_nobody_named(place: str) -> None:
    site, robot, words = {
        "hospital": (scenarios.site(), "courier-1", HOSPITAL_WORDS),
        "kitchen": (KITCHEN, household_sites.ROBOT, KITCHEN_WORDS),
    }[place]
    drafted = 0

    @settings(max_examples=amount(75, 300), suppress_health_check=[HealthCheck.too_slow])
    @given(sentence=sentences(words), data=st.data())
    def law(sentence: str, data: Any) -> None:
        nonlocal drafted
        try:
            made, settled = answer_all(sentence, site, robot, data)
        except MalformedError as refused:
            require_place(refused, "")
            return
        assert bool(made.draft) != bool(made.questions)
        if made.draft:
            drafted += 1
            require_sound(site, made, sentence, settled)
            try:
                compile_plain(made.draft, site, now=Now(NOW_MS, 0), nonce="A" * 22)
            except (MalformedError, ClarificationError) as error:
                pytest.fail(f"{sentence!r} gave a draft that does not compile: {error}")

    law()
    assert drafted > amount(0, 10)  # the law is about something


@settings(max_examples=amount(20, 80))
@given(st.text(max_size=300))
def test_any_text_is_a_draft_a_question_or_a_refusal_with_a_place(sentence: str) -> None:
    try:
        made = propose(sentence)
    except MalformedError as refused:
        require_place(refused, "sentence")
        return
    assert bool(made.draft) != bool(made.questions)


@settings(max_examples=amount(20, 80))
@given(
    sentence=sentences(HOSPITAL_WORDS),
    word=st.sampled_from(["zorb", "kindly-not", "\u00e9t\u00e9"]),
)
def test_a_word_more_is_a_question_more(sentence: str, word: str) -> None:
    """A word that nobody knows never vanishes, wherever it stands."""
    said = sentence.split()
    for place in {0, len(said) // 2, len(said)}:
        made = propose(" ".join([*said[:place], word, *said[place:]]))
        assert made.draft == {}


@settings(max_examples=amount(50, 200))
@given(
    word=st.sampled_from(
        [*sorted(LIMITING - {"once"}), "don't", "dont", "mustn\u2019t", "Won't", "shant", "NEVER"]
    ),
    place=st.integers(0, 10),
    mark=st.sampled_from(["", ",", ";"]),
    data=st.data(),
)
def test_a_limiting_word_is_never_answered_away(
    word: str, place: int, mark: str, data: Any
) -> None:
    """Wherever it stands, and whatever is answered: no draft comes of it (`once` is a count)."""
    said = _words("bring P1 to Station 101 and then go to Station 102")
    sentence = " ".join([*said[:place], mark, word, *said[place:]])
    try:
        made, _ = answer_all(sentence, scenarios.site(), "courier-1", data)
    except MalformedError as refused:
        require_place(refused, "")
        return
    assert made.draft == {}
    assert made.questions


@given(st.sampled_from(["patient", "plant", "front", "want", "nut", "note", "P1", "station"]))
def test_a_noun_is_no_denial_by_its_letters(word: str) -> None:
    assert not limits(word)


#: Sentences that give a draft, cut right behind a noun.
BEHIND_NOUNS = [
    ("Deliver package", "to station 101"),
    ("Deliver package-p1 to the pharmacy", ""),
    ("Bring the package from the pharmacy", "to dock, please"),
    ("Pick up P1", "and put it in station 101"),
    ("Pick up P1 and put it", "in station 101"),
    ("Go to the pharmacy", "at 0.5 m/s"),
    ("Guide the visitor", "to station 101"),
    ("Patrol stations 101", ", 102 and 103"),
    ("return to base", "when the battery is low"),
    ("courier-1", "go to the dock, then to the pharmacy"),
    ("Inspect the pharmacy", "without recording"),
]
LABELS = st.one_of(
    st.sampled_from([*string.ascii_letters, "the", "The", "An", "your", "robot", "two", "\u00e9"]),
    st.integers(0, 99_999).map(str),
    st.text(string.ascii_lowercase, min_size=5, max_size=9).map(lambda text: f"zq{text}"),
)


@settings(max_examples=amount(100, 400))
@given(cut=st.sampled_from(BEHIND_NOUNS), label=LABELS)
def test_a_label_behind_a_noun_never_vanishes(cut: tuple[str, str], label: str) -> None:
    """`package A` is another thing than `package`: a draft for both would be a guess."""
    before, after = cut
    site = msgspec.structs.replace(
        scenarios.site(),
        objects={k: v for k, v in scenarios.site().objects.items() if k == "package-p1"},
    )
    plain = propose(f"{before} {after}", site=site)
    assert plain.draft, cut
    made = propose(f"{before} {label} {after}", site=site)
    if not made.questions:  # it made another name: `package` and `package 1`
        assert made.draft["grants"] != plain.draft["grants"], (before, label, after)


@settings(max_examples=amount(25, 100))
@given(
    field=st.text(min_size=1, max_size=12),
    value=st.text(max_size=12),
    sentence=sentences(HOSPITAL_WORDS),
)
def test_an_answer_out_of_nowhere_never_gives_a_draft(
    field: str, value: str, sentence: str
) -> None:
    settled = {**GIVEN, f"zz.{field}": value}
    try:
        assert propose(sentence, given=settled).draft == {}
    except MalformedError as refused:
        require_place(refused, "")


def test_two_thousand_characters_are_read_at_once() -> None:
    for text in ("go to " * 333, "and " * 500, "station 101 " * 160, "pick up P1 and " * 130):
        made = propose(text[:2000])
        assert bool(made.draft) != bool(made.questions)
