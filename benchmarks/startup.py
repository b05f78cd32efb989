# SPDX-License-Identifier: Apache-2.0
"""How much processor time the help of every command takes, and what the parser alone takes.

    python benchmarks/startup.py [--rounds N] [--json FILE] [--require SECONDS]

Each command is a process. In each round every command runs once, in turns with a process that only
imports `typer`; the median of a command over the rounds counts. Exit 1: one is above SECONDS.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
from pathlib import Path

import machine
from authguard_r.cli.app import COMMANDS, GROUPS
from missionpair.cli import COMMANDS as MISSIONPAIR

PROGRAMS = Path(sys.executable).parent
LINES = {
    **{f"authguard {words}".strip(): [PROGRAMS / "authguard", *words.split(), "-h"]
       for words in ("", *GROUPS, *COMMANDS)},
    **{f"missionpair {words}".strip(): [PROGRAMS / "missionpair", *words.split(), "-h"]
       for words in ("", *MISSIONPAIR)},
}  # fmt: skip
PARSER = [sys.executable, "-c", "import typer"]


def processor_time(line: list[object]) -> float:
    """Run a process; return its processor time in seconds, its own and the system's."""
    before = os.times()
    subprocess.run([str(word) for word in line], stdout=subprocess.DEVNULL, check=True)
    after = os.times()
    own = after.children_user - before.children_user
    return own + after.children_system - before.children_system


def main() -> int:
    """Measure, print the slowest commands, and return the exit code."""
    asks = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    asks.add_argument("--rounds", type=int, default=3, help="turns (default: 3)")
    asks.add_argument("--json", type=Path, help="write the results here")
    asks.add_argument("--require", type=float, metavar="SECONDS", help="exit 1 above this")
    asked = asks.parse_args()
    found: dict[str, list[float]] = {name: [] for name in LINES}
    parser: list[float] = []
    for line in LINES.values():  # the first start writes bytecode
        processor_time(line)
    for _ in range(asked.rounds):
        for name, line in LINES.items():
            found[name].append(processor_time(line))
            parser.append(processor_time(PARSER))
    medians = {name: statistics.median(times) for name, times in found.items()}
    alone = statistics.median(parser)
    slowest = sorted(medians, key=lambda name: -medians[name])
    print(f"{len(medians)} commands; python and its parser alone take {alone:.2f} s")
    for name in slowest[:10]:
        print(f"  {medians[name]:.2f} s  {medians[name] / alone:.1f} x  {name}")
    if asked.json is not None:
        told = {"machine": machine.describe(Path.cwd()), "parser_s": alone, "help_s": medians}
        asked.json.write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")
    return int(asked.require is not None and medians[slowest[0]] > asked.require)


if __name__ == "__main__":
    sys.exit(main())
