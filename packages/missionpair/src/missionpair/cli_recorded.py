# SPDX-License-Identifier: Apache-2.0
"""`missionpair recorded`: imported runs of language models, tested against each defense."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from missionpair.campaign.plan import Progress
from missionpair.cli_progress import shown
from missionpair.cli_run import JobsOption, RayOption

#: The defenses of a replay, where none is named.
DEFENSES = ("none", "allowlist", "cedar", "both")


def recorded_command(
    folder: Annotated[Path, typer.Argument(help="Folder of `missionpair import agentdojo`.")],
    defense: Annotated[
        list[str] | None,
        typer.Option("--defense", help="none, allowlist, cedar, both ...; repeatable."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", help="File for every leak and refusal with its cause."),
    ] = None,
    jobs: JobsOption = 1,
    ray: RayOption = "",
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> int:
    """Test every recorded call against each defense, and print which of them would have run."""
    # help does not need the gate
    from missionpair.recorded.folder import read_runs, read_source
    from missionpair.recorded.replay import replay_all
    from missionpair.recorded.tables import LABEL, Replay, lines, plain

    if out is not None and out.exists():
        raise typer.BadParameter("there is such a file already", param_hint="--out")
    if out is not None and not out.parent.is_dir():
        raise typer.BadParameter(f"there is no folder {out.parent}", param_hint="--out")
    source = read_source(folder)
    names = tuple(dict.fromkeys(defense or DEFENSES))
    found = Replay()
    with shown(hidden=as_json, what="runs") as show:
        total = source.runs
        replayed = replay_all(
            read_runs(folder),
            names,
            jobs=jobs,
            ray=ray,
            show=lambda done: show(Progress(done, total)),
        )
        for one in replayed:
            found.add(one)
    if out is not None:
        out.write_bytes(b"".join(msgspec.json.encode(one) + b"\n" for one in found.remaining))
    if as_json:
        told = {"label": LABEL, "source": msgspec.to_builtins(source), "rows": plain(found.rows)}
        sys.stdout.write(json.dumps(told) + "\n")
        return 0
    sys.stdout.write("\n".join(lines(found.rows)) + "\n")
    return 0
