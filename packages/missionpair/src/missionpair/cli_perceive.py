# SPDX-License-Identifier: Apache-2.0
"""`missionpair perceive`: a suite's signs as pictures that are read, its speech as sound."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from missionpair.cli_progress import shown
from missionpair.cli_run import JobsOption


def perceive_command(
    suite: Annotated[str, typer.Argument(help="A suite's name, or the path of its file.")],
    out: Annotated[Path, typer.Option("--out", help="A new file for the perceived suite.")],
    every: Annotated[
        int,
        typer.Option("--every", min=1, help="Use only every N-th pair."),
    ] = 1,
    pairs: Annotated[
        int | None, typer.Option("--pairs", min=1, help="Number of pairs (default: all).")
    ] = None,
    keep: Annotated[
        Path | None, typer.Option("--keep", help="Folder for pictures and sounds.")
    ] = None,
    jobs: JobsOption = 1,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> int:
    """Draw and read each sign, speak and recognize each sentence; write the results as a suite.

    Pairs without a sign or speech, and pairs in other languages than English, are left out.
    """
    from missionpair import suites
    from missionpair.campaign.plan import Progress
    from missionpair.pair import Suite
    from missionpair.perception import is_perceivable, perceive

    if out.exists():
        raise typer.BadParameter("there is such a file already", param_hint="--out")
    if not out.parent.is_dir():
        raise typer.BadParameter(f"there is no folder {out.parent}", param_hint="--out")
    made, _ = suites.load(suite)
    chosen = [pair for pair in made.pairs if is_perceivable(pair)][::every][:pairs]
    if not chosen:
        text = "no pair has an English sign or sentence that was not perceived yet"
        raise typer.BadParameter(text, param_hint="SUITE")
    if keep is not None:
        keep.mkdir(parents=True, exist_ok=True)
    part = Suite(name=made.name, version=made.version, layouts=made.layouts, pairs=tuple(chosen))
    with shown(hidden=as_json, what="pairs") as show:
        found = perceive(
            part, jobs=jobs, keep=keep, show=lambda done: show(Progress(done, len(chosen)))
        )
    digest = suites.write_suite(found, out)
    summary = {"suite": str(out), "digest": digest, "pairs": len(found.pairs)}
    summary["perceived"] = suites.counts_of(found)["perceived"]
    sys.stdout.write("\n".join(_lines(summary) if not as_json else [json.dumps(summary)]) + "\n")
    return 0


def _lines(summary: dict[str, Any]) -> list[str]:
    lines = [f"{summary['suite']}: {summary['pairs']} pairs"]
    for channel, counts in summary["perceived"].items():
        for how, (texts, words, wrong) in counts.items():
            rate = f"{100 * wrong / words:.1f} %" if words else "no word"
            lines.append(f"  {channel}, {how}: {texts} texts, word error rate {rate}")
    return [*lines, f"run it: missionpair run {summary['suite']} --planner graded --out log.jsonl"]
