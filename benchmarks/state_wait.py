# SPDX-License-Identifier: Apache-2.0
"""`python benchmarks/state_wait.py`: what a decision waits for state from after the last motion.

One client watches a gate that is a process of its own, and takes the time from each outcome to the
next decision of the same plan. The plan looks round again and again, under a guard; beside it the
same plan without any guard rests on no state, and waits for none. The robot is in the gate's
process (the simulator), or it and its estimator are processes with the estimator's usual 20 Hz.
"""

from __future__ import annotations

import argparse
import json
import sys
import threading
from pathlib import Path
from time import perf_counter_ns
from typing import Any

import machine
from measure import percentile
from scene import ROOT, scenarios

sys.path.append(str(ROOT / "tests"))
from authguard_r.wire.messages import ClientRole
from fixtures.gate_process import RunningGate

MS = 1e6
GUARD = {"variable": "holding", "eq": "nothing", "max_age": "1 s"}
SETUPS: dict[str, dict[str, Any]] = {
    "simulator": {"simulate": True},
    "estimator process": {"robot": ("--speed-up", "20"), "estimator": True},
}
STEPS = 100


def waits(setup: dict[str, Any], plans: int, *, guards: list[dict[str, Any]]) -> list[int]:
    """Return each time from an outcome to the next decision, in nanoseconds."""
    draft = scenarios.draft()
    scan = next(grant for grant in draft["grants"] if grant["id"] == "look-out")
    scan = {**scan, "repeat": 10_000, "starts": 10_000, "guards": guards}
    budgets = {**draft["budgets"], "actions": 10_000, "rate": {"count": 10_000, "per": "10 s"}}
    with RunningGate(**setup) as gate:
        gate.activate(
            gate.token(gate.mission(grants=[scan], guards=[], budgets=budgets, closing=None))
        )
        found: list[int] = []
        watcher = gate.client(ClientRole.AUDITOR, "watches")
        events = watcher.watch(idle_ms=60_000)

        def watch() -> None:
            ended = 0
            for event in events:
                now = perf_counter_ns()
                if event["event"] == "outcome":
                    ended = now
                elif event["event"] == "decision" and ended:
                    found.append(now - ended)
                    ended = 0
                if event["event"] == "end":
                    return

        thread = threading.Thread(target=watch, daemon=True)
        thread.start()
        with gate.client(ClientRole.PLANNER) as planner:
            for _ in range(plans):
                told = planner.propose(b"\n".join([b"scan()"] * STEPS))["steps"]
                if not all(step["executed"] for step in told) or len(told) != STEPS:
                    raise RuntimeError(f"not the plan that is measured: {told[-1]}")
        gate.stop_process("gate")
        thread.join(30)
    return found


def main() -> int:
    """Measure, print, and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plans", type=int, default=10, help=f"plans of {STEPS} steps each")
    parser.add_argument("--json", type=Path, help="where the figures go")
    asked = parser.parse_args()
    figures: dict[str, Any] = {"machine": machine.describe(ROOT), "steps": asked.plans * STEPS}
    for name, setup in SETUPS.items():
        for kind, guards in (("no state", []), ("guarded", [GUARD])):
            found = waits(setup, asked.plans, guards=guards)
            told = {f"p{share}_ms": percentile(found, share) / MS for share in (50, 95, 99)}
            figures[f"{name}, {kind}"] = {**told, "count": len(found)}
            shown = ", ".join(f"{key[:-3]} {value:.1f} ms" for key, value in told.items())
            print(f"{name:18} {kind:9} {shown} ({len(found)} waits)")
    if asked.json:
        asked.json.write_text(json.dumps(figures, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
