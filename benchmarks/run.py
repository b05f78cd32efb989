# SPDX-License-Identifier: Apache-2.0
"""`python benchmarks/run.py`: every figure of design section 9, its yardstick in the same run.

One JSON object with machine and commit, one Markdown table. Nothing here is a test: a slow
machine fails no build, and a figure that falls short is printed like any other.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import approvals
import durable
import gate
import log
import machine
import memory
import signatures
import soak
import stop
import table
from figures import figures
from gate_figures import DAY, gate_figures
from log_figures import log_figures
from measure import Effort, Timing
from overload import Load, overload

FULL = {
    "decisions": Effort(blocks=11, calls=1_500, stretch=100, warm_up=300),
    "tokens": Effort(blocks=11, calls=400, stretch=20, warm_up=50),
    "parts": Effort(blocks=11, calls=1_000, stretch=100, warm_up=200),
    "turns": Effort(blocks=11, calls=400, warm_up=500),
    "plans": Effort(blocks=7, calls=300, warm_up=10),
    "socket": Effort(blocks=11, calls=300, stretch=20, warm_up=100),
}
QUICK = {
    "decisions": Effort(blocks=5, calls=500, stretch=100, warm_up=100),
    "tokens": Effort(blocks=5, calls=160, stretch=20, warm_up=20),
    "parts": Effort(blocks=5, calls=400, stretch=100, warm_up=100),
    "turns": Effort(blocks=5, calls=150, warm_up=400),
    "plans": Effort(blocks=5, calls=100, warm_up=5),
    "socket": Effort(blocks=5, calls=60, stretch=20, warm_up=40),
}
REVOCATIONS = {"full": 100, "quick": 20}
LOADS = {
    "full": Load(rounds=7, seconds=8.0, capacity_s=3.0),
    "quick": Load(rounds=1, seconds=3.0, capacity_s=1.0),
}
STOPS = {"full": (5, 400), "quick": (5, 60)}
SOAKS = {"full": DAY, "quick": 3_000}


def measure(effort: str, folder: Path, records: int | None = None) -> dict[str, Any]:
    """Return the results of one run.

    Args:
        effort: `full` or `quick`.
        folder: an empty folder on the disk that is measured.
        records: how long the log gets that grows; None: `log.RECORDS`.
    """
    efforts = FULL if effort == "full" else QUICK
    timings: dict[str, Timing] = {}
    _say("decisions beside cedarpy and Biscuit")
    timings |= memory.decisions(efforts["decisions"])
    _say("normalizing beside json.loads")
    timings |= memory.normalizing(efforts["decisions"])
    _say("tokens beside bare signatures")
    timings |= memory.tokens(efforts["tokens"])
    _say("approvals of several people and of a group")
    timings |= approvals.approvals(folder, efforts["tokens"])
    _say("the parts of a decision")
    timings |= memory.parts(efforts["parts"])
    _say("durable decisions beside a bare insert")
    timings |= durable.turns(folder, efforts["turns"])
    _say("plans of 1, 10 and 100")
    timings |= durable.plans(folder, efforts["plans"])
    _say("revocations")
    revoked = durable.revocations(folder, REVOCATIONS[effort])
    _say("the gate's process, over its socket")
    timings |= gate.latency(folder, efforts["socket"])
    _say("the gate's process under a flood")
    loaded = overload(folder, LOADS[effort])
    _say("stops")
    timings |= loaded.timings | stop.stops(*STOPS[effort])
    _say("a day's work, or a slice of it")
    soaked = soak.soak(folder, SOAKS[effort])
    _say("a log that grows")
    logged = log.log(folder / "log", effort, records)
    timings |= logged.timings
    _say("sizes")
    every = [
        *figures(timings, revoked),
        *gate_figures(timings, loaded, soaked),
        *log_figures(timings, logged.told),
    ]
    return {
        "schema": "authguard-r/benchmarks/1",
        "effort": effort,
        **machine.describe(folder),
        "conditions": memory.counted(),
        "figures": [figure.plain() for figure in every],
        "timings": {name: timing.plain() for name, timing in timings.items()},
        "revocations": revoked,
        "overload": {**loaded.told, "p99_ms": loaded.p99_ms},
        "soak": soaked,
        "log": logged.told,
        "sizes": durable.sizes(folder),
        "tokens": signatures.token_sizes(folder),
        "missions": signatures.mission_sizes(folder),
    }


def main(arguments: list[str] | None = None) -> int:
    """Measure, print the table, write what was asked for."""
    options = _options().parse_args(arguments)
    with tempfile.TemporaryDirectory(prefix=".benchmarks-", dir=options.disk) as folder:
        results = measure("quick" if options.quick else "full", Path(folder), options.records)
    text = table.markdown(results)
    print(text)
    if options.json is not None:
        options.json.write_text(json.dumps(results, indent=1) + "\n", "utf-8")
    if options.markdown is not None:
        table.write(options.markdown, text)
    return 0


def _options() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description="Measure the gate beside its yardsticks.")
    parser.add_argument("--quick", action="store_true", help="three minutes, with more noise")
    parser.add_argument("--records", type=int, help="of the log that grows; default: 200,000")
    parser.add_argument("--json", type=Path, help="write the results here")
    parser.add_argument("--markdown", type=Path, help="write the tables here")
    parser.add_argument(
        "--disk",
        type=Path,
        default=Path(__file__).resolve().parent,
        help="a folder on the disk to measure; default: this one's",
    )
    return parser


def _say(what: str) -> None:
    print(f"measuring: {what}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
