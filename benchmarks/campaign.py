# SPDX-License-Identifier: Apache-2.0
"""`python benchmarks/campaign.py`: trials a second of a whole campaign, and its memory.

A trial is all of it: the attacker's text, a deterministic planner, the normalizer, the checkers,
both gates with registry and log, the simulated world, the judge, and the campaign's own line on
disk. Everything runs on one core in a process of its own. Situations are prepared while the clock
runs. The yardstick of the same run is the same campaign without any gate.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from multiprocessing import get_context
from pathlib import Path
from time import perf_counter
from typing import Any

import machine
from missionpair.campaign.log import read_log
from missionpair.campaign.run import Plan, run
from missionpair.carrying import through_the_gate
from missionpair.pair import plan_bytes
from missionpair.records import Timing
from missionpair.stage import Yard
from missionpair.words import Access, Kind

_PAGE = os.sysconf("SC_PAGESIZE")
#: Pairs that a measured campaign has; each is tried as often as the trials allow.
PAIRS = 6
#: Trials after which memory is looked at first: everything is loaded then.
WARM = 10_000
TARGET_RATE, TARGET_MIB = 3_000.0, 50.0


def rate(planner: str, defense: str, trials: int, folder: Path) -> dict[str, float]:
    """Return trials a second of one campaign, and how much memory it grew by after `WARM`."""
    plan = Plan(
        suite="live",
        planner=planner,
        defenses=(defense,),
        access=Access.WHITE,
        kinds=(Kind.ATTACK,),
        pairs=PAIRS,
        seeds=max(1, trials // PAIRS),
    )
    marks: dict[str, float] = {}

    def seen(at: Any) -> None:
        if at.done >= WARM and "rss" not in marks:
            marks["rss"] = _rss()

    begun = perf_counter()
    campaign = run(plan, folder / f"{planner.partition(':')[0]}-{defense}", show=seen)
    took = perf_counter() - begun
    return {
        "trials": campaign.trials,
        "trials_per_s": campaign.trials / took,
        "rss_growth_mib": (_rss() - marks.get("rss", _rss())) / 2**20,
    }


def on_disk(trials: int, folder: Path) -> dict[str, float]:
    """Return refused trials a second whose registry and log lie in SQLite, each one durable."""
    from missionpair import registry, suites
    from missionpair.judging import check

    (folder / "store").mkdir(mode=0o700)
    suite = registry.make(suites, "live")
    pair = suite.pairs[0]
    with Yard() as yard:
        layout = suite.layouts[pair.layout]
        stage = yard.stage(pair, layout, pair.attack, store=folder / "store" / "robot.db")
        stage.show(pair.inputs)
        raw = plan_bytes(pair.attack.plan)
        begun = perf_counter()
        for _ in range(trials):
            check(stage, raw)
            if through_the_gate(stage, raw).effects:
                raise RuntimeError("an unauthorized action was executed")
        stage.sim.gate.ledger.flush(everything=True)
        took = perf_counter() - begun
        stage.sim.gate.close()
    return {"trials": trials, "trials_per_s": trials / took}


def latency(log: Path) -> dict[str, float]:
    """Return the median of each part of a trial, microseconds."""
    parts: dict[str, list[int]] = {name: [] for name in Timing.__struct_fields__}
    for trial in read_log(log)[1]:
        for name, values in parts.items():
            values.append(getattr(trial.timing, name))
    return {name: sorted(values)[len(values) // 2] for name, values in parts.items() if values}


def measure(trials: int, folder: Path) -> dict[str, Any]:
    """Return every figure; each campaign in a process of its own, one after the other."""
    found: dict[str, Any] = {}
    for planner, defense, share in (
        ("hijacked", "none", 10),
        ("hijacked", "both", 1),
        ("adversary:always=yes", "both", 100),
    ):
        name = f"{planner.partition(':')[0]}.{defense}"
        print(f"measuring: {name}", file=sys.stderr, flush=True)
        found[name] = _apart(rate, planner, defense, max(60, trials // share), folder)
    found["hijacked.both"]["median_us"] = latency(folder / "hijacked-both")
    print("measuring: on disk", file=sys.stderr, flush=True)
    found["hijacked.both.sqlite"] = _apart(on_disk, max(60, trials // 10), folder)
    return found


def _apart(job: Any, *arguments: Any) -> Any:
    with get_context("spawn").Pool(1) as pool:
        return pool.apply(job, arguments)


def _rss() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * _PAGE


def main() -> int:
    """Measure, print, and write what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--trials", type=int, default=100_000, help="of the main campaign")
    parser.add_argument("--json", type=Path, help="write the results here")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="campaign-") as folder:
        found = measure(given.trials, Path(folder))
    main_rate, grown = found["hijacked.both"], found["hijacked.both"]["rss_growth_mib"]
    for name, figures in found.items():
        print(f"{name}: {figures['trials_per_s']:,.0f} trials/s over {figures['trials']:,}")
    met = "met" if main_rate["trials_per_s"] >= TARGET_RATE else "MISSED"
    print(f"both gates, in memory: target {TARGET_RATE:,.0f} trials/s: {met}")
    met = "met" if grown <= TARGET_MIB else "MISSED"
    print(f"memory: grew by {grown:.1f} MiB after {WARM:,} trials: target {TARGET_MIB:.0f}: {met}")
    if given.json:
        result = {"machine": machine.describe(Path.cwd()), "results": found}
        given.json.write_text(json.dumps(result, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
