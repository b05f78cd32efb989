# SPDX-License-Identifier: Apache-2.0
"""`missionpair import`: recorded runs of language models, read for later campaigns."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from missionpair.campaign.plan import Progress
from missionpair.cli_progress import shown
from missionpair.report.names import printable


def agentdojo_command(
    source: Annotated[
        Path, typer.Argument(help="agentdojo-0.1.24.tar.gz from PyPI, or a folder of its contents.")
    ],
    out: Annotated[Path, typer.Option("--out", help="A new folder for runs and missions.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> int:
    """Read AgentDojo's runs, and write them with a signed mission for each of its tasks.

    The source is not executed. The command writes only inside the new folder.
    """
    from missionpair.recorded.folder import import_agentdojo  # help does not need the gate

    if out.exists():
        raise typer.BadParameter("there is such a folder already", param_hint="--out")
    if not out.parent.is_dir():
        raise typer.BadParameter(f"there is no folder {out.parent}", param_hint="--out")
    with shown(hidden=as_json, what="runs") as show:
        found = import_agentdojo(source, out, show=lambda done: show(Progress(done, done)))
    if as_json:
        sys.stdout.write(msgspec.json.encode(found).decode() + "\n")
        return 0
    sys.stdout.write(
        f"{out}: {found.runs} runs of {len(found.pipelines)} pipelines; {found.attacked} attacked,"
        f" {found.landed} landed\nreplay them: missionpair recorded {out} --jobs 2\n"
    )
    return 0


def _of_form(form: str, text: str) -> Callable[..., int]:
    """Return the command that reads logs of one form."""

    def command(
        source: Annotated[Path, typer.Argument(help="The log: one reply a line, as JSON.")],
        out: Annotated[Path, typer.Option("--out", help="A new file of replies.")],
        model: Annotated[
            str, typer.Option("--model", help="The model, if the log does not name it.")
        ] = "",
        date: Annotated[str, typer.Option("--date", help="The date, such as 2026-11-28.")] = "",
        suite: Annotated[
            str, typer.Option("--suite", help="The suite of the pairs: a name or a file.")
        ] = "",
        as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
    ) -> int:
        from missionpair.recorded.replies import import_replies  # help does not need the gate

        if out.exists():
            raise typer.BadParameter("there is such a file already", param_hint="--out")
        if not out.parent.is_dir():
            raise typer.BadParameter(f"there is no folder {out.parent}", param_hint="--out")
        head, count = import_replies(form, source, out, model=model, date=date, suite=suite)
        if as_json:
            told = {**msgspec.to_builtins(head), "replies": count}
            sys.stdout.write(json.dumps(told) + "\n")
            return 0
        sys.stdout.write(
            f"{out}: {count} replies of {printable(head.model)}, {head.date}\n"
            f"run them: missionpair run {suite or 'SUITE'} --planner recorded:file={out}"
            " --kind attack --out LOG\n"
        )
        return 0

    command.__doc__ = text
    return command


steps_command = _of_form("steps", "Read replies that are lists of tool and arguments (`steps`).")
openai_command = _of_form("openai", "Read replies that are chat completions (`response`).")
mcp_command = _of_form("mcp", "Read replies that are JSON-RPC requests `tools/call` (`calls`).")
langchain_command = _of_form("langchain", "Read replies that are LangChain messages (`messages`).")
