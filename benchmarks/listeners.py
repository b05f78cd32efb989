# SPDX-License-Identifier: Apache-2.0
"""`python benchmarks/listeners.py`: what a crowd at a port takes from a client and a stop.

`authguard serve` may open 1,024 files. One client shows the token and asks for the status, on a new
connection each time; then somebody stops the robot at the gate's own socket. Blocks without and
with a crowd take turns, each kind of crowd beside quiet blocks of its own. Gate, decision point,
crowd and the measuring client are processes on the same cores.
"""

from __future__ import annotations

import argparse
import http.client
import json
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from time import perf_counter_ns
from typing import Any, NamedTuple

import machine
import serving
import table
from measure import percentile, timing_of
from scene import ROOT

sys.path.append(str(ROOT / "tests"))
from authguard_r.client import GateClient
from authguard_r.wire.messages import ClientRole
from fixtures.crowds import FILES, crowd, few_files, open_files
from fixtures.decision_point import BEARER, Served
from fixtures.decision_point import serving as decision_point
from fixtures.gate_process import PATIENCE_S, RunningGate, until

#: How many of each kind (`tests/programs/crowd.py`): who asks again and again needs no others.
CROWDS = {"idle": 2_100, "half": 2_100, "noise": 2_100, "asks": 8}
BEGIN, END = "<!-- begin strangers -->", "<!-- end strangers -->"
#: A crowd stands no longer, in seconds, whatever becomes of this process.
LONGEST_S = 600.0
QUIET, CROWDED = "quiet", "crowded"
_MS = 1e6
#: Files that are open beyond those of a quiet server when a crowd counts as gone.
_LEFT = 4


class Effort(NamedTuple):
    """How often.

    Args:
        blocks: of each kind, without a crowd and with it.
        requests: in a block.
        stops: in a block.
    """

    blocks: int
    requests: int
    stops: int


FULL, QUICK = Effort(4, 100, 50), Effort(2, 20, 10)


class Block(NamedTuple):
    """What one block took, in nanoseconds.

    Args:
        requests: each of them.
        stops: each of them.
        log: bytes that were logged meanwhile, a second.
        first: the request before them, made as soon as the whole crowd has connected: it stands in
            the system's queue behind all whom the server has not taken in yet.
    """

    requests: list[int]
    stops: list[int]
    log: float
    first: int


class Place:
    """A gate with a decision point before it, and who is measured there.

    Args:
        gate: the gate.
        served: the decision point.
        hand: stops.
    """

    def __init__(self, gate: RunningGate, served: Served, hand: GateClient) -> None:
        self._gate, self._served, self._hand = gate, served, hand
        self._files = open_files(served.process.pid)

    def block(self, effort: Effort) -> Block:
        """Measure once."""
        before, began = self._logged(), time.monotonic()
        first = _took(self._ask)
        requests = [_took(self._ask) for _ in range(effort.requests)]
        stops = [_took(self._stop) for _ in range(effort.stops)]
        spent = time.monotonic() - began
        return Block(requests, stops, (self._logged() - before) / spent, first)

    def beside(self, kind: str, effort: Effort) -> Block:
        """Measure once beside a crowd; return when it has gone."""
        with crowd(kind, self._served.url, CROWDS[kind], seconds=LONGEST_S):
            found = self.block(effort)
        pid = self._served.process.pid
        until(lambda: open_files(pid) <= self._files + _LEFT, "the end of the crowd")
        return found

    def _ask(self) -> None:
        link = http.client.HTTPConnection(*self._served.address, timeout=PATIENCE_S)
        try:
            link.request("GET", "/v1/status", headers=BEARER)
            answer = link.getresponse()
            answer.read()
        finally:
            link.close()
        if answer.status != 200:
            raise RuntimeError(f"not the answer that is measured: {answer.status}")

    def _stop(self) -> None:
        said = self._hand.stop("measured")
        if not said["stopped"]:
            raise RuntimeError(f"not the stop that is measured: {said}")

    def _logged(self) -> int:
        return self._served.log.stat().st_size


def _took(act: Callable[[], None]) -> int:
    start = perf_counter_ns()
    act()
    return perf_counter_ns() - start


