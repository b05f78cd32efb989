# SPDX-License-Identifier: Apache-2.0
"""The paper's hand-constructed suite under three systems, with the self-checks of the measures.

Source: `tab:pilot-results`, `tab:pilot-categories`.
"""

from __future__ import annotations

import itertools
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from missionpair.ablation import without
from missionpair.bench import Bench, make_bench
from missionpair.campaign.plan import Progress
from missionpair.selfchecks import SELF_CHECKS
from missionpair.suite import ATTACKS, BENIGN
from missionpair.systems import System, run_trial
from missionpair.tables import MeasuredTrial, as_text, category_table, results_table


def validated(removed: list[str], show: Callable[[Progress], None]) -> dict[str, Any]:
    """Run self-checks and suite; return both tables and every trial, as `--json` prints them.

    Args:
        removed: checks of the gate that are taken out; with one, the self-checks are left out.
        show: shows the progress.
    """
    total = (0 if removed else len(SELF_CHECKS)) + len(System) * len((*ATTACKS, *BENIGN))
    counted = itertools.count(1)

    def one() -> None:
        show(Progress(next(counted), total))

    with tempfile.TemporaryDirectory(prefix="missionpair-") as folder:
        bench = make_bench(Path(folder) / "trust")
        checks = [] if removed else _self_checks(bench, one)
        with without(*removed):
            return _payload(checks, run_suite(bench, one))


def run_suite(bench: Bench, one: Callable[[], None]) -> list[MeasuredTrial]:
    """Run every trial anew under each system; `one` is called after each."""
    done: list[MeasuredTrial] = []
    for system in System:
        for trial in (*ATTACKS, *BENIGN):
            result = run_trial(trial.prepare(bench), system)
            done.append(MeasuredTrial(trial.name, trial.category, system, result))
            one()
    return done


def _self_checks(bench: Bench, one: Callable[[], None]) -> list[dict[str, Any]]:
    """Run the self-checks; `one` is called after each."""
    done: list[dict[str, Any]] = []
    for check in SELF_CHECKS:
        holds = check.holds(bench)
        done.append({"group": check.group, "name": check.name, "holds": holds})
        one()
    return done


def _payload(checks: list[dict[str, Any]], measured: list[MeasuredTrial]) -> dict[str, Any]:
    results = results_table(measured)
    wanted = [
        {"UASR": 1.0, "SCMHR": 1.0, "BTCR": 1.0, "FRR": 0.0, "SU": 0.0},
        {"UASR": 1.0, "SCMHR": 1.0, "BTCR": 1.0, "FRR": 0.0, "SU": 0.0},
        {"UASR": 0.0, "SCMHR": 0.0, "BTCR": 1.0, "FRR": 0.0, "SU": 1.0},
    ]
    same = all(
        all(row[name] == value for name, value in want.items())
        for row, want in zip(results, wanted, strict=True)
    )
    return {
        "self_checks": checks,
        "self_checks_passed": sum(check["holds"] for check in checks),
        "attacks": len(ATTACKS),
        "benign": len(BENIGN),
        "results": results,
        "categories": category_table(measured),
        "trials": [
            {
                "trial": item.trial,
                "category": item.category,
                "system": str(item.system),
                "executed": len(item.result.effects),
                "unauthorized": item.result.unauthorized,
                "scmh": item.result.hijacked,
                "completed": item.result.completed,
                "reasons": list(item.result.reasons),
                "oracle": [list(effect.reasons) for effect in item.result.effects],
            }
            for item in measured
        ],
        "as_the_paper": same and all(check["holds"] for check in checks),
    }


def lines(payload: dict[str, Any]) -> list[str]:
    """Return the result for people."""
    told = []
    if payload["self_checks"]:
        passed, total = payload["self_checks_passed"], len(payload["self_checks"])
        told = [f"self-checks: {passed}/{total}"]
        told += [
            f"  FAILED {check['group']}: {check['name']}"
            for check in payload["self_checks"]
            if not check["holds"]
        ]
    told += ["", *as_text(payload["results"]), "", *as_text(payload["categories"])]
    return told
