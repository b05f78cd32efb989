# SPDX-License-Identifier: Apache-2.0
"""A neighbor without a token shuts no port: crowds at real servers that may open 1,024 files.

Source: docs/spec/listeners.md
"""

from __future__ import annotations

import socket
import ssl
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import httpx2
import pytest

from authguard_r.client import GateClient
from authguard_r.integrations.http import edge
from authguard_r.integrations.http_listener.admission import RESERVE
from authguard_r.wire.messages import ClientRole
from fixtures import scenarios, witness_process
from fixtures.crowds import FILES, crowd, few_files, open_files
from fixtures.decision_point import TOKEN, serving, tls_words, token_file, trusting
from fixtures.gate_process import PATIENCE_S, RunningGate, authguard, environment, until

#: More than the listeners have places for, and than their processes have files for.
MOST = 2_100
#: Who asks again and again takes the processor: so few of them are enough to fill a disk.
FEW = 8
#: Lines of one kind in a second, and the longest line about a stranger, in bytes.
LINES, LINE = edge.LIMITS.lines, 250
ASKS = 30
SERVER = scenarios.ROOT / "tests" / "programs" / "courier_mcp_server.py"
HELLO = {
    "jsonrpc": "2.0",
    "id": 1,
    "method": "initialize",
    "params": {
        "protocolVersion": "2025-11-25",
        "capabilities": {},
        "clientInfo": {"name": "known", "version": "1"},
    },
}


class Attacked:
    """A server that strangers stand at.

    Args:
        url: where.
        pid: its process.
        log: what it writes.
        ask: asks once as somebody whom it lets in; returns the status.
    """

    def __init__(self, url: str, pid: int, log: Path, ask: Callable[[], int]) -> None:
        self.url, self.pid, self.log, self.ask = url, pid, log, ask

    def line(self) -> socket.socket:
        """Return a connection of a stranger."""
        host, port = self.url.partition("//")[2].partition("/")[0].rsplit(":", 1)
        return socket.create_connection((host, int(port)), timeout=PATIENCE_S)


@pytest.fixture(scope="module")
def gate() -> Iterator[RunningGate]:
    with RunningGate(simulate=True) as running:
        running.activate()
        yield running


@contextmanager
def decision_point(gate: RunningGate, folder: Path, *more: str) -> Iterator[Attacked]:
    with serving(gate, *more, how=few_files) as served:
        verify: ssl.SSLContext | bool = trusting() if more else False

        def ask() -> int:
            with served.client(verify=verify) as client:
                return client.get("/v1/status").status_code

        yield Attacked(served.url, served.process.pid, served.log, ask)


@contextmanager
def gateway(gate: RunningGate, folder: Path) -> Iterator[Attacked]:
    words = ["mcp", "--robot", gate.rid, "--gate", gate.run, "--site", gate.site]
    words += ["--binding", gate.binding, "--trust", gate.trust, "--listen", "127.0.0.1:0"]
    words += ["--token-file", token_file(gate), "--", sys.executable, SERVER, folder / "calls"]
    command = few_files(authguard(*map(str, words)))
    path = folder / "log"
    with (
        path.open("wb") as log,
        subprocess.Popen(command, stderr=log, env=environment(measured=False)) as process,
    ):

        def serves() -> str:
            assert process.poll() is None, path.read_text()
            lines = path.read_text().splitlines()
            return next((line.split()[1] for line in lines if line.startswith("serving ")), "")

        try:
            url = str(until(serves, "the port"))
            headers = {
                "authorization": f"Bearer {TOKEN}",
                "accept": "application/json, text/event-stream",
            }

            def ask() -> int:
                with httpx2.Client(timeout=PATIENCE_S) as client:
                    return client.post(url, json=HELLO, headers=headers).status_code

            until(lambda: ask() == 200, "an answer")
            yield Attacked(url, process.pid, path, ask)
        finally:
            process.terminate()


