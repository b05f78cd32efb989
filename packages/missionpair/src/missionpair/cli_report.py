# SPDX-License-Identifier: Apache-2.0
"""`missionpair report` and `missionpair compare`: what logs came to, from the logs alone.

Exit codes: 0 done; 1 two campaigns that cannot be compared; 2 wrong usage; 4 a log that is cut,
edited, foreign or contradicts itself; 5 a file that cannot be written.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer

from missionpair.cli_logs import LOG_FAULTS, apart, failed, measured
from missionpair.cli_progress import shown
from missionpair.report import (
    CampaignReport,
    lines,
    page,
    payload,
    read_mutation,
    sheets,
    tex_files,
)
from missionpair.report import report as report_of
from missionpair.report.compare import NotComparableError, Verdicts
from missionpair.report.compare import compare as compare_of
from missionpair.report.sheets import records
from missionpair.report.words import table_lines

JsonFlag = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]
PartialFlag = Annotated[
    bool, typer.Option("--partial", help="Allow a campaign that has not ended.")
]


def report_command(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG...", help="Logs of campaigns.")],
    html: Annotated[
        Path | None, typer.Option("--html", help="File for one HTML page without external parts.")
    ] = None,
    csv: Annotated[
        Path | None, typer.Option("--csv", help="Folder for one CSV file of each table.")
    ] = None,
    latex: Annotated[
        Path | None, typer.Option("--latex", help="Folder for LaTeX tables as in the paper.")
    ] = None,
    mutation: Annotated[
        Path | None, typer.Option("--mutation", help="Result of `missionpair mutate`.")
    ] = None,
    partial: PartialFlag = False,
    as_json: JsonFlag = False,
) -> int:
    """Make tables and plots from logs; a campaign with another access adds leakage."""
    try:
        with shown(hidden=as_json) as show:
            campaigns = [measured(path, partial=partial, show=show) for path in apart(logs)]
        mutants = None if mutation is None else read_mutation(mutation)
        found = report_of(campaigns, mutation=mutants)
        written = sorted(map(str, _write(found, html=html, csv=csv, latex=latex)))
    except LOG_FAULTS as error:
        return failed("LOG_INVALID", error.message, error.where, as_json=as_json, code=4)
    except OSError as error:
        return _environment(error, as_json=as_json)
    if as_json:
        _say(json.dumps({**payload(found), "files": written}))
    else:
        named = [f"Log {number}: {path}" for number, path in enumerate(logs, 1)]
        _say("\n".join([*named, *lines(found), *(f"written: {name}" for name in written)]))
    return 0


def compare_command(
    first: Annotated[Path, typer.Argument(metavar="LOG", help="Log of a campaign.")],
    second: Annotated[Path, typer.Argument(metavar="LOG", help="Log of another campaign.")],
    anyway: Annotated[
        bool, typer.Option("--anyway", help="Compare different suites, too.")
    ] = False,
    partial: PartialFlag = False,
    as_json: JsonFlag = False,
) -> int:
    """Compare two campaigns: set-up, rates with intervals, pairs with another verdict."""
    try:
        seen = Verdicts(), Verdicts()
        with shown(hidden=as_json) as show:
            one = measured(first, partial=partial, seen=seen[0], show=show)
            other = measured(second, partial=partial, seen=seen[1], show=show)
        found = compare_of(one, other, seen, is_any_allowed=anyway)
    except NotComparableError as error:
        return failed("NOT_COMPARABLE", error.message, error.where, as_json=as_json, code=1)
    except LOG_FAULTS as error:
        return failed("LOG_INVALID", error.message, error.where, as_json=as_json, code=4)
    if as_json:
        tables = {table.name: records(table) for table in found.tables}
        changes = msgspec.to_builtins(found.changes)
        _say(json.dumps({"simulated": found.simulated, "tables": tables, "changes": changes}))
    else:
        _say("\n\n".join("\n".join(table_lines(table)) for table in found.tables))
    return 0


def _write(
    found: CampaignReport, *, html: Path | None, csv: Path | None, latex: Path | None
) -> Iterator[Path]:
    """Write what was asked for and yield each file.

    Raises:
        OSError: one cannot be written; those before it are.
    """
    if html is not None:
        html.write_text(page(found), encoding="utf-8")
        yield html
    for folder, files in ((csv, sheets), (latex, tex_files)):
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
            for name, content in files(found):
                with (folder / name).open("w", encoding="utf-8") as file:
                    file.writelines(content)
                yield folder / name


def _environment(error: OSError, *, as_json: bool) -> int:
    """Say what the file system will not do."""
    message, where = error.strerror or str(error), str(error.filename or "")
    return failed("FILE_UNAVAILABLE", message, where, as_json=as_json, code=5)


def _say(words: Any) -> None:
    sys.stdout.write(f"{words}\n")
