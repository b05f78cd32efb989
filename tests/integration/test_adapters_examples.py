# SPDX-License-Identifier: Apache-2.0
"""The adapters' examples as processes of their own, beside a gate that runs."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from fixtures import scenarios
from fixtures.gate_process import PATIENCE_S, environment
from fixtures.guarded_tools import SCOPE
from fixtures.shared_gate import SharedGate

FOLDER = scenarios.ROOT / "examples" / "adapters"


@pytest.fixture(scope="module")
def shared() -> Iterator[SharedGate]:
    with SharedGate() as made:
        yield made


@pytest.mark.parametrize("name", ["decorated", "langgraph_courier"])
def test_the_allowed_calls_are_made_the_hijacked_one_is_not_and_the_agent_goes_on(
    name: str, shared: SharedGate, tmp_path: Path
) -> None:
    out = tmp_path / "moves.txt"
    with shared.one_test() as gate:
        gate.activate()
        words = [FOLDER / f"{name}.py", "--robot", gate.rid, "--run", gate.run]
        words += ["--trust", gate.trust, "--out", out]
        done = subprocess.run(
            [sys.executable, *map(str, words)],
            capture_output=True,
            text=True,
            check=True,
            timeout=PATIENCE_S,
            env=environment(measured=True),
        )
    assert out.read_text().splitlines() == ["scan", "navigate_to Pharmacy 0.5"]
    assert SCOPE in done.stdout
    assert "arrived at Pharmacy" in done.stdout
