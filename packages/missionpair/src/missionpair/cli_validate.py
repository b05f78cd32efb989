# SPDX-License-Identifier: Apache-2.0
"""`missionpair validate`: the paper's hand-constructed suite under three systems."""

from __future__ import annotations

import itertools
import json
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from missionpair.ablation import CHECKS, without
from missionpair.bench import Bench, make_bench
from missionpair.campaign.plan import Progress
from missionpair.cli_progress import shown
from missionpair.selfchecks import SELF_CHECKS
from missionpair.suite import ATTACKS, BENIGN
from missionpair.systems import System, run_trial
from missionpair.tables import MeasuredTrial, as_text, category_table, results_table


def validate_command(
    remove: Annotated[
        list[str] | None,
        typer.Option("--without", help="Remove this check of the gate; repeatable."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> int:
    """Run the hand-constructed suite under three systems and print the paper's two tables."""
    unknown = sorted(set(remove or ()) - set(CHECKS))
    if unknown:
        raise typer.BadParameter(f"no check is called `{unknown[0]}`", param_hint="--without")
    with tempfile.TemporaryDirectory(prefix="missionpair-") as folder:
        bench = make_bench(Path(folder) / "trust")
        total = 0 if remove else len(SELF_CHECKS)
        counted = itertools.count(1)
        with shown(hidden=as_json, what="checks and trials") as show:

            def one() -> None:
                show(Progress(next(counted), total + len(System) * len((*ATTACKS, *BENIGN))))

            checks = [] if remove else _self_checks(bench, one)
            with without(*(remove or ())):
                measured = run_suite(bench, one)
    payload = _payload(checks, measured)
    if as_json:
        sys.stdout.write(json.dumps(payload) + "\n")
    else:
        sys.stdout.write("\n".join(_lines(payload)) + "\n")
    return 0 if payload["as_the_paper"] else 1


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


def _lines(payload: dict[str, Any]) -> list[str]:
    lines = []
    if payload["self_checks"]:
        passed, total = payload["self_checks_passed"], len(payload["self_checks"])
        lines = [f"self-checks: {passed}/{total}"]
        lines += [
            f"  FAILED {check['group']}: {check['name']}"
            for check in payload["self_checks"]
            if not check["holds"]
        ]
    lines += ["", *as_text(payload["results"]), "", *as_text(payload["categories"])]
    return lines
