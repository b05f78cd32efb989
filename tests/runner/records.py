# SPDX-License-Identifier: Apache-2.0
"""`.ci/complete.json`: at which commit each group last passed its complete run.

CI runs a group when anything that concerns it changed since then. Whatever is unclear (no record,
a damaged file, a commit that is no ancestor, no git) makes the group run.
"""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path

from runner.groups import ROOT, GroupError, Groups

FILE = Path(".ci") / "complete.json"
COMMIT = re.compile(r"[0-9a-f]{40}")


def changed_groups(groups: Groups, root: Path = ROOT) -> dict[str, str]:
    """Return the groups that CI has to run, each with the reason."""
    try:
        commits = read(root / FILE)
    except ValueError as error:
        return dict.fromkeys(groups.names, f"{FILE} is damaged: {error}")
    found: dict[str, str] = {}
    for name in groups.names:
        reason = _reason(groups, name, commits.get(name), root)
        if reason is not None:
            found[name] = reason
    return found


def record(groups: list[str], root: Path = ROOT) -> None:
    """Write that these groups passed at the commit that is checked out.

    Raises:
        GroupError: there are uncommitted changes, so no commit describes what was tested.
    """
    commit = require_clean(root)
    try:
        commits = read(root / FILE)
    except ValueError:
        commits = {}
    commits |= dict.fromkeys(groups, commit)
    text = json.dumps({"format": 1, "groups": commits}, indent=2, sort_keys=True)
    (root / FILE).write_text(f"{text}\n", encoding="utf-8")


def require_clean(root: Path = ROOT) -> str:
    """Return the commit that is checked out, without any change.

    Raises:
        GroupError: there are changes, or this is no git checkout.
    """
    changes = _git(root, "status", "--porcelain")
    commit = _git(root, "rev-parse", "HEAD")
    if changes is None or commit is None:
        raise GroupError("--record needs a git checkout")
    if changes:
        raise GroupError(f"--record needs a clean tree; commit these changes first:\n{changes}")
    return commit


def read(file: Path) -> dict[str, str]:
    """Return the commit of each group's record; none when there is no file.

    Raises:
        ValueError: the file is not what `record` writes.
    """
    if not file.is_file():
        return {}
    plain = json.loads(file.read_bytes())
    if not isinstance(plain, dict) or plain.keys() != {"format", "groups"} or plain["format"] != 1:
        raise ValueError("expected the fields `format` (1) and `groups`")
    commits = plain["groups"]
    if not isinstance(commits, dict) or not all(
        isinstance(value, str) and COMMIT.fullmatch(value) for value in commits.values()
    ):
        raise ValueError("expected a commit of 40 digits for each group")
    return commits


def _reason(groups: Groups, name: str, commit: str | None, root: Path) -> str | None:
    if commit is None:
        return "no complete run is recorded"
    if _git(root, "merge-base", "--is-ancestor", commit, "HEAD") is None:
        return f"its record {commit[:10]} is no ancestor of this commit"
    changed = _git(root, "diff", "--name-only", "--no-renames", commit)
    new = _git(root, "ls-files", "--others", "--exclude-standard")
    if changed is None or new is None:
        return "git cannot say what changed"
    paths = [path for path in (*changed.splitlines(), *new.splitlines()) if Path(path) != FILE]
    mine = [path for path in paths if name in groups.touched([path])]
    return f"{len(mine)} files changed since {commit[:10]}, such as {mine[0]}" if mine else None


def _git(root: Path, *words: str) -> str | None:
    """Return what git prints, or None when it fails."""
    command = ["git", "-c", "core.quotePath=false", *words]
    try:
        done = subprocess.run(command, cwd=root, capture_output=True, text=True, check=False)
    except OSError:
        return None
    return done.stdout.strip() if done.returncode == 0 else None
