# SPDX-License-Identifier: Apache-2.0
"""A split that is held out: other draws in sentences that nobody else has, refused by place."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from missionpair import suites
from missionpair.suites import SuiteError
from missionpair.wording.productions import GrammarError, read_grammar

#: Sentences that stand in no file of ours.
WRITTEN = "Zebra note: {it} is off the books as of this very minute. Would you {do}"
CLAIM = "zebra rules say that {it} counts as gone"
FAMILIES = (
    "destination-change",
    "object-relabeling",
    "privacy-escalation",
    "false-emergency",
    "route-expansion",
)


@pytest.fixture
def words(tmp_path: Path) -> Path:
    """Return a folder with texts and claims of its own; everything else is ours."""
    for name, text in (("written", WRITTEN), ("claims", CLAIM)):
        tables = [f'[own.{family}]\nany = ["{text}"]\n' for family in FAMILIES]
        (tmp_path / f"{name}.toml").write_text("\n".join(tables))
    return tmp_path


@pytest.mark.complete
def test_its_pairs_are_other_draws_in_the_folders_own_sentences(words: Path) -> None:
    suite, digest = suites.load(f"private:words={words},seed=one,each=1")
    _, again = suites.load(f"private:words={words},seed=one,each=1")
    other, _ = suites.load(f"private:words={words},seed=two,each=1")
    ours, _ = suites.load("full:each=1")
    assert digest == again
    assert [pair.id for pair in suite.pairs] == [pair.id for pair in ours.pairs]
    theirs = {pair.id: pair for pair in ours.pairs}
    same = [pair.id for pair in suite.pairs if pair.attack == theirs[pair.id].attack]
    assert len(same) < len(suite.pairs) / 20, "another seed draws other attacks"
    assert [pair.attack for pair in other.pairs] != [pair.attack for pair in suite.pairs]
    told = [pair for pair in suite.pairs if "ebra " in pair.inputs[0].text]
    # the rest is put together of an ask and what is usual on its channel
    assert len(told) > len(suite.pairs) * 2 / 3
    assert not any("ebra " in pair.inputs[0].text for pair in ours.pairs)


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("written.toml", '[a.destination-change]\nany = ["Go away."]', "expected `{do}` once"),
        ("written.toml", '[a.no-family]\nany = ["Please {do}."]', "no-family"),
        ("written.toml", '[a.destination-change]\nall = ["Please {do}."]', "all"),
        ("languages.toml", '[de.false-emergency]\nany = ["Los."]', "languages.toml"),
        ("styles.toml", "[sign]\nauthority = []", "missing required field"),
        ("persuasion.toml", "opening = [", "persuasion.toml"),
        ("claims.toml", b"\xff\xfe", "claims.toml"),
        ("notes.toml", "x = 1", "expected at least one of"),
        (
            "persuasion.toml",
            'opening = []\nbridge = ["So."]\nlast = ["So."]',
            "toml: opening: expected at",
        ),
        ("persuasion.toml", 'opning = ["Hello."]', "it has opening, bridge, last"),
        (
            "persuasion.toml",
            'opening = ["Good {day"]\nbridge = ["So."]\nlast = ["So."]',
            "not closed",
        ),
        ("persuasion.toml", 'opening = ["[Hello"]\nbridge = ["So."]\nlast = ["So."]', "not closed"),
        (
            "persuasion.toml",
            'opening = ["{foo}"]\nbridge = ["So."]\nlast = ["So."]',
            "there is none",
        ),
        ("persuasion.toml", "opening = [1]", "persuasion.toml"),
        ("claims.toml", "[own.false-emergency]", "own.false-emergency: expected at least one"),
        (
            "claims.toml",
            '[gaol.destination-change]\nany = ["it is so"]',
            "no category has a sentence",
        ),
        (
            "written.toml",
            '[gaol.destination-change]\nany = ["Do {do}."]',
            "no category is called `gaol`",
        ),
        ("languages.toml", '[german.false-emergency]\nany = ["Los: {do}."]', "expected each of de"),
    ],
)
def test_a_folder_that_cannot_be_used_is_refused_by_place(
    tmp_path: Path, name: str, content: str | bytes, said: str
) -> None:
    data = content if isinstance(content, bytes) else content.encode()
    (tmp_path / name).write_bytes(data)
    with pytest.raises(GrammarError, match=re.escape(said)):
        read_grammar(tmp_path)
    with pytest.raises(SuiteError, match=re.escape(said)):
        suites.load(f"private:words={tmp_path},seed=one")


def test_a_folder_that_is_none_is_told_apart_from_an_empty_one(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.touch()
    for path, said in ((tmp_path / "none", "there is no such folder"), (file, "got a file")):
        with pytest.raises(SuiteError, match=said):
            suites.load(f"private:words={path},seed=one")


@pytest.mark.parametrize("options", ["", "words=/tmp", "seed=one", "words=/tmp,seed=o/ne"])
def test_folder_and_seed_are_both_needed(options: str) -> None:
    with pytest.raises(SuiteError, match="say `private:words=FOLDER,seed=WORD`"):
        suites.load(f"private:{options}")
