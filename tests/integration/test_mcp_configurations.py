# SPDX-License-Identifier: Apache-2.0
"""The configurations that the how-to gives for clients, each run with a client of the protocol.

Of each block only what a machine fills in is replaced: paths, the server behind `--`, the port and
the token. Everything else is passed on as it is written.
"""

from __future__ import annotations

import asyncio
import json
import re
import subprocess
import sys
import tomllib
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import httpx2
import pytest
from mcp import Client, StdioServerParameters, stdio_client
from mcp.client.streamable_http import streamable_http_client

from fixtures import scenarios
from fixtures.gate_process import AUTHGUARD, RunningGate
from fixtures.shared_gate import SharedGate

SERVER = scenarios.ROOT / "tests" / "programs" / "courier_mcp_server.py"
PAGE = (scenarios.ROOT / "docs" / "howto" / "mcp.md").read_text()
BLOCK = re.compile(r"^```(json|toml)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
TOKEN = "0123456789abcdefghijklmn"
#: How clients write a value that is not in the file.
KEPT = ("${ROBOT_TOKEN}", "${input:robot-token}")


def entries() -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield each block's entry for the robot, as its client reads it."""
    for number, (kind, text) in enumerate(BLOCK.findall(PAGE)):
        read = json.loads(text) if kind == "json" else tomllib.loads(text)
        (servers,) = (read[key] for key in ("mcpServers", "servers", "mcp_servers") if key in read)
        yield f"{number}-{kind}", servers["robot"]


ENTRIES = dict(entries())
STARTED = {name: e for name, e in ENTRIES.items() if e.get("command") == "authguard"}
REACHED = {name: e for name, e in ENTRIES.items() if "url" in e}


@pytest.fixture(scope="module")
def shared() -> Iterator[SharedGate]:
    with SharedGate() as made:
        yield made


@pytest.fixture
def gate(shared: SharedGate) -> Iterator[RunningGate]:
    with shared.one_test() as made:
        made.activate()
        yield made


def server(calls: Path) -> list[str]:
    return [sys.executable, str(SERVER), str(calls)]


def filled(gate: RunningGate, words: list[str], pins: Path, calls: Path) -> list[str]:
    """Return an entry's arguments with this machine's own places."""
    own = {"--gate": gate.run, "--site": gate.site, "--binding": gate.binding}
    own |= {"--trust": gate.trust, "--pins": pins, "--robot": gate.rid}
    options = words[: words.index("--")]
    for name, value in own.items():
        options[options.index(name) + 1] = str(value)
    return [*options, "--", *server(calls)]


@pytest.fixture(scope="module")
def pins(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the file with the server's tools, as the how-to has it made."""
    folder = tmp_path_factory.mktemp("pins")
    words = ["advanced", "mcp-tools", "--site", scenarios.HOSPITAL / "site.yaml"]
    words += ["--binding", scenarios.HOSPITAL / "binding.yaml", "--out", folder / "tools.json"]
    words += ["--", *server(folder / "calls.jsonl")]
    subprocess.run([AUTHGUARD, *words], capture_output=True, check=False)
    return folder / "tools.json"


async def guarded(client: Client, calls: Path) -> None:
    """A granted call arrives and a hijacked one does not."""
    calls.write_text("")
    assert not (await client.call_tool("scan", {})).is_error
    assert (await client.call_tool("navigate_to", {"destination": "Isolation Room"})).is_error
    assert [json.loads(line)["tool"] for line in calls.read_text().splitlines()] == ["scan"]


def test_the_page_has_a_block_for_each_kind_of_client() -> None:
    assert (len(STARTED), len(REACHED)) == (3, 3)
    assert len(ENTRIES) == 7  # and what it was before


@pytest.mark.parametrize("name", STARTED)
def test_a_client_that_starts_the_gateway_is_guarded(
    name: str, gate: RunningGate, pins: Path, tmp_path: Path
) -> None:
    calls = tmp_path / "calls.jsonl"
    words = filled(gate, STARTED[name]["args"], pins, calls)
    started = StdioServerParameters(command=str(AUTHGUARD), args=words)

    async def talk() -> None:
        async with Client(stdio_client(started)) as client:
            await guarded(client, calls)

    asyncio.run(talk())


def test_a_client_that_reaches_the_gateway_is_guarded(gate: RunningGate, tmp_path: Path) -> None:
    calls, token = tmp_path / "calls.jsonl", tmp_path / "token"
    token.write_text(TOKEN)
    token.chmod(0o600)
    words = ["mcp", "--robot", gate.rid, "--gate", gate.run, "--site", gate.site]
    words += ["--binding", gate.binding, "--trust", gate.trust]
    words += ["--listen", "127.0.0.1:0", "--token-file", token, "--", *server(calls)]
    with subprocess.Popen(
        [str(word) for word in (AUTHGUARD, *words)], stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stderr is not None
            said = next(line for line in process.stderr if "serving" in line).split()[1]
            here = said.removesuffix("/mcp")

            async def talk(entry: dict[str, Any]) -> None:
                url = re.sub(r"^http://127\.0\.0\.1:\d+", here, entry["url"])
                async with reached(url, headers_of(entry)) as client:
                    await guarded(client, calls)

            for entry in REACHED.values():
                asyncio.run(talk(entry))
        finally:
            process.terminate()


def headers_of(entry: dict[str, Any]) -> dict[str, str]:
    """Return what the client sends, with what it keeps or asks for filled in."""
    if entry.get("bearer_token_env_var") == "ROBOT_TOKEN":
        return {"Authorization": f"Bearer {TOKEN}"}
    (shown,) = entry["headers"].items()
    name, value = shown
    (kept,) = (word for word in KEPT if word in value)
    return {name: value.replace(kept, TOKEN)}


@asynccontextmanager
async def reached(url: str, headers: dict[str, str]) -> AsyncIterator[Client]:
    async with (
        httpx2.AsyncClient(headers=headers) as wire,
        Client(streamable_http_client(url, http_client=wire)) as client,
    ):
        yield client