def measure(effort: Effort, folder: Path) -> dict[str, dict[str, list[Block]]]:
    """Return the blocks of each kind of crowd, without it and beside it."""
    found: dict[str, dict[str, list[Block]]] = {kind: {QUIET: [], CROWDED: []} for kind in CROWDS}
    with ExitStack() as stack:
        gate = stack.enter_context(serving.serving(folder, "strangers", simulate=True))
        served = stack.enter_context(decision_point(gate, how=few_files))
        hand = GateClient.connect(gate.socket, role=ClientRole.PLANNER, client="hand")
        place = Place(gate, served, stack.enter_context(hand))
        place.block(QUICK)  # warms up
        for number in range(effort.blocks):
            for kind, blocks in found.items():
                print(f"{number + 1}/{effort.blocks} {kind}", file=sys.stderr, flush=True)
                blocks[QUIET].append(place.block(effort))
                blocks[CROWDED].append(place.beside(kind, effort))
    return found


def figures(blocks: dict[str, list[Block]]) -> dict[str, Any]:
    """Return what the blocks of one kind say: milliseconds, ratios, bytes a second."""
    told: dict[str, Any] = {}
    for what in ("requests", "stops"):
        samples = {
            phase: [took for block in every for took in getattr(block, what)]
            for phase, every in blocks.items()
        }
        told[what] = {
            phase: {f"p{share}_ms": percentile(all_, share) / _MS for share in (50, 99)}
            for phase, all_ in samples.items()
        }
        told[what]["p99_ratio"] = told[what][CROWDED]["p99_ms"] / told[what][QUIET]["p99_ms"]
        told[what]["samples"] = len(samples[CROWDED])
    told["first_ms"] = max(block.first for block in blocks[CROWDED]) / _MS
    told["log_bytes_per_s"] = {
        phase: statistics.mean(block.log for block in every) for phase, every in blocks.items()
    }
    return told


def plain(found: dict[str, dict[str, list[Block]]]) -> dict[str, Any]:
    """Return the timing of every kind for JSON."""
    return {
        f"{what}.{kind}.{phase}": timing_of([getattr(block, what) for block in every]).plain()
        for kind, blocks in found.items()
        for phase, every in blocks.items()
        for what in ("requests", "stops")
    }


def lines(told: dict[str, dict[str, Any]]) -> Iterator[str]:
    """Yield the table's lines."""
    heads = ("crowd", "the first answer, ms")
    heads += ("a request, quiet, ms", "beside it, ms", "p99, times")
    heads += ("a stop, quiet, ms", "beside it, ms", "p99, times")
    heads += ("log, quiet, bytes a second", "beside it")
    yield f"| {' | '.join(heads)} |"
    yield f"|---|{'---:|' * (len(heads) - 1)}"
    for kind, one in told.items():
        cells = [f"{CROWDS[kind]:,} `{kind}`", f"{one['first_ms']:.0f}"]
        for what in ("requests", "stops"):
            for phase in (QUIET, CROWDED):
                took = one[what][phase]
                cells.append(f"{took['p50_ms']:.1f} / {took['p99_ms']:.1f}")
            cells.append(f"{one[what]['p99_ratio']:.2f}")
        cells += [f"{one['log_bytes_per_s'][phase]:,.0f}" for phase in (QUIET, CROWDED)]
        yield f"| {' | '.join(cells)} |"


def above(told: dict[str, dict[str, Any]], most: float) -> list[str]:
    """Return which ratios are too large."""
    return [
        f"{what} beside {kind}"
        for kind, one in told.items()
        for what in ("requests", "stops")
        if one[what]["p99_ratio"] > most
    ]


def main(arguments: list[str] | None = None) -> int:
    """Measure, print a table, write what was asked for."""
    asks = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    asks.add_argument("--quick", action="store_true", help="half a minute, with more noise")
    asks.add_argument("--json", type=Path, help="write the results here")
    asks.add_argument("--markdown", type=Path, help="write the table here")
    asks.add_argument("--require", type=float, metavar="RATIO", help="exit 1 above this ratio")
    given = asks.parse_args(arguments)
    effort = QUICK if given.quick else FULL
    with tempfile.TemporaryDirectory(prefix="listeners-") as folder:
        found = measure(effort, Path(folder))
    told = {kind: figures(blocks) for kind, blocks in found.items()}
    text = "\n".join(lines(told)) + "\n"
    print(text, end="")
    if given.markdown is not None:
        table.write(given.markdown, text, begin=BEGIN, end=END)
    if given.json is not None:
        result = {
            "schema": "authguard-r/listeners/1",
            "effort": "quick" if given.quick else "full",
            **machine.describe(Path(__file__).parent),
            "load": [round(load, 1) for load in os.getloadavg()],  # what else the machine had to do
            "files": FILES,
            "crowds": told,
            "timings": plain(found),
        }
        given.json.write_text(json.dumps(result, indent=1) + "\n")
    missed = above(told, given.require) if given.require is not None else []
    if missed:
        print(f"above {given.require:g}: {', '.join(missed)}", file=sys.stderr)
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
