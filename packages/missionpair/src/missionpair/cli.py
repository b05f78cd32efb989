# SPDX-License-Identifier: Apache-2.0
"""`missionpair`: attack the gate, and measure."""

from __future__ import annotations

import json
import sys
import tempfile
from itertools import islice
from pathlib import Path
from typing import Annotated, Any, NoReturn

import msgspec
import typer
from typer.exceptions import TyperException

from authguard_r.client import GateClient
from authguard_r.keys.signer import folder_signer
from authguard_r.operations.usage import message_of, place_of
from authguard_r.wire.messages import ClientRole
from missionpair.ablation import CHECKS, without
from missionpair.approvers import Policy, Script, read_delay
from missionpair.bench import Bench, make_bench
from missionpair.cli_list import list_command
from missionpair.cli_live import live_command
from missionpair.cli_mutate import mutate_command
from missionpair.cli_perceive import perceive_command
from missionpair.cli_recorded import imports, recorded_command
from missionpair.cli_report import compare, report
from missionpair.cli_require import require
from missionpair.cli_run import run_command
from missionpair.faults import FAULTS, USAGE, CommandFault, fault_of
from missionpair.selfchecks import SELF_CHECKS
from missionpair.suite import ATTACKS, BENIGN
from missionpair.systems import System, run_trial
from missionpair.tables import MeasuredTrial, as_text, category_table, results_table

app = typer.Typer(
    name="missionpair",
    help="Attacks that are safe and unauthorized, and how many of them get through.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


@app.callback()
def _group() -> None:
    """Keep `validate` a command of its own."""


@app.command("validate")
def validate(
    remove: Annotated[
        list[str] | None,
        typer.Option("--without", help="Remove a check from the gate first; may be repeated."),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object, nothing else.")
    ] = False,
) -> int:
    """Run the hand-constructed suite under three systems and print the paper's two tables."""
    unknown = sorted(set(remove or ()) - set(CHECKS))
    if unknown:
        raise typer.BadParameter(f"no check is called `{unknown[0]}`", param_hint="--without")
    with tempfile.TemporaryDirectory(prefix="missionpair-") as folder:
        bench = make_bench(Path(folder) / "trust")
        checks = [] if remove else _self_checks(bench, show=not as_json and sys.stderr.isatty())
        with without(*(remove or ())):
            measured = run_suite(bench)
    payload = _payload(checks, measured)
    if as_json:
        sys.stdout.write(json.dumps(payload) + "\n")
    else:
        sys.stdout.write("\n".join(_lines(payload)) + "\n")
    return 0 if payload["as_the_paper"] else 1


@app.command("approvers")
def approvers(
    socket: Annotated[Path, typer.Option("--gate", help="The gate's socket.")],
    trust: Annotated[Path, typer.Option("--trust", help="The demo folder with their keys.")],
    people: Annotated[list[str], typer.Option("--as", help="Who answers; may be repeated.")],
    delay: Annotated[
        str, typer.Option("--delay", help="fixed:2s, exponential:3s or lognormal:5s,0.8.")
    ] = "fixed:0s",
    seed: Annotated[int, typer.Option("--seed", help="Of the delays.")] = 0,
    most_risk: Annotated[int, typer.Option("--most-risk", help="Deny what is riskier.")] = 1 << 30,
    count: Annotated[
        int | None, typer.Option("--count", help="Leave after so many answers.", min=1)
    ] = None,
    as_json: Annotated[  # noqa: ARG001 - there is no other form, and every command takes it
        bool, typer.Option("--json", help="Its only form: one JSON object for each answer.")
    ] = False,
) -> int:
    """Answer a gate's approval requests by a script; one JSON object for each answer.

    Waiting and machine time are separate: `waited_ms` was drawn, `machine_us` was work.
    """
    try:
        drawn = read_delay(delay)
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint="--delay") from error
    signers = {name: folder_signer(trust, name) for name in people}
    with GateClient.connect(socket, role=ClientRole.OPERATOR, client="script") as client:
        policy = Policy(most_risk=most_risk)
        script = Script(client, signers, delay=drawn, seed=seed, policy=policy)
        for answer in islice(script.answers(), count):
            sys.stdout.write(msgspec.json.encode(answer).decode() + "\n")
            sys.stdout.flush()
    return 0


app.command("run")(run_command)
app.command("live")(live_command)
app.command("list")(list_command)
app.command("report")(report)
app.command("compare")(compare)
app.command("require")(require)
app.command("mutate")(mutate_command)
app.command("perceive")(perceive_command)
app.command("recorded")(recorded_command)
app.add_typer(imports)


def run_suite(bench: Bench) -> list[MeasuredTrial]:
    """Run every trial anew under each system."""
    return [
        MeasuredTrial(trial.name, trial.category, system, run_trial(trial.prepare(bench), system))
        for system in System
        for trial in (*ATTACKS, *BENIGN)
    ]


def _self_checks(bench: Bench, *, show: bool) -> list[dict[str, Any]]:
    """Run the sixteen checks, saying how far we are."""
    done: list[dict[str, Any]] = []
    for number, check in enumerate(SELF_CHECKS, 1):
        holds = check.holds(bench)
        done.append({"group": check.group, "name": check.name, "holds": holds})
        if show:
            sys.stderr.write(f"\rself-check {number}/{len(SELF_CHECKS)}")
            sys.stderr.flush()
    if show:
        sys.stderr.write("\n")
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


def main() -> None:
    """Run one command and exit with its code; every error is printed, not thrown."""
    try:
        result = app(prog_name="missionpair", standalone_mode=False)
    except typer.Exit as stop:
        sys.exit(stop.exit_code)
    except typer.Abort:
        _fail(CommandFault("ABORTED", "stopped by the user", "", USAGE))
    except TyperException as error:
        if not sys.argv[1:]:  # what it says is the help, line by line
            sys.stderr.write(f"USAGE: {error.format_message()}\n")
            sys.exit(USAGE)
        _fail(CommandFault("USAGE", message_of(error), place_of(error), USAGE))
    except FAULTS as error:
        _fail(fault_of(error))
    except KeyboardInterrupt:
        text = "stopped; each trial of a campaign that was finished is in its log"
        _fail(CommandFault("ABORTED", text, "", 130))
    sys.exit(result if isinstance(result, int) else 0)


def _fail(fault: CommandFault) -> NoReturn:
    """Say what is wrong where it belongs, and exit with its code."""
    if "--json" in sys.argv:
        sys.stdout.write(fault.as_json() + "\n")
    else:
        sys.stderr.write(fault.as_text() + "\n")
    sys.exit(fault.exit_code)
