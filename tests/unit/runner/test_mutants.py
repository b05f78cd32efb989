# SPDX-License-Identifier: Apache-2.0
"""Mutants: a killed one passes; a survivor, an endless test and an entry that does not fit fail."""

from __future__ import annotations

from pathlib import Path

import pytest

from runner.groups import GroupError
from runner.mutants import Mutant, choose, judge, read_mutants, sliced

SOURCE = "def allowed(speed: int) -> bool:\n    return speed <= 5\n"
TESTS = """
from limits import allowed

def test_the_bound_itself_is_allowed():
    assert allowed(5)

def test_one_above_the_bound_is_refused():
    assert not allowed(6)

def test_half_the_bound_is_allowed():
    assert allowed(2)
"""
PLACE = "src/limits.py"
#: As in our own pyproject.toml: these two plugins take two seconds to load.
PYTEST = "[pytest]\naddopts = -p no:schemathesis -p no:langsmith_plugin\n"
ENTRY = """
[{name}]
file = "{file}"
find = '''{find}'''
replace = ""
tests = ["{test}"]
group = "core"
"""


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A project of one module and its tests."""
    folder = tmp_path / "project"
    files = {PLACE: SOURCE, "tests/test_limits.py": TESTS, "pytest.ini": PYTEST}
    for place, text in files.items():
        (folder / place).parent.mkdir(parents=True, exist_ok=True)
        (folder / place).write_text(text)
    return folder


def mutant(replace: str, *tests: str) -> Mutant:
    named = tuple(f"tests/test_limits.py::{test}" for test in tests)
    return Mutant(
        name="bound", file=PLACE, find="speed <= 5", replace=replace, tests=named, group="core"
    )


def test_a_fault_that_its_test_finds_is_killed(project: Path) -> None:
    found = judge([mutant("speed < 5", "test_the_bound_itself_is_allowed")], root=project)
    assert found == "passed: 1 of 1 mutants killed"
    assert (project / PLACE).read_text() == SOURCE


def test_a_fault_that_its_test_does_not_find_survives_and_fails_the_run(project: Path) -> None:
    found = judge([mutant("speed <= 6", "test_half_the_bound_is_allowed")], root=project)
    assert found.startswith("failed: 0 of 1 mutants killed; not killed: bound (survived: ")


@pytest.mark.complete
def test_each_named_test_alone_has_to_find_the_fault(project: Path) -> None:
    tests = ("test_one_above_the_bound_is_refused", "test_half_the_bound_is_allowed")
    assert judge([mutant("speed <= 6", *tests)], root=project).startswith("failed: 0 of 1")


@pytest.mark.complete
def test_a_fault_that_nothing_can_import_is_no_kill(project: Path) -> None:
    found = judge([mutant("speed <=", "test_half_the_bound_is_allowed")], root=project)
    assert found.startswith("failed: 0 of 1")


def test_a_test_that_does_not_end_in_time_is_no_kill(project: Path) -> None:
    broken = mutant("(lambda: [0 for _ in iter(int, 1)])()", "test_half_the_bound_is_allowed")
    assert "bound (no end: " in judge([broken], root=project, limit_s=3.0)


@pytest.mark.complete
def test_tests_that_fail_without_any_mutant_fail_the_run(project: Path) -> None:
    (project / "tests" / "test_limits.py").write_text(TESTS.replace("allowed(2)", "allowed(7)"))
    found = judge([mutant("speed < 5", "test_half_the_bound_is_allowed")], root=project)
    assert found.startswith("failed: the tests fail without any mutant")


def test_the_list_fits_the_code(tmp_path: Path) -> None:
    assert len(read_mutants()) >= 80
    core = {"name": "a", "file": "src/authguard_r/core/lifecycle.py"}
    here = "tests/unit/runner/test_mutants.py"
    wrong = {
        "occurs": ENTRY.format(**core, find="Status", test=here),
        "does not exist": ENTRY.format(name="a", file="src/no.py", find="a", test=here),
        "tests/no.py does not exist": ENTRY.format(**core, find="TERMINAL:", test="tests/no.py"),
        "'tests'": "[a]",
        "no group": ENTRY.format(**core, find="TERMINAL:", test=here).replace('"core"', '"speed"'),
    }
    for said, text in wrong.items():
        (tmp_path / "mutants.toml").write_text(text)
        with pytest.raises(GroupError, match=said):
            read_mutants(tmp_path / "mutants.toml")


def test_a_slice_is_another_one_at_each_commit_and_the_same_at_the_same() -> None:
    every = read_mutants()
    first = sliced(every, 10, at="a")
    assert first == sliced(every, 10, at="a")
    assert first != sliced(every, 10, at="b")
    assert len(first) == 10


def test_an_unknown_name_is_refused() -> None:
    with pytest.raises(GroupError, match="no mutant `nothing`"):
        choose(read_mutants(), names=["nothing"], groups=[])
