# SPDX-License-Identifier: Apache-2.0
"""What the tests on ROS 2 have in common; a file with a gate of its own says so itself."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from fixtures.gate_process import RunningGate
from ros.hospital import hospital


@pytest.fixture(scope="module")
def gate() -> Iterator[RunningGate]:
    with hospital() as made:
        yield made


@pytest.fixture
def mortal() -> Iterator[RunningGate]:
    """A gate of a test's own, which may be killed, or whose mission ends suspended."""
    with hospital() as made:
        yield made


@pytest.fixture
def graph(tmp_path: Path, gate: RunningGate) -> Iterator[Any]:
    """A graph with a robot in it."""
    from ros.graph import graph_of  # where there is no ROS, nobody asks for it

    gate.mark()
    with graph_of(tmp_path, gate) as made:
        yield made
