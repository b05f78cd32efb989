# SPDX-License-Identifier: Apache-2.0
"""`python benchmarks/gateway.py`: what `authguard mcp` adds to a call, and what a refusal takes.

One client of the protocol makes the same call to the server itself and through the gateway, in
turns, over standard input and output and over HTTP. Gate, gateway, server and estimator are
processes of their own on the machine's cores; the server does nothing but note the call, so that
what is added stands out. `--ros-mcp ENVIRONMENT` asks the real ros-mcp beside it, in front of a
rosbridge on loopback: its refusals beside its own answers. Net is less one bare fdatasync of the
same minutes.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import AsyncExitStack, ExitStack, asynccontextmanager, contextmanager
from pathlib import Path
from time import perf_counter_ns
from typing import Any

import httpx2
import yaml
from mcp import Client, StdioServerParameters, stdio_client
from mcp.client.streamable_http import streamable_http_client

import machine
from measure import Timing, difference, ratio, timing_of
from scene import ROOT, gate_process, scenarios
from serving import serving

sys.path.append(str(ROOT / "tests"))
from fixtures.estimator import attesting

SERVER = ROOT / "tests" / "programs" / "courier_mcp_server.py"
BRIDGE = ROOT / "tests" / "programs" / "rosbridge_server.py"
SCAN: tuple[str, dict[str, Any]] = ("scan", {})
HIJACK: tuple[str, dict[str, Any]] = ("navigate_to", {"destination": "Isolation Room"})
TOPICS: tuple[str, dict[str, Any]] = ("get_topics", {})
#: A goal in the isolation room, as ros-mcp is asked for one.
POSE = {"position": {"x": 21, "y": -3, "z": 0}, "orientation": {"w": 1}}
GOAL: tuple[str, dict[str, Any]] = (
    "send_action_goal",
    {
        "action_name": "/navigate_to_pose",
        "action_type": "nav2_msgs/action/NavigateToPose",
        "goal": {"pose": {"header": {"frame_id": "main"}, "pose": POSE}},
    },
)
TOKEN = "0123456789abcdefghijklmn"
MS = 1e6
ADDED = {"stdio": 4.0, "http": 5.0}
REFUSED = 0.5
Ask = Callable[[], Awaitable[Any]]


class Calls:
    """Who is asked what, and what it took."""

    def __init__(self, blocks: int, calls: int) -> None:
        self._blocks, self._calls = blocks, calls
        self._asked: dict[str, Ask] = {}

    def add(
        self, name: str, client: Client, call: tuple[str, dict[str, Any]], **want: bool
    ) -> None:
        """Ask a client for a tool; `refused` says what the answer has to be."""

        async def ask() -> None:
            answer = await client.call_tool(*call)
            if answer.is_error is not want.get("refused", False):
                raise RuntimeError(f"{name}: not the answer that is measured: {answer}")

        self._asked[name] = ask

    def add_bare(self, name: str, ask: Ask) -> None:
        """Measure something that is no call."""
        self._asked[name] = ask

    async def timed(self) -> dict[str, Timing]:
        """Return each one's timing, measured in turns."""
        for ask in self._asked.values():
            for _ in range(20):
                await ask()
        blocks: dict[str, list[list[int]]] = {name: [] for name in self._asked}
        for number in range(self._blocks):
            names = list(self._asked)
            turn = number % len(names)
            for name in names[turn:] + names[:turn]:
                blocks[name].append([await _took(self._asked[name]) for _ in range(self._calls)])
        return {name: timing_of(samples) for name, samples in blocks.items()}


async def _took(ask: Ask) -> int:
    start = perf_counter_ns()
    await ask()
    return perf_counter_ns() - start


@asynccontextmanager
async def over_stdio(*words: Any) -> AsyncIterator[Client]:
    """Yield a client of a server that it starts."""
    command, *rest = map(str, words)
    async with Client(stdio_client(StdioServerParameters(command=command, args=rest))) as client:
        yield client


@asynccontextmanager
async def over_http(url: str) -> AsyncIterator[Client]:
    """Yield a client of a server that listens."""
    shown = {"Authorization": f"Bearer {TOKEN}"}
    async with (
        httpx2.AsyncClient(headers=shown) as wire,
        Client(streamable_http_client(url, http_client=wire)) as client,
    ):
        yield client


@contextmanager
def started(*words: Any, says: str = "stdout") -> Iterator[str]:
    """Yield where a process says that it is reached."""
    pipes: dict[str, Any] = {says: subprocess.PIPE}
    with subprocess.Popen([str(word) for word in words], text=True, **pipes) as process:
        try:
            line = ""
            while "http://" not in line and not line.strip().isdigit():
                line = (process.stdout or process.stderr).readline()  # type: ignore[union-attr]
                if not line:
                    raise RuntimeError(f"{words} did not start")
            last = line.split()[-1]
            yield f"http://127.0.0.1:{last}/mcp" if last.isdigit() else last
        finally:
            process.terminate()


def gateway(gate: gate_process.RunningGate, *more: Any) -> list[Any]:
    """Return the command of a gateway; what follows `--` is the server."""
    words = [
        gate_process.AUTHGUARD,
        "mcp",
        "--robot",
        gate.rid,
        "--gate",
        gate.run,
        "--site",
        gate.site,
    ]
    return [*words, "--binding", gate.binding, "--trust", gate.trust, *more]


