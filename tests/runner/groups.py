# SPDX-License-Identifier: Apache-2.0
"""Groups of tests, as `tests/groups.toml` defines them.

A group owns test files, covers source folders, and names what its tests need. The longest path that
fits a file decides which group owns it.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
FILE = ROOT / "tests" / "groups.toml"


class GroupError(Exception):
    """The group file, or a group that somebody asked for, is wrong; the message says what to do."""


class Run(StrEnum):
    """Which tests of its groups a run contains."""

    DEFAULT = "default"  #: what a newcomer and every CI run execute
    REST = "rest"  #: what the complete run adds to the default run
    COMPLETE = "complete"  #: everything but the nightly tests
    NIGHTLY = "nightly"  #: only the nightly tests


@dataclass(frozen=True, kw_only=True)
class Group:
    """One group of tests.

    Args:
        name: its name on the command line.
        about: one line for people.
        tests: files and folders below the root that it owns.
        covers: source files and folders whose change makes its complete tests run in CI.
        is_smoke: the default run contains only its tests marked `smoke`, not all of them.
        environments: Python environments that its tests need; see `runner.environments`.
        programs: programs that its tests need, each with the Debian package that has it.
        untraced: its files that reach no line that the traced tests do not reach.
        serial: its tests have real deadlines: nothing runs beside them.
        commands: what its complete run does after the tests, as lines for a shell.
    """

    name: str
    about: str
    tests: tuple[str, ...]
    covers: tuple[str, ...] = ()
    is_smoke: bool = False
    environments: tuple[str, ...] = ()
    programs: Mapping[str, str]
    untraced: tuple[str, ...] = ()
    serial: bool = False
    commands: tuple[str, ...] = ()


@dataclass(frozen=True)
class Groups:
    """Every group, in the order of the file, and the paths that belong to all of them."""

    shared: tuple[str, ...]
    every: tuple[Group, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """The names, in order."""
        return tuple(group.name for group in self.every)

    def named(self, name: str) -> Group:
        """Return a group by its name.

        Raises:
            GroupError: there is none of this name; the message lists those there are.
        """
        found = next((group for group in self.every if group.name == name), None)
        if found is None:
            raise GroupError(f"no group `{name}`; the groups are: {', '.join(self.names)}")
        return found

    def owner(self, path: str) -> Group | None:
        """Return the group that owns a test file, given relative to the root."""
        return _longest(path, {place: group for group in self.every for place in group.tests})

    def touched(self, paths: Iterable[str]) -> tuple[str, ...]:
        """Return the groups that a change of these paths concerns.

        A source file that no group covers concerns every group.
        """
        found: set[str] = set()
        for path in paths:
            owner = self.owner(path)
            found |= set() if owner is None else {owner.name}
            covering = {group.name for group in self.every if _fits(path, group.covers)}
            found |= covering
            if _fits(path, self.shared) or (
                path.startswith(("src/", "packages/")) and not covering
            ):
                found |= set(self.names)
        return tuple(name for name in self.names if name in found)


def read_groups(file: Path = FILE) -> Groups:
    """Return the groups of a file.

    Raises:
        GroupError: it is no TOML, or has a field that means nothing.
    """
    try:
        plain = tomllib.loads(file.read_text(encoding="utf-8"))
        shared = tuple(plain.pop("shared"))
        every = tuple(_group(name, fields) for name, fields in plain.items())
    except (tomllib.TOMLDecodeError, KeyError, TypeError, AttributeError) as error:
        raise GroupError(f"{file.name}: {error}") from error
    return Groups(shared, every)


def unowned(groups: Groups, root: Path = ROOT) -> list[str]:
    """Return the test files that no group owns."""
    files = sorted((root / "tests").rglob("test_*.py"))
    paths = [file.relative_to(root).as_posix() for file in files]
    return [path for path in paths if groups.owner(path) is None]


def missing(groups: Groups, root: Path = ROOT) -> list[str]:
    """Return the paths that the group file names and that do not exist."""
    named = [
        *groups.shared,
        *(place for g in groups.every for place in (*g.tests, *g.covers, *g.untraced)),
    ]
    return sorted({place for place in named if not (root / place).exists()})


def _group(name: str, fields: dict[str, Any]) -> Group:
    default = fields.pop("default")
    if default not in {"all", "smoke"}:
        raise GroupError(f"[{name}] default: expected `all` or `smoke`, got `{default}`")
    lists = {
        key: tuple(value) if isinstance(value, list) else value for key, value in fields.items()
    }
    return Group(name=name, is_smoke=default == "smoke", **{"programs": {}, **lists})


def _fits(path: str, places: Iterable[str]) -> bool:
    return any(path == place or path.startswith(f"{place}/") for place in places)


def _longest(path: str, owners: Mapping[str, Group]) -> Group | None:
    fitting = [place for place in owners if _fits(path, (place,))]
    return owners[max(fitting, key=len)] if fitting else None
