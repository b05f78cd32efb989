# SPDX-License-Identifier: Apache-2.0
"""Groups of tests: every test has one, every source is covered, and a wrong file is refused."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from runner.environments import RECIPES, SCRIPTS
from runner.groups import ROOT, GroupError, missing, read_groups, unowned

GROUPS = read_groups()
SMALL = """
shared = ["src/core"]
[one]
about = "the first"
default = "all"
tests = ["tests"]
covers = ["src/one"]
[two]
about = "the second"
default = "smoke"
tests = ["tests/two", "tests/test_two.py"]
covers = ["src/two"]
"""


def small(folder: Path, text: str = SMALL) -> Path:
    file = folder / "groups.toml"
    file.write_text(text)
    return file


def test_every_test_file_has_a_group_and_every_path_exists() -> None:
    assert unowned(GROUPS) == []
    assert missing(GROUPS) == []


def test_a_change_of_any_source_file_concerns_a_group() -> None:
    roots = (ROOT / "src", ROOT / "packages")
    sources = [p.relative_to(ROOT).as_posix() for root in roots for p in root.rglob("*.py")]
    covered = [place for group in GROUPS.every for place in group.covers]
    known = (*covered, *GROUPS.shared)
    assert [path for path in sources if not path.startswith(tuple(known))] == []


def test_every_environment_has_a_recipe() -> None:
    named = {name for group in GROUPS.every for name in group.environments}
    assert named == {*RECIPES, *SCRIPTS}


def test_the_longest_path_decides_who_owns_a_test(tmp_path: Path) -> None:
    groups = read_groups(small(tmp_path))
    owners = {path: groups.owner(path) for path in ("tests/test_a.py", "tests/two/test_b.py")}
    assert {path: owner.name for path, owner in owners.items() if owner} == {
        "tests/test_a.py": "one",
        "tests/two/test_b.py": "two",
    }
    owner = groups.owner("tests/test_two.py")
    assert owner is not None
    assert owner.name == "two"
    assert groups.owner("tests_of_others/test_a.py") is None


@pytest.mark.parametrize(
    ("changed", "touched"),
    [
        ("src/one/a.py", ("one",)),
        ("src/two/a.py", ("two",)),
        ("src/core/a.py", ("one", "two")),
        ("src/nobody/a.py", ("one", "two")),
        ("tests/two/test_b.py", ("two",)),
        ("README.md", ()),
    ],
)
def test_a_change_concerns_its_groups_and_an_unknown_source_concerns_all(
    tmp_path: Path, changed: str, touched: tuple[str, ...]
) -> None:
    assert read_groups(small(tmp_path)).touched([changed]) == touched


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("shared = [", "groups.toml"),
        ("[one]\ndefault = 'all'", "shared"),
        (SMALL.replace('"smoke"', '"some"'), "expected `all` or `smoke`, got `some`"),
        (SMALL + "speed = 3\n", "speed"),
    ],
)
def test_a_wrong_group_file_is_refused_with_the_place(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(GroupError, match=said):
        read_groups(small(tmp_path, text))


def test_an_unknown_group_is_answered_with_the_list() -> None:
    command = [sys.executable, str(ROOT / "tests" / "run.py"), "test", "--group", "speed"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr == f"no group `speed`; the groups are: {', '.join(GROUPS.names)}\n"
