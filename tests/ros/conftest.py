# SPDX-License-Identifier: Apache-2.0
"""What the tests on ROS 2 have in common; a file with a gate of its own says so itself.

`graph` is the module's: its node serves already. `fresh` is a test's own, and nothing is started.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from fixtures.gate_process import RunningGate
from ros.hospital import HERE, hospital


def pytest_configure(config: pytest.Config) -> None:
    # rclpy's own logger, when somebody asks for the result of no goal
    config.addinivalue_line("filterwarnings", "ignore:Deprecated in favor of:DeprecationWarning")


@pytest.fixture(scope="module")
def gate() -> Iterator[RunningGate]:
    with hospital() as made:
        yield made


@pytest.fixture(scope="module")
def shared_gate(gate: RunningGate) -> Iterator[Any]:
    """The module's gate, with what gives each test a mission of its own."""
    from ros.shared_graph import SharedGate  # where there is no ROS, nobody asks for it

    made = SharedGate(gate)
    yield made
    made.end()


@pytest.fixture(scope="module")
def source() -> Path:
    """The map of the module's graph."""
    return HERE / "map.yaml"


@pytest.fixture(scope="module")
def shared_graph(
    shared_gate: Any, source: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Any]:
    from ros.shared_graph import SharedGraph, honks

    folder = tmp_path_factory.mktemp("graph")
    made = SharedGraph(shared_gate, folder, lambda graph: graph.start(source), honks)
    yield made
    made.end()


@pytest.fixture
def graph(shared_graph: Any, gate: RunningGate) -> Iterator[Any]:
    """The module's graph: a robot that was told nothing yet, and a node that serves."""
    from ros.graph import shown

    made = shared_graph.renew()
    with shown(made, gate):
        yield made
        made.rest()


@pytest.fixture
def fresh(tmp_path: Path, shared_gate: Any, shared_graph: Any, gate: RunningGate) -> Iterator[Any]:
    """A graph of a test's own, with a robot in it and nothing else; the module's node ends."""
    from ros.graph import graph_of

    shared_graph.end()
    shared_gate.renew()
    shared_gate.mark()
    with graph_of(tmp_path, gate) as made:
        yield made
