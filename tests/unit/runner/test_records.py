# SPDX-License-Identifier: Apache-2.0
"""Records of complete runs: what is unclear makes a group run."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from runner.groups import GroupError, Groups, read_groups
from runner.records import FILE, changed_groups, record
from unit.runner.test_groups import small

pytestmark = pytest.mark.skipif(shutil.which("git") is None, reason="needs git")


@pytest.fixture
def groups(tmp_path: Path) -> Groups:
    return read_groups(small(tmp_path))


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A repository in which both groups were recorded at the first commit."""
    folder = tmp_path / "checkout"
    (folder / ".ci").mkdir(parents=True)
    git(folder, "init", "--quiet", "--initial-branch=main")
    commit(folder, "src/one/a.py")
    record(["one", "two"], folder)
    commit(folder, "notes.txt")
    return folder


def git(folder: Path, *words: str) -> str:
    who = ["-c", "user.name=a", "-c", "user.email=a@example.org"]
    done = subprocess.run(
        ["git", *who, *words], cwd=folder, capture_output=True, text=True, check=True
    )
    return done.stdout.strip()


def commit(folder: Path, path: str, text: str = "text") -> str:
    place = folder / path
    place.parent.mkdir(parents=True, exist_ok=True)
    place.write_text(text)
    git(folder, "add", "--all")
    git(folder, "commit", "--quiet", "--message", path)
    return git(folder, "rev-parse", "HEAD")


def test_nothing_changed_since_the_records_runs_nothing(checkout: Path, groups: Groups) -> None:
    assert changed_groups(groups, checkout) == {}


def test_a_changed_source_runs_its_group_alone(checkout: Path, groups: Groups) -> None:
    commit(checkout, "src/two/a.py")
    found = changed_groups(groups, checkout)
    assert list(found) == ["two"]
    assert "such as src/two/a.py" in found["two"]


def test_a_changed_shared_source_runs_every_group(checkout: Path, groups: Groups) -> None:
    commit(checkout, "src/core/a.py")
    assert list(changed_groups(groups, checkout)) == ["one", "two"]


@pytest.mark.parametrize("path", ["src/one/a.py", "src/one/new.py"])
def test_a_change_that_is_not_committed_counts(checkout: Path, groups: Groups, path: str) -> None:
    (checkout / path).write_text("changed")
    assert list(changed_groups(groups, checkout)) == ["one"]


def test_a_deleted_and_a_moved_source_count(checkout: Path, groups: Groups) -> None:
    git(checkout, "mv", "src/one/a.py", "elsewhere.py")
    git(checkout, "commit", "--quiet", "--message", "moved")
    assert list(changed_groups(groups, checkout)) == ["one"]


def test_a_group_without_a_record_runs(checkout: Path, groups: Groups) -> None:
    file = checkout / FILE
    plain = json.loads(file.read_text())
    del plain["groups"]["two"]
    file.write_text(json.dumps(plain))
    assert changed_groups(groups, checkout) == {"two": "no complete run is recorded"}


def test_a_record_that_is_no_ancestor_runs_the_group(checkout: Path, groups: Groups) -> None:
    git(checkout, "checkout", "--quiet", "-b", "other")
    other = commit(checkout, "other.txt")
    git(checkout, "checkout", "--quiet", "main")
    file = checkout / FILE
    plain = json.loads(file.read_text())
    plain["groups"]["one"] = other
    plain["groups"]["two"] = "0" * 40
    file.write_text(json.dumps(plain))
    found = changed_groups(groups, checkout)
    assert list(found) == ["one", "two"]
    assert all("no ancestor" in reason for reason in found.values())


@pytest.mark.parametrize(
    "text",
    ["", "{", "[]", '{"format": 2, "groups": {}}', '{"format": 1, "groups": {"one": "main"}}'],
)
def test_a_damaged_file_runs_every_group(checkout: Path, groups: Groups, text: str) -> None:
    (checkout / FILE).write_text(text)
    found = changed_groups(groups, checkout)
    assert list(found) == ["one", "two"]
    assert all("is damaged" in reason for reason in found.values())


def test_without_git_every_group_runs(checkout: Path, groups: Groups, tmp_path: Path) -> None:
    plain = tmp_path / "unpacked"
    (plain / ".ci").mkdir(parents=True)
    (plain / FILE).write_bytes((checkout / FILE).read_bytes())
    assert list(changed_groups(groups, plain)) == ["one", "two"]


def test_a_record_needs_a_clean_tree_and_keeps_the_other_groups(
    checkout: Path, groups: Groups
) -> None:
    (checkout / "src/one/a.py").write_text("changed")
    with pytest.raises(GroupError, match="clean tree"):
        record(["one"], checkout)
    now = commit(checkout, "src/one/b.py")
    record(["one"], checkout)
    commits = json.loads((checkout / FILE).read_text())["groups"]
    assert commits["one"] == now
    assert commits["two"] != now
    assert changed_groups(groups, checkout) == {}
