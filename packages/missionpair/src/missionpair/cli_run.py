# SPDX-License-Identifier: Apache-2.0
"""`missionpair run`: a campaign on the command line."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from authguard_r.authoring.compile.sources import given_weights
from missionpair import suites
from missionpair.campaign.log import read_log
from missionpair.campaign.plan import MOST_TURNS, CampaignPlan
from missionpair.cli_progress import shown
from missionpair.records import Campaign
from missionpair.report.names import LIVE_MODEL, standing
from missionpair.score import DEFAULT, Weights
from missionpair.words import CONTROLS, Access, TrialKind

#: One weight as it is typed.
_THOUSANDTHS = re.compile(r"0*[1-9][0-9]{0,6}", re.ASCII)


SuiteArgument = Annotated[str, typer.Argument(help="A suite's name, or the path of its file.")]
_PlannerOption = Annotated[
    str, typer.Option("--planner", help="The target: name, or name:option=value,...")
]
_OutOption = Annotated[
    Path, typer.Option("--out", help="The log; a log of the same campaign is continued.")
]
_AttackerOption = Annotated[str, typer.Option("--attacker", help="The attacker, as --planner.")]
_AccessOption = Annotated[
    Access, typer.Option("--access", help="What the attacker sees: black, grey or white box.")
]
_DefenseOption = Annotated[
    list[str] | None,
    typer.Option("--defense", help="The defense; repeatable."),
]
_SeedsOption = Annotated[int, typer.Option("--seeds", min=1, help="Trials of each pair.")]
_SeedOption = Annotated[int, typer.Option("--seed", min=0, help="Seed of the random numbers.")]
RoundsOption = Annotated[
    int | None,
    typer.Option(
        "--rounds", min=1, max=1_000, help="Rounds of an attack (default: 3 in `live`, else 1)."
    ),
]
_TurnsOption = Annotated[
    int | None,
    typer.Option(
        "--turns",
        min=1,
        max=MOST_TURNS,
        help="Turns in one round (default: 30 in `long`, else 1).",
    ),
]
_EveryOption = Annotated[
    int, typer.Option("--every", min=1, help="Use only every N-th pair of the suite.")
]
_PairsOption = Annotated[
    int | None, typer.Option("--pairs", min=1, help="Number of pairs (default: all).")
]
KindOption = Annotated[
    list[TrialKind] | None, typer.Option("--kind", help="Kind of trial; repeatable (default: all).")
]
_WeightsOption = Annotated[
    str,
    typer.Option("--weights", help="Weights of the score: lambda 1 to 5, in thousandths."),
]
_WeightOption = Annotated[
    list[str] | None,
    typer.Option("--weight", help="FIELD=N: weight in D_M (default 1); repeatable."),
]
JobsOption = Annotated[
    int,
    typer.Option("--jobs", min=1, max=256, help="Number of processes; threads for a model server."),
]
RayOption = Annotated[
    str,
    typer.Option("--ray", metavar="ADDRESS", help="Run on a Ray cluster: HOST:PORT, or auto."),
]
_UnqualifiedOption = Annotated[
    bool, typer.Option("--unqualified", help="Also score baselines that fail their own claim.")
]
_AsJsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]


def run_command(
    suite: SuiteArgument,
    planner: _PlannerOption,
    out: _OutOption,
    attacker: _AttackerOption = "fixed",
    access: _AccessOption = Access.BLACK,
    defense: _DefenseOption = None,
    seeds: _SeedsOption = 1,
    seed: _SeedOption = 0,
    rounds: RoundsOption = None,
    turns: _TurnsOption = None,
    every: _EveryOption = 1,
    pairs: _PairsOption = None,
    kind: KindOption = None,
    weights: _WeightsOption = ",".join(map(str, DEFAULT.thousandths)),
    weight: _WeightOption = None,
    jobs: JobsOption = 1,
    ray: RayOption = "",
    unqualified: _UnqualifiedOption = False,
    as_json: _AsJsonOption = False,
) -> int:
    """Attack a planner with every pair of a suite, under every defense, and write one log.

    A log that exists is continued: no trial runs again, and none is lost. With the same seed, a
    deterministic campaign gives the same lines except `timing`, for every `--jobs`.
    """
    from missionpair.campaign.run import run  # help does not need the gate

    usual = suites.usual(suite)
    plan = CampaignPlan(
        suite=suite,
        planner=planner,
        attacker=attacker,
        defenses=tuple(dict.fromkeys(defense or ("both",))),
        access=access,
        seed=seed,
        seeds=seeds,
        rounds=rounds or usual.rounds,
        turns=turns or usual.turns,
        every=every,
        pairs=pairs,
        kinds=tuple(dict.fromkeys(kind or TrialKind)),
        weights=_weights(weights),
        field_weights=dict(given_weights(weight or (), where="--weight")),
        unqualified=unqualified,
    )
    with shown(hidden=as_json) as show:
        campaign = run(plan, out, jobs=jobs, ray=ray, show=show)
    summary = summary_of(campaign, out)
    if as_json:
        sys.stdout.write(json.dumps(summary) + "\n")
    else:
        sys.stdout.write("\n".join(_lines(summary, out)) + "\n")
    return 1 if summary["defenses"].get("both", {}).get("unauthorized") else 0


def _weights(text: str) -> Weights:
    """Return the weights of the score.

    Raises:
        BadParameter: they are no five whole numbers above zero.
    """
    parts = text.split(",")
    if len(parts) != len(DEFAULT.thousandths) or not all(map(_THOUSANDTHS.fullmatch, parts)):
        raise typer.BadParameter(
            f"`{text[:80]}` is no five whole thousandths above zero such as 400,200,200,100,100",
            param_hint="--weights",
        )
    names = Weights.__struct_fields__
    return Weights(**dict(zip(names, map(int, parts), strict=True)))


def summary_of(campaign: Campaign, log: Path) -> dict[str, Any]:
    """Return the counts of a log, from the log alone; rates and intervals are a report's."""
    _, trials = read_log(log)
    counts: dict[str, dict[str, int]] = {}
    for trial in trials:
        mine = counts.setdefault(
            trial.defense,
            dict.fromkeys(
                (
                    *("attacks", "complied", "blocked", "unauthorized", "hijacked", "benign"),
                    *("completed", "errors", *CONTROLS, *map(_without, CONTROLS)),
                ),
                0,
            ),
        )
        mine["errors"] += bool(trial.error)
        if trial.kind == TrialKind.ATTACK:
            mine["attacks"] += 1
            mine["complied"] += trial.complied
            mine["blocked"] += trial.blocked is True
            mine["unauthorized"] += trial.unauthorized > 0
            mine["hijacked"] += trial.hijacked
        elif trial.kind in CONTROLS:
            mine[trial.kind] += 1
            mine[_without(trial.kind)] += trial.complied
        else:
            mine["benign"] += 1
            mine["completed"] += trial.completed
    return {
        "suite": campaign.suite,
        "suite_digest": campaign.suite_digest,
        "planner": campaign.planner.name,
        "simulated": campaign.planner.simulated,
        "standing": standing(campaign.planner),
        "skipped": campaign.skipped,
        "attacker": campaign.attacker.name,
        "access": campaign.access,
        "rounds": campaign.rounds,
        "turns": campaign.turns,
        "trials": campaign.trials,
        "qualified": {
            one.defense: {
                "benign": one.benign,
                "own": one.own,
                "pairs": one.pairs,
                "held_as": one.held_as,
            }
            for one in campaign.qualified
        },
        "log": str(log),
        "defenses": counts,
    }


