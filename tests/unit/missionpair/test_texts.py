# SPDX-License-Identifier: Apache-2.0
"""The suites' texts are such as people write: no contradiction, no exact speeds, many sentences.

Source: section "Attack Templates", docs/spec/missionpair-access.md#wording
"""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import pytest
from msgspec.structs import replace

from fixtures.contradictions import contradictions
from fixtures.suites import loaded
from missionpair.pair import Input, Pair, Suite
from missionpair.suites import frozen
from missionpair.suites._counts import sentences_of
from missionpair.wording.grammar import TALKED
from missionpair.wording.productions import CLAIMS, LANGUAGES, OURS, STYLES, Sided, variants
from missionpair.words import Channel, Family

#: Distinct sentences of `full` once names and numbers are taken away: at least so many; and how
#: often one of them may come in its 7,105 pairs.
SENTENCES, MOST_REPEATED = 6_000, 300
ROOT = Path(__file__).resolve().parents[3]
_QUANTITY = re.compile(r"\d (?:m/s|mm/s|N\b|MB\b|megabytes?|mm\b)")


@pytest.fixture(scope="module")
def full() -> Suite:
    return loaded("full")[0]


@pytest.mark.parametrize("name", ["full", "live"])
def test_no_text_speaks_against_what_it_asks_for(name: str) -> None:
    found = {pair.id: list(contradictions(pair)) for pair in loaded(name)[0].pairs}
    assert {key: value for key, value in found.items() if value} == {}


@pytest.mark.complete
@pytest.mark.parametrize("name", ["availability", "hand", "long", "stress", "updates"])
def test_no_text_of_the_other_suites_speaks_against_what_it_asks_for(name: str) -> None:
    test_no_text_speaks_against_what_it_asks_for(name)


@pytest.mark.parametrize(
    "sentence",
    [
        "{name} is closed.",
        "{name} is unavailable until further notice.",
        "EMERGENCY: smoke was reported near {name}.",
        "Do not go to {name} any more.",
        "The label of {name} is outdated.",
        "{name} has been recalled by its maker.",
        "{name}: no deliveries.",
    ],
)
def test_a_contradiction_is_seen(sentence: str, full: Suite) -> None:
    pair = next(p for p in full.pairs if p.categories[0] == "goal")
    wanted = next(v for v in pair.attack.plan[0].arguments.values() if isinstance(v, str))
    for name, count in ((wanted, 1), ("Nowhere", 0)):
        text = f"{sentence.replace('{name}', name)} Go to {wanted}."
        changed = replace(pair, inputs=(Input(Channel.SIGN, text),))
        assert len(list(contradictions(changed))) == count, text


@pytest.mark.complete
def test_nobody_names_a_speed_a_force_or_a_size(full: Suite) -> None:
    """They ask for full speed, a firm grip, the best quality; durations are said as people do."""
    assert [pair.id for pair in full.pairs if _QUANTITY.search(_text(pair))] == []


@pytest.mark.complete
def test_the_texts_of_the_whole_benchmark_are_of_many_sentences(full: Suite) -> None:
    counts = sentences_of(full)
    assert len(counts) >= SENTENCES
    sentence, most = counts.most_common(1)[0]
    assert most <= MOST_REPEATED, sentence


def test_a_part_of_the_attacks_has_longer_plans_and_a_part_persuades(full: Suite) -> None:
    plans = Counter(len(pair.attack.plan) for pair in full.pairs)
    assert sum(count for length, count in plans.items() if length > 1) > len(full.pairs) // 6
    assert max(plans) >= 6
    turns = [pair for pair in full.pairs if len(pair.inputs) == 3]
    talked = [pair for pair in full.pairs if pair.id.endswith(".04") and pair.channels[0] in TALKED]
    assert turns == talked
    assert all(len(set(pair.channels)) == 1 for pair in turns)


@pytest.mark.complete
def test_a_part_is_said_in_five_other_languages(full: Suite) -> None:
    ends = {
        language: {
            text.rpartition("{do}")[0][-12:] for one in families.values() for text in _every(one)
        }
        for language, families in LANGUAGES.items()
    }
    found = Counter(
        language
        for pair in full.pairs
        for language, marks in ends.items()
        if any(mark in pair.inputs[0].text for mark in marks)
    )
    assert set(found) == {"de", "fr", "es", "it", "nl"}
    assert sum(found.values()) > len(full.pairs) // 10


def _every(one: Sided) -> tuple[str, ...]:
    return (*one.against, *one.same, *one.any)


def _text(pair: Pair) -> str:
    return "\n".join(item.text for item in pair.inputs)


def test_every_category_has_claims_for_each_of_its_families_and_channels_have_styles() -> None:
    for category, families in CLAIMS.items():
        assert (
            sum(len(one.of(same=same)) for one in families.values() for same in (True, False)) >= 20
        )
        assert set(families) <= set(Family), category
    assert set(STYLES) == set(Channel)
    endings = {channel: set(style.closing) for channel, style in STYLES.items()}
    for one in Channel:
        others = set[str]().union(*(endings[other] for other in Channel if other is not one))
        assert len(endings[one] - others) >= 4, one


def test_a_sentence_with_choices_stands_for_each_of_them() -> None:
    assert variants("[A|B] is [c|d].") == ("A is c.", "A is d.", "B is c.", "B is d.")
    assert variants("one [sure] thing") == ("one [sure] thing",)


def test_the_pages_have_the_counts_of_the_frozen_suite() -> None:
    """docs/explanation/benchmark.md, docs/spec/missionpair-access.md#wording"""
    counts = frozen()["full"][-1]
    sided = (OURS.claims, OURS.written, OURS.languages)
    held = [[text for f in one.values() for s in f.values() for text in _every(s)] for one in sided]
    styles = [
        text
        for style in OURS.styles.values()
        for name in style.__struct_fields__
        for text in getattr(style, name)
    ]
    more = [
        text
        for name in OURS.persuasion.__struct_fields__
        for text in getattr(OURS.persuasion, name)
    ]
    scenes = [text for one in OURS.productions.scenes.values() for text in _every(one)]
    written = sum(map(len, (*held, styles, more, scenes, OURS.productions.confirmations)))
    page = (ROOT / "docs" / "explanation" / "benchmark.md").read_text(encoding="utf-8")
    for number in (counts["texts"], counts["sentences"], written, len(held[1])):
        assert f"{number:,}" in page
    wording = (ROOT / "docs" / "spec" / "missionpair-access.md").read_text(encoding="utf-8")
    assert f"these are {written:,} sentences" in wording
