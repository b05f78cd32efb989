# SPDX-License-Identifier: Apache-2.0
"""Which tests run: `--run` names the run, `--group` the groups; without them, what was asked for.

Every test file belongs to a group of `tests/groups.toml`; one that belongs to none fails the
collection. Three marks place a single test: `smoke` (in the default run although the rest of its
group is not), `complete` (not in the default run), `nightly` (only at night).
"""

from __future__ import annotations

import os
from functools import cache
from importlib.util import find_spec
from itertools import compress
from operator import not_
from pathlib import Path

import pytest

from runner.groups import Group, GroupError, Groups, Run, missing, read_groups, unowned

ROS_TESTS = Path(__file__).resolve().parent / "ros"
# How long an example takes, the machine's load says: speed is measured in `benchmarks/`.
if find_spec("hypothesis") is not None:  # the environment with ROS may have none
    from hypothesis import settings

    settings.register_profile("untimed", deadline=None)
    settings.load_profile("untimed")


def pytest_addoption(parser: pytest.Parser) -> None:
    added = parser.getgroup("groups of tests")
    added.addoption("--run", choices=[*Run], help="which tests of the groups")
    added.addoption("--group", action="append", default=[], help="only this group; repeatable")


def pytest_configure(config: pytest.Config) -> None:
    try:
        groups = read_groups()
        chosen = [groups.named(name).name for name in config.getoption("group")]
    except GroupError as error:
        raise pytest.UsageError(str(error)) from error
    lost = unowned(groups)
    if lost or missing(groups):
        raise pytest.UsageError(
            f"tests/groups.toml: no group owns {lost}; not there: {missing(groups)}"
        )
    config.stash[_GROUPS] = groups
    config.stash[_CHOSEN] = frozenset(chosen or groups.names)
    if config.getoption("run") in {Run.COMPLETE, Run.NIGHTLY}:
        os.environ["AUTHGUARD_COMPLETE"] = "1"  # for processes that tests start, too


_GROUPS = pytest.StashKey[Groups]()
_CHOSEN = pytest.StashKey[frozenset[str]]()


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Import no file of which nothing would run."""
    if collection_path.suffix != ".py" or not collection_path.name.startswith("test_"):
        return None
    if collection_path.is_relative_to(ROS_TESTS) and find_spec("rclpy") is None:
        return True  # tests/integration/test_ros_nodes.py runs them in their own environment
    run, group = config.getoption("run"), _owner(config, collection_path)
    if group.name not in config.stash[_CHOSEN]:
        return True
    marks = {mark: f"mark.{mark}" in collection_path.read_text() for mark in ("smoke", "nightly")}
    hopeless = (run == Run.DEFAULT and group.is_smoke and not marks["smoke"]) or (
        run == Run.NIGHTLY and not marks["nightly"]
    )
    return True if hopeless else None


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Deselect what the run does not contain."""
    run = config.getoption("run")
    runs = [_runs(item, _owner(config, item.path), run) for item in items]
    if not all(runs):
        config.hook.pytest_deselected(items=[*compress(items, map(not_, runs))])
        items[:] = [*compress(items, runs)]


@cache
def _owner(config: pytest.Config, path: Path) -> Group:
    groups = config.stash[_GROUPS]
    found = groups.owner(path.relative_to(config.rootpath).as_posix())
    if found is None:
        raise pytest.UsageError(f"tests/groups.toml: no group owns {path}")
    return found


def _runs(item: pytest.Item, group: Group, run: str | None) -> bool:
    """Say whether a run contains a test."""
    marked = {mark.name for mark in item.iter_markers()}
    if "nightly" in marked or run == Run.NIGHTLY:
        return "nightly" in marked and run == Run.NIGHTLY
    is_default = "smoke" in marked or not (group.is_smoke or "complete" in marked)
    return {Run.DEFAULT: is_default, Run.REST: not is_default}.get(run, True)