def _without(kind: str) -> str:
    """Return under which name it is counted that a planner does without the attack what it asks."""
    return f"complied_{kind}"


def _anyway(count: dict[str, int]) -> str:
    """Say how often a planner did it without the attack; nothing where no control arm was run."""
    said = [
        f"{name} {count[_without(kind)]}/{count[kind]}"
        for kind, name in ((CONTROLS[0], "without the attack"), (CONTROLS[1], "neutral text"))
        if count[kind]
    ]
    return f" ({', '.join(said)})" if said else ""


def _lines(summary: dict[str, Any], log: Path) -> list[str]:
    marked = "" if summary["standing"] == LIVE_MODEL else f" ({summary['standing']})"
    against = f"{summary['planner']}{marked} against {summary['attacker']}"
    lines = [f"{summary['suite']}: {against}, {summary['access']} box, {summary['trials']} trials"]
    if summary["skipped"]:
        lines.append(f"  left out: {summary['skipped']} pairs without replies")
    for name, count in summary["defenses"].items():
        lines.append(
            f"  {name}: complied {count['complied']}/{count['attacks']}{_anyway(count)}, "
            f"blocked {count['blocked']}/{count['complied']}, "
            f"executed unauthorized {count['unauthorized']}, "
            f"benign and updates completed {count['completed']}/{count['benign']}"
            + (f", errors {count['errors']}" if count["errors"] else "")
        )
    for name, held in summary["qualified"].items():
        how = f" ({held['held_as']})" if held["held_as"] else ""
        lines.append(
            f"  {name}{how} qualified on all {held['pairs']} benign runs of the campaign, "
            f"{held['benign']} of the suite before it, {held['own']} own attacks"
        )
    return [*lines, f"log: {log} (missionpair report {log})"]
