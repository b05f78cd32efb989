# SPDX-License-Identifier: Apache-2.0
"""What the log costs: growth, verification, checkpoints, bytes, a witness, a replay.

    python benchmarks/log.py --records 10000000

is the log alone, with as many records as somebody asks for: what a night is for. The whole run
(`run.py`) does the same with fewer.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import log_cost
import machine
import table
from figures import Figure
from log_cost import Efforts
from log_figures import log_figures
from log_growth import SHORT, Grown, Plan, grown
from measure import Effort, Timing

#: Records of the long log, unless somebody says.
RECORDS = 200_000
#: Figures that no clock enters: missing one fails the run.
UNTIMED = frozenset({"log_memory", "log_whole"})
PLANS = {
    "full": Plan(
        records=RECORDS,
        append=Effort(blocks=11, calls=400, warm_up=200),
        verify=Effort(blocks=11, calls=1, warm_up=1),
        sizes=(5_000, 50_000),
        together=Effort(blocks=7, calls=1, warm_up=1),
        most=200_000,
    ),
    "quick": Plan(
        records=RECORDS,
        append=Effort(blocks=5, calls=100, warm_up=50),
        verify=Effort(blocks=5, calls=2, warm_up=1),
        sizes=(1_000, 10_000),
        together=Effort(blocks=5, calls=1, warm_up=1),
        most=100_000,
    ),
}
EFFORTS = {
    "full": Efforts(
        checkpoint=Effort(blocks=11, calls=20, warm_up=5),
        witness=Effort(blocks=11, calls=50, warm_up=10),
        replay=Effort(blocks=7, calls=1, warm_up=1),
        decisions=400,
        sealed=Effort(blocks=11, calls=200, warm_up=50),
    ),
    "quick": Efforts(
        checkpoint=Effort(blocks=5, calls=5, warm_up=2),
        witness=Effort(blocks=5, calls=10, warm_up=5),
        replay=Effort(blocks=5, calls=1, warm_up=1),
        decisions=60,
        sealed=Effort(blocks=5, calls=50, warm_up=20),
    ),
}


class Logged(NamedTuple):
    """What was measured of the log.

    Args:
        timings: of everything that is timed.
        told: everything else, in plain data.
    """

    timings: dict[str, Timing]
    told: dict[str, Any]


def log(folder: Path, effort: str, records: int | None = None) -> Logged:
    """Return what was measured.

    Args:
        folder: an empty folder on the disk that is measured.
        effort: `full` or `quick`.
        records: how long the long log gets; None: as long as in the whole run.

    Raises:
        ValueError: fewer records than the short log has.
    """
    plan = PLANS[effort] if records is None else PLANS[effort]._replace(records=records)
    if plan.records < SHORT:
        raise ValueError(f"expected at least {SHORT} records, got {plan.records}")
    folder.mkdir()
    how = EFFORTS[effort]
    found: Grown = grown(folder, plan)
    timings = dict(found.timings)
    timings |= log_cost.checkpoints(folder, how.checkpoint)
    timings |= log_cost.witness(folder, how.witness)
    timings |= log_cost.replay(folder, how.replay, how.decisions)
    closed, kept = log_cost.sealed(folder, how.sealed)
    timings |= closed
    stored = log_cost.storage(folder, folder / "grown.db", found.told["verified"])
    told = {**found.told, "storage": [*kept, *stored]}
    return Logged(timings, told)


def short_of(figures: list[Figure]) -> list[str]:
    """Return the figures that no clock enters and that miss their target.

    These are facts of the code; how long something took says as much of the machine, and of what
    else ran on it.
    """
    return [figure.id for figure in figures if figure.id in UNTIMED and not figure.meets]


def main(arguments: list[str] | None = None) -> int:
    """Measure the log alone and print its figures; 1 when it grew too much or is not whole."""
    parser = argparse.ArgumentParser(description="Measure the log alone.")
    parser.add_argument("--records", type=int, default=RECORDS, help="of the long log")
    parser.add_argument("--quick", action="store_true", help="fewer samples, with more noise")
    parser.add_argument("--json", type=Path, help="write the results here")
    parser.add_argument(
        "--disk",
        type=Path,
        default=Path(__file__).resolve().parent,
        help="a folder on the disk to measure; default: this one's",
    )
    options = parser.parse_args(arguments)
    effort = "quick" if options.quick else "full"
    with tempfile.TemporaryDirectory(prefix=".benchmarks-", dir=options.disk) as name:
        found = log(Path(name) / "log", effort, options.records)
        described = machine.describe(Path(name))
    made = log_figures(found.timings, found.told)
    results = {
        "schema": "authguard-r/benchmarks-log/1",
        "effort": effort,
        **described,
        "figures": [figure.plain() for figure in made],
        "timings": {name: timing.plain() for name, timing in found.timings.items()},
        "log": found.told,
    }
    print(table.log_alone(results))
    if options.json is not None:
        options.json.write_text(json.dumps(results, indent=1) + "\n", "utf-8")
    missed = short_of(made)
    if missed:
        print(f"missed: {', '.join(missed)}", file=sys.stderr)
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
