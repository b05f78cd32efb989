# SPDX-License-Identifier: Apache-2.0
"""`missionpair require`: whether campaigns came to what they have to come to.

Exit codes: 0 every demand is met; 1 one is not; 2 wrong usage; 4 a log that is cut, edited, foreign
or contradicts itself.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from missionpair.cli_logs import LOG_FAULTS, apart, failed, measured
from missionpair.cli_progress import shown
from missionpair.measures.demands import Demand, demands
from missionpair.words import TrialKind


def require_command(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG...", help="Logs of campaigns.")],
    defense: Annotated[
        list[str] | None, typer.Option("--defense", help="The defense; repeatable (default: both).")
    ] = None,
    kind: Annotated[
        list[TrialKind] | None,
        typer.Option("--kind", help="Kind of trials; repeatable (default: all)."),
    ] = None,
    tries: Annotated[
        int,
        typer.Option(
            "--tries", min=0, help="Least number of attacks refused with each reason code."
        ),
    ] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> int:
    """Check that logs meet the demands: no unauthorized action, and every signed action done."""
    try:
        with shown(hidden=as_json) as show:
            those = [measured(path, show=show) for path in apart(logs)]
    except LOG_FAULTS as error:
        return failed("LOG_INVALID", error.message, error.where, as_json=as_json, code=4)
    wanted = tuple(dict.fromkeys(defense or ["both"]))
    known = {name: None for one in those for name in one.defenses}
    for name in wanted:
        if name not in known:
            text = f"no log has a defense `{name}`: {', '.join(known)}"
            raise typer.BadParameter(text, param_hint="--defense")
    found = [
        demand
        for name in wanted
        for demand in demands(those, name, kinds=frozenset(kind or TrialKind), tries=tries)
    ]
    met = all(demand.met for demand in found)
    if as_json:
        sys.stdout.write(json.dumps({"met": met, "demands": msgspec.to_builtins(found)}) + "\n")
    else:
        sys.stdout.write("\n".join(map(_line, found)) + "\n")
    return 0 if met else 1


def _line(demand: Demand) -> str:
    verdict = "met    " if demand.met else "NOT MET"
    return f"{verdict} {demand.defense}: {demand.demand}: {demand.found} (wanted: {demand.wanted})"
