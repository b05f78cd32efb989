# SPDX-License-Identifier: Apache-2.0
"""Standard input and output of a gateway: whatever stands at their ends, and however it ends."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from authguard_r.integrations.mcp.standard import MAX_MESSAGE
from fixtures import scenarios
from fixtures.estimator import attesting
from fixtures.gate_process import PATIENCE_S, RunningGate, authguard, environment

SERVER = scenarios.ROOT / "tests" / "programs" / "courier_mcp_server.py"
HELLO = {
    "protocolVersion": "2025-11-25",
    "capabilities": {},
    "clientInfo": {"name": "raw", "version": "1"},
}


@pytest.fixture(scope="module")
def gate() -> Iterator[RunningGate]:
    with RunningGate() as made, attesting(made):
        made.activate()
        yield made


def started(gate: RunningGate, calls: Path, **pipes: Any) -> subprocess.Popen[bytes]:
    words = ["mcp", "--robot", gate.rid, "--gate", gate.run, "--site", gate.site]
    words += ["--binding", gate.binding, "--trust", gate.trust, "--", sys.executable, SERVER, calls]
    return subprocess.Popen(authguard(*words), env=environment(measured=False), **pipes)


def said(number: int, method: str, params: dict[str, Any]) -> bytes:
    asked = {"jsonrpc": "2.0", "id": number, "method": method, "params": params}
    return json.dumps(asked).encode() + b"\n"


def test_of_a_message_that_is_too_long_nothing_is_kept(gate: RunningGate, tmp_path: Path) -> None:
    pipe, long = subprocess.PIPE, b"x" * (2 * MAX_MESSAGE + 2) + b"\n"
    with started(gate, tmp_path / "c", stdin=pipe, stdout=pipe, stderr=pipe) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        answers = []
        for asked in (said(1, "initialize", HELLO), long, said(2, "ping", {})):
            process.stdin.write(asked)
            process.stdin.flush()
            answers.append(json.loads(process.stdout.readline()))
        _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0
    assert b"Traceback" not in errors
    first, told, last = answers
    assert (first["id"], last["id"], last["result"]) == (1, 2, {})
    assert (told["id"], told["error"]["code"]) == (None, -32_700)


def test_a_request_in_a_file_is_answered_into_one(gate: RunningGate, tmp_path: Path) -> None:
    asked, answers = tmp_path / "asked", tmp_path / "answers"
    asked.write_bytes(said(1, "initialize", HELLO))
    with (
        asked.open("rb") as source,
        answers.open("wb") as sink,
        started(gate, tmp_path / "c", stdin=source, stdout=sink) as process,
    ):
        assert process.wait(PATIENCE_S) == 0
    assert [json.loads(line)["id"] for line in answers.read_text().splitlines()] == [1]


def test_a_client_that_reads_nothing_more_makes_no_noise(gate: RunningGate, tmp_path: Path) -> None:
    pipe = subprocess.PIPE
    with started(gate, tmp_path / "c", stdin=pipe, stdout=pipe, stderr=pipe) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(said(1, "initialize", HELLO))
        process.stdin.flush()
        assert json.loads(process.stdout.readline())["id"] == 1
        process.stdout.close()
        for number in range(2, 30):
            process.stdin.write(said(number, "ping", {}))
        process.stdin.close()
        assert process.wait(PATIENCE_S) == 0
        assert process.stderr is not None
        assert b"Traceback" not in process.stderr.read()
