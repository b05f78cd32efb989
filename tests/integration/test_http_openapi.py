# SPDX-License-Identifier: Apache-2.0
"""The decision point does what its OpenAPI document says, and refuses everything else as it says.

The document is read, and the server asked, by schemathesis: every check that it has.
Source: docs/spec/http.md#openapi
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from authguard_r.integrations.http.process import openapi
from fixtures import scenarios
from fixtures.decision_point import TOKEN, Served, serving
from fixtures.gate_process import RunningGate, until

SCHEMATHESIS = Path(sys.executable).parent / "schemathesis"


def checked(served: Served, folder: Path, *more: str) -> subprocess.CompletedProcess[str]:
    """Return what schemathesis says of a server."""
    env = {**os.environ, "SCHEMATHESIS_HOOKS": "http_numbers"}
    env["PYTHONPATH"] = str(scenarios.ROOT / "tests" / "programs")
    said = [str(SCHEMATHESIS), "--no-color", "run", f"{served.url}/openapi.json"]
    said += ["-H", f"Authorization: Bearer {TOKEN}", "--checks", "all", *more]
    said += ["--generation-deterministic"]
    return subprocess.run(said, capture_output=True, text=True, cwd=folder, env=env, check=False)


@pytest.fixture(scope="module")
def gate() -> Iterator[RunningGate]:
    with RunningGate(simulate=True, refusals=0) as made:
        made.activate()
        yield made


@pytest.mark.parametrize("examples", [5, pytest.param(500, marks=pytest.mark.nightly)])
def test_it_does_what_it_says(gate: RunningGate, tmp_path: Path, examples: int) -> None:
    with serving(gate, "--propose") as served:
        done = checked(served, tmp_path, "--max-examples", str(examples))
        assert done.returncode == 0, done.stdout[-6_000:]
        statuses = lambda: {line["status"] for line in served.requests()}  # noqa: E731
        until(lambda: statuses() >= {200, 400, 401, 404, 405}, "a request of each kind")
    assert 500 not in statuses()  # it has written every line by now


def test_the_document_is_the_servers_own(gate: RunningGate) -> None:
    for more in ((), ("--propose",)):
        with serving(gate, *more) as served:
            answer = served.get("/openapi.json")
            assert answer.content == openapi(propose=bool(more))
            assert ("/v1/proposals" in json.loads(answer.content)["paths"]) is bool(more)
