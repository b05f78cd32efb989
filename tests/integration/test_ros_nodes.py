# SPDX-License-Identifier: Apache-2.0
"""The tests that need ROS 2, each file in a network of its own: real nodes, and nobody else.

The wheels of ROS start every Python of their environment anew, so they have one of their own
(tests/ros/make.sh); `AUTHGUARD_ROS` names its folder. Source: docs/spec/ros.md
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from fixtures.gate_process import environment
from ros.run import FILES, Runs

ENVIRONMENT = os.environ.get("AUTHGUARD_ROS", "")
pytestmark = pytest.mark.skipif(
    not ENVIRONMENT, reason="AUTHGUARD_ROS names no environment (tests/ros/make.sh)"
)
#: Files with tests that belong to the default run.
SMOKE = [file for file in FILES if "mark.smoke" in file.read_text()]


def name_of(file: Path) -> str:
    return file.stem.removeprefix("test_")


@pytest.fixture(scope="module")
def runs(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Runs]:
    """One run of each file that was asked for; all of them have begun.

    A file that was asked for twice, by its smoke tests and by the others, runs whole and once.
    """
    asked: dict[Path, set[str]] = {}
    for item in request.session.items:
        if item.path == request.path and isinstance(item, pytest.Function):
            asked.setdefault(item.callspec.params["file"], set()).add(item.originalname)
    words = {file: _words(names) for file, names in asked.items()}
    folder = tmp_path_factory.mktemp("ros")
    with Runs(Path(ENVIRONMENT), words, folder, variables=environment(measured=True)) as made:
        yield made


def _words(names: set[str]) -> tuple[str, ...]:
    """Return which tests of a file are meant, as `tests/conftest.py` reads it."""
    if len(names) > 1:
        return ()
    return ("--run", "default" if test_smoke_on_real_nodes.__name__ in names else "rest")


@pytest.mark.smoke
@pytest.mark.parametrize("file", SMOKE, ids=name_of)
def test_smoke_on_real_nodes(file: Path, runs: Runs) -> None:
    run = runs.of(file)
    assert run.is_shown, run.said[-10_000:]


@pytest.mark.parametrize("file", FILES, ids=name_of)
def test_on_real_nodes(file: Path, runs: Runs) -> None:
    run = runs.of(file)
    assert run.is_shown, run.said[-10_000:]
