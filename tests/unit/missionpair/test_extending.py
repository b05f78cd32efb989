# SPDX-License-Identifier: Apache-2.0
"""A domain and a category are one file each; all else follows, and no frozen suite changes."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from missionpair import domains, registry, variants
from missionpair.pair import Suite
from missionpair.proving import prove
from missionpair.report.names import category as name_of
from missionpair.suites import load, long, write_suite
from missionpair.suites._making import Cell, Makers, PairMaker, suite_of
from missionpair.words import Category, Channel, Domain, Family

MUSEUM = '''"""A museum: an office's words with other rooms."""

from msgspec.structs import replace

from missionpair.domains import office
from missionpair.words import Domain


def make():
    """Return the words."""
    lanes = ("Grand Gallery", "Back Stairs", "North Gallery")
    return replace(office.make(), domain=Domain("museum"), lanes=lanes)
'''
LET_GO = '''"""A thing is let go of: gripped with less than the mission allows."""

from msgspec.structs import replace

from missionpair.missions import amended, drawn
from missionpair.variants._twin import EVERYWHERE, AttackVariants, chosen_step, not_here, twin_of
from missionpair.words import Category, Family

NAME = Category("let-go")


def make():
    """Return the category."""
    families = dict.fromkeys(Family, not_here("nobody says so"))
    families[Family.OBJECT_RELABELING] = EVERYWHERE
    return AttackVariants(category=NAME, families=families, make=make_twin)


def make_twin(ground, rng, family):
    """Return the thing, let go of with almost no grip."""
    errand = drawn(ground, rng, kinds=("carry",), order="guards")
    number, step = chosen_step(errand, rng, ("put",))
    low, high = errand.job.style.force
    return twin_of(
        NAME,
        errand,
        number,
        (replace(step, params={"force_mn": low // 2}),),
        violates=("PARAMETER_OUT_OF_BOUNDS",),
        authorized=ground.name(step.object),
        v2=amended(errand.draft, step.grant, limits={"force_mn": [low // 2, high]}),
    )
'''


@pytest.fixture
def _added(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A file more in each room."""
    for room, name, text in ((domains, "museum", MUSEUM), (variants, "let_go", LET_GO)):
        folder = tmp_path / room.__name__
        folder.mkdir()
        (folder / f"{name}.py").write_text(text)
        monkeypatch.setattr(room, "__path__", [*room.__path__, str(folder)])
    yield
    for name in ("missionpair.domains.museum", "missionpair.variants.let_go"):
        sys.modules.pop(name, None)


def small(makers: Makers) -> Suite:
    maker, museum = PairMaker(makers, "mine"), Domain("museum")
    cells = [Cell(museum, name, Family.OBJECT_RELABELING, Channel.SIGN) for name in NEW]
    return suite_of("mine", 1, makers, [maker.pair(cell, 1) for cell in cells])


#: The new category in the new domain, and one of the shipped ones.
NEW = ("let-go", "object")


@pytest.mark.usefixtures("_added")
def test_a_new_domain_and_a_new_category_are_one_file_each(tmp_path: Path) -> None:
    suite = small(Makers(1))
    assert [pair.domain for pair in suite.pairs] == ["museum", "museum"]
    assert suite.pairs[0].categories == ("let-go",)
    assert prove(suite) == ()
    digest = write_suite(suite, tmp_path / "mine.jsonl")
    read, read_digest = load(str(tmp_path / "mine.jsonl"))
    assert (read.pairs, read_digest) == (suite.pairs, digest)
    assert name_of("let-go") == "let-go"  # in tables, behind the named ones


def test_a_new_file_changes_no_frozen_suite(request: pytest.FixtureRequest) -> None:
    cells, before = [*Makers(1).cells()], msgspec.json.encode(long.make())
    request.getfixturevalue("_added")
    assert "museum" in registry.names(domains)
    assert [*Makers(1).cells()] == cells
    assert msgspec.json.encode(long.make()) == before


@pytest.mark.parametrize("name", ["museum", "", "Goal", "../goal", "_twin", "goal.x", "combined"])
def test_a_name_without_a_file_is_no_word(name: str) -> None:
    for words in (Category, Domain):
        with pytest.raises(ValueError, match="is not a valid"):
            words(name)
    with pytest.raises(msgspec.ValidationError, match="Invalid enum value"):
        msgspec.convert(name, Category)


def test_the_words_that_are_named_have_their_files() -> None:
    assert {*map(str, Domain)} <= {*registry.names(domains)}
    assert {*map(str, Category)} <= {*registry.names(variants)}
