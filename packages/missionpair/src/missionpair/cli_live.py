# SPDX-License-Identifier: Apache-2.0
"""`missionpair live`: the paper's live tables with one command, on the models that one has."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from missionpair import attackers, planners, registry
from missionpair.campaign.plan import CampaignPlan
from missionpair.cli_progress import shown
from missionpair.cli_report import report_command
from missionpair.cli_run import JobsOption, summary_of
from missionpair.words import CONTROLS, Access, TrialKind

#: Tries that an attacker has in the paper, fixed or adaptive.
ROUNDS = 3
_Defenses = Annotated[
    list[str] | None,
    typer.Option("--defense", help="none, both ...; repeatable (default: both)."),
]


def live_command(
    out: Annotated[Path, typer.Argument(help="A folder for logs, page, CSV and LaTeX.")],
    planner: Annotated[
        list[str] | None,
        typer.Option("--planner", help="A model, as in `run`; repeatable."),
    ] = None,
    rounds: Annotated[int, typer.Option("--rounds", min=1, help="Rounds of an attack.")] = ROUNDS,
    every: Annotated[
        int, typer.Option("--every", min=1, help="Use only every N-th of the 60 pairs.")
    ] = 1,
    pairs: Annotated[
        int | None, typer.Option("--pairs", min=1, help="Number of pairs (default: all).")
    ] = None,
    benign: Annotated[
        bool, typer.Option("--benign", help="Also run benign trials and updates.")
    ] = False,
    defense: _Defenses = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the random numbers.")] = 0,
    jobs: JobsOption = 1,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> int:
    """Run fixed and adaptive attacks on each model, and write the paper's tables.

    Each model is its own adaptive attacker, and a fixed text is strengthened round by round, as in
    the paper. Without `--planner`: the paper's two, Claude Haiku 4.5 (needs ANTHROPIC_API_KEY) and
    Qwen2.5 7B over Ollama. A second start continues the first.
    """
    from missionpair.campaign.run import run  # help does not need the gate

    specs = tuple(dict.fromkeys(planner or ("haiku", "qwen")))
    _require(specs)
    out.mkdir(parents=True, exist_ok=True)
    kinds = tuple(TrialKind) if benign else (TrialKind.ATTACK, *CONTROLS)
    logs: list[Path] = []
    for number, spec in enumerate(specs, 1):
        name = f"{number}-{spec.partition(':')[0]}"
        for attacker in ("fixed", _adaptive(spec)):
            plan = CampaignPlan(
                suite="live",
                planner=spec,
                attacker=attacker,
                access=Access.BLACK,
                defenses=tuple(dict.fromkeys(defense or ("both",))),
                rounds=rounds,
                every=every,
                pairs=pairs,
                kinds=kinds,
                seed=seed,
            )
            log = out / f"{name}-{attacker.partition(':')[0]}.jsonl"
            with shown(hidden=as_json) as show:
                run(plan, log, jobs=jobs, show=show)
            logs.append(log)
    if as_json:
        from missionpair.campaign.log import read_log

        found = [summary_of(read_log(log)[0], log) for log in logs]
        sys.stdout.write(json.dumps({"campaigns": found}) + "\n")
    return _report(logs, out, quiet=as_json)


def _require(specs: tuple[str, ...]) -> None:
    """Make everything once: what cannot be had is said before anything is asked or written.

    Raises:
        UnknownNameError: no such planner or option, or two planners that a log cannot tell apart.
        PlannerError: a key or a package is missing.
    """
    seen: list[tuple[str, object]] = []
    for spec in specs:
        made = registry.make(planners, spec)
        registry.make(attackers, _adaptive(spec))
        if (made.name, made.parameters) in seen:
            text = "its trials would count twice: take it once, or each in a folder of its own"
            raise registry.UnknownNameError(f"two planners are `{made.name}` to the log: {text}")
        seen.append((made.name, made.parameters))


def _adaptive(spec: str) -> str:
    """Return the attacker in which a planner's model writes."""
    return f"adaptive:model={spec.replace(',', ';')}"


def _report(logs: list[Path], out: Path, *, quiet: bool) -> int:
    """Write every form of the report; print its tables unless JSON alone is asked for."""
    from contextlib import redirect_stdout
    from io import StringIO

    with redirect_stdout(StringIO() if quiet else sys.stdout):
        return report_command(logs, html=out / "report.html", csv=out / "csv", latex=out / "latex")