def bare(folder: Path) -> Ask:
    """Return a write of a page and its fdatasync, on the disk that the store lies on."""
    file = os.open(folder / "bare", os.O_CREAT | os.O_WRONLY)

    async def ask() -> None:
        os.pwrite(file, b"x" * 4_096, 0)
        os.fdatasync(file)

    return ask


def toy(folder: Path, blocks: int, calls: int) -> dict[str, Timing]:
    """Return the timings beside a server that does nothing, over both transports.

    Each transport has a gate of its own: a robot has one controller.
    """
    noted, token = folder / "calls.jsonl", folder / "token"
    token.write_text(TOKEN)
    token.chmod(0o600)

    async def stdio(gate: gate_process.RunningGate) -> dict[str, Timing]:
        server = (sys.executable, SERVER, noted)
        async with over_stdio(*server) as own, over_stdio(*gateway(gate, "--", *server)) as guarded:
            found = Calls(blocks, calls)
            found.add("stdio.direct", own, SCAN)
            found.add("stdio.allowed", guarded, SCAN)
            found.add("stdio.refused", guarded, HIJACK, refused=True)
            found.add_bare("stdio.fdatasync", bare(folder))
            return await found.timed()

    async def http(url: str, front: str) -> dict[str, Timing]:
        async with over_http(url) as own, over_http(front) as guarded:
            found = Calls(blocks, calls)
            found.add("http.direct", own, SCAN)
            found.add("http.allowed", guarded, SCAN)
            found.add("http.refused", guarded, HIJACK, refused=True)
            found.add_bare("http.fdatasync", bare(folder))
            return await found.timed()

    with serving(folder, "stdio") as gate, attesting(gate):
        timings = asyncio.run(stdio(gate))
    with serving(folder, "http") as gate, attesting(gate), ExitStack() as stack:
        url = stack.enter_context(started(sys.executable, SERVER, noted, "http"))
        listen = ("--listen", "127.0.0.1:0", "--token-file", token)
        command = gateway(gate, *listen, "--", url)
        front = stack.enter_context(started(*command, says="stderr"))
        return timings | asyncio.run(http(url, front))


def ros(folder: Path, environment: Path, blocks: int, calls: int) -> dict[str, Timing]:
    """Return the timings beside the real ros-mcp: what it answers itself, and what is refused."""
    plain = yaml.safe_load((scenarios.HOSPITAL / "site.yaml").read_text())
    del plain["vocabulary"]
    site = folder / "site.yaml"
    site.write_text(yaml.safe_dump({**plain, "words": "standard"}))
    server = (environment / "bin" / "ros-mcp", "--transport", "stdio")

    async def measured(gate: gate_process.RunningGate) -> dict[str, Timing]:
        async with AsyncExitStack() as stack:
            own = await stack.enter_async_context(over_stdio(*server))
            words = gateway(gate, "--", *server)
            guarded = await stack.enter_async_context(over_stdio(*words))
            found = Calls(blocks, calls)
            found.add("ros.direct", own, TOPICS)
            found.add("ros.refused", guarded, GOAL, refused=True)
            return await found.timed()

    bridge = (environment / "bin" / "python", BRIDGE, folder / "arrived.jsonl")
    made = gate_process.RunningGate(site=site, binding=Path("ros-mcp"))
    with started(*bridge), made as gate, attesting(gate):
        gate.activate()
        return asyncio.run(measured(gate))


def figures(timings: dict[str, Timing]) -> dict[str, float]:
    """Return what the timings say, milliseconds and ratios."""
    found: dict[str, float] = {}
    for name in ("stdio", "http"):
        direct, bare_ = timings[f"{name}.direct"], timings[f"{name}.fdatasync"]
        added = difference(timings[f"{name}.allowed"], direct) - bare_.p50
        found[f"{name}.added_ms"] = added / MS
        found[f"{name}.refused"] = ratio(timings[f"{name}.refused"], direct)
    if "ros.direct" in timings:
        found["ros.refused"] = ratio(timings["ros.refused"], timings["ros.direct"])
    return found


def lines(timings: dict[str, Timing], found: dict[str, float]) -> Iterator[str]:
    """Yield the lines for people."""
    for name, timing in timings.items():
        yield f"{name}: p50 {timing.p50 / MS:.2f} ms, p95 {timing.p95 / MS:.2f} ms"
    for name, target in ADDED.items():
        added = found[f"{name}.added_ms"]
        met = "met" if added <= target else "MISSED"
        yield f"{name}: an allowed call takes {added:.2f} ms more, net: target {target}: {met}"
    for name in ("stdio", "http", "ros"):
        if f"{name}.refused" in found:
            share = found[f"{name}.refused"]
            met = "met" if share <= REFUSED else "MISSED"
            yield f"{name}: a refused call takes {share:.2f} of a direct one: {REFUSED}: {met}"


def main() -> int:
    """Measure, print, and write what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--blocks", type=int, default=7, help="rounds of turns")
    parser.add_argument("--calls", type=int, default=200, help="calls of each in a block")
    parser.add_argument("--ros-mcp", type=Path, help="an environment that has ros-mcp 3.1.2")
    parser.add_argument("--json", type=Path, help="write the results here")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="gateway-") as folder:
        timings = toy(Path(folder), given.blocks, given.calls)
        if given.ros_mcp:
            timings |= ros(Path(folder), given.ros_mcp, given.blocks, given.calls)
    found = figures(timings)
    print("\n".join(lines(timings, found)))
    if given.json:
        plain = {name: timing.plain() for name, timing in timings.items()}
        result = {"machine": machine.describe(Path.cwd()), "results": plain, "figures": found}
        given.json.write_text(json.dumps(result, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
