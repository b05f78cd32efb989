# SPDX-License-Identifier: Apache-2.0
"""`python benchmarks/campaign.py`: trials a second of a whole campaign, and its memory.

A trial is all of it: the attacker's text, a deterministic planner, the normalizer, the checkers,
both gates with registry and log, the simulated world, the judge, and the campaign's own line on
disk. Everything runs on one core in a process of its own. Situations are prepared while the clock
runs. Attacks are the main figure, of one pair of each category of `live`; benign runs and signed
updates of the same pairs stand beside it, for what is carried out takes a world to do it in. The
yardstick of the same run is the same campaign without any gate.
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
from missionpair.campaign.run import CampaignPlan, run
from missionpair.execution import through_the_gate
from missionpair.pair import plan_bytes
from missionpair.records import Timing
from missionpair.stage import Yard
from missionpair.words import Access, TrialKind

_PAGE = os.sysconf("SC_PAGESIZE")
#: Of the suite, every so many-th pair is tried, as often as the trials allow: one of each category.
EVERY, PAIRS = 10, 6
#: Trials after which everything is loaded, as long as they are not more than a tenth of all.
WARM = 10_000
TARGET_RATE, TARGET_MIB = 3_000.0, 50.0
ATTACK, WORK = (TrialKind.ATTACK,), (TrialKind.BENIGN, TrialKind.UPDATE)
#: Name, planner, defense, kinds of trial, and the share of the trials that it gets.
CAMPAIGNS = (
    ("hijacked.none", "hijacked", "none", ATTACK, 10),
    ("hijacked.both", "hijacked", "both", ATTACK, 1),
    ("hijacked.both.work", "hijacked", "both", WORK, 500),
    ("adversary.both", "adversary:always=yes", "both", ATTACK, 100),
)
Figures = dict[str, Any]


def rate(
    planner: str, defense: str, kinds: tuple[TrialKind, ...], trials: int, log: Path
) -> Figures:
    """Return trials a second of one campaign, and its memory from the first trial to the last.

    `rss_growth_mib` is the peak of what it has over what it had when everything was loaded.
    """
    plan = CampaignPlan(
        suite="live",
        planner=planner,
        defenses=(defense,),
        access=Access.WHITE,
        kinds=kinds,
        every=EVERY,
        pairs=PAIRS,
        seeds=max(1, trials // PAIRS // len(kinds)),
    )
    marks: list[tuple[int, int]] = []
    begun = perf_counter()
    campaign = run(plan, log, show=lambda at: marks.append((at.done, _rss())))
    took = perf_counter() - begun
    warm = min(WARM, campaign.trials // 10)
    loaded = next(rss for done, rss in marks if done >= warm)
    peak = max(rss for _, rss in marks)
    return {
        "trials": campaign.trials,
        "trials_per_s": campaign.trials / took,
        "warm_after": warm,
        "rss_first_mib": marks[0][1] / 2**20,
        "rss_warm_mib": loaded / 2**20,
        "rss_peak_mib": peak / 2**20,
        "rss_growth_mib": (peak - loaded) / 2**20,
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
    for name, planner, defense, kinds, share in CAMPAIGNS:
        print(f"measuring: {name}", file=sys.stderr, flush=True)
        log = folder / f"{name}.jsonl"
        found[name] = _apart(rate, planner, defense, kinds, max(60, trials // share), log)
        found[name]["median_us"] = latency(log)
        log.unlink()
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
    text = f"{grown:.1f} MiB at most after the first {main_rate['warm_after']:,} trials"
    print(f"memory: grew by {text}: target {TARGET_MIB:.0f}: {met}")
    if given.json:
        result = {"machine": machine.describe(Path.cwd()), "results": found}
        given.json.write_text(json.dumps(result, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