@contextmanager
def witness(folder: Path) -> Iterator[Attacked]:
    log = witness_process.Log().grow(3)
    made = witness_process.make(folder / "w", log)
    with witness_process.served(made, how=few_files) as served:

        def ask() -> int:
            status, _, _ = served.post(log.ask(0))
            return 200 if status == 409 else status  # it has seen this checkpoint

        yield Attacked(served.ready["url"], served.child.pid, folder / "w.journal", ask)


@pytest.fixture(params=["serve", "serve-tls", "mcp", "witness"])
def attacked(
    request: pytest.FixtureRequest, gate: RunningGate, tmp_path: Path
) -> Iterator[Attacked]:
    with ExitStack() as held:
        made = {
            "serve": lambda: decision_point(gate, tmp_path),
            "serve-tls": lambda: decision_point(gate, tmp_path, *tls_words()),
            "mcp": lambda: gateway(gate, tmp_path),
            "witness": lambda: witness(tmp_path),
        }[request.param]()
        yield held.enter_context(made)


def served_beside(attacked: Attacked, kind: str) -> None:
    """Require that who is known is served beside a crowd, and that little is written."""
    began, before = time.monotonic(), attacked.log.stat().st_size
    with crowd(kind, attacked.url, FEW if kind in {"asks", "broken"} else MOST):
        for _ in range(ASKS):
            assert attacked.ask() == 200
            assert open_files(attacked.pid) < FILES - RESERVE // 2
    spent = 1 + time.monotonic() - began
    written = attacked.log.stat().st_size - before
    # two kinds, and who is known
    assert written < (2 * LINES * spent + 2 * ASKS) * LINE, attacked.log.read_text()[-2_000:]
    assert "Traceback" not in attacked.log.read_text()
    assert attacked.ask() == 200


@pytest.mark.parametrize("kind", ["idle", "half", "noise", "broken", "asks"])
def test_a_crowd_keeps_nobody_out_who_is_known(attacked: Attacked, kind: str) -> None:
    served_beside(attacked, kind)


@pytest.mark.smoke
def test_a_crowd_at_the_decision_point_keeps_nobody_out_who_is_known(
    gate: RunningGate, tmp_path: Path
) -> None:
    with decision_point(gate, tmp_path) as attacked:
        served_beside(attacked, "idle")


def test_a_crowd_at_a_port_takes_nothing_from_a_stop(gate: RunningGate, tmp_path: Path) -> None:
    with (
        decision_point(gate, tmp_path) as attacked,
        crowd("asks", attacked.url, FEW),
        crowd("noise", attacked.url, 200),
        GateClient.connect(gate.socket, role=ClientRole.PLANNER, client="hand") as hand,
    ):
        for _ in range(20):
            began = time.monotonic()
            said = hand.stop("beside a crowd")
            assert said["stopped"] is True
            assert said["after_ms"] <= gate.config.stand_within_ms
            assert time.monotonic() - began < PATIENCE_S


def test_a_stranger_goes_and_who_waits_for_an_answer_does_not(attacked: Attacked) -> None:
    first = attacked.line()
    with crowd("idle", attacked.url, MOST):
        assert first.recv(1) == b""
        assert attacked.ask() == 200
    first.close()
    assert "crowded" in attacked.log.read_text()


def test_with_too_few_files_a_listener_does_not_start(gate: RunningGate) -> None:
    words = ["serve", "--robot", gate.rid, "--gate", gate.run, "--trust", gate.trust]
    words += ["--token-file", token_file(gate), "--listen", "127.0.0.1:0"]
    done = subprocess.run(
        few_files(authguard(*map(str, words)), 64),
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        env=environment(measured=False),
        check=False,
    )
    assert done.returncode == 5
    assert "ulimit -n" in done.stderr


def test_with_few_files_it_takes_fewer_connections(gate: RunningGate, tmp_path: Path) -> None:
    def how(command: list[str]) -> list[str]:
        return few_files(command, 200)

    with serving(gate, how=how) as served, crowd("idle", served.url, 400):
        assert served.get("/v1/status").status_code == 200
        assert open_files(served.process.pid) < 200
        lines = served.lines()
        assert {"crowded"} <= {line["event"] for line in lines}
