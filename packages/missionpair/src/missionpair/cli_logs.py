# SPDX-License-Identifier: Apache-2.0
"""Logs on the command line: each is read once, and no trial is counted twice."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from missionpair.campaign.log import LogError, read_log
from missionpair.campaign.plan import Progress
from missionpair.cli_progress import counted
from missionpair.measures import MeasuredCampaign, MeasureError, measure
from missionpair.measures.apart import why_not_apart
from missionpair.records import Campaign
from missionpair.report.compare import Verdicts

#: What is wrong with a log, and never a traceback.
LOG_FAULTS = (LogError, MeasureError)


def apart(paths: Sequence[Path]) -> Sequence[Path]:
    """Return the same logs, whose figures may be added up; their first lines alone are read.

    Raises:
        LogError: one cannot be read, or has trials that one before it has.
    """
    seen: list[tuple[Path, Campaign]] = []
    for path in paths:
        campaign, _ = read_log(path, is_partial_allowed=True)
        for before, other in seen:
            why = why_not_apart(other, campaign)
            if why:
                text = f"its trials would count twice, they are in `{before}` too: {why}"
                raise LogError(text, where=str(path))
        seen.append((path, campaign))
    return paths


def measured(
    path: Path,
    *,
    partial: bool = False,
    seen: Verdicts | None = None,
    show: Callable[[Progress], None] = lambda _: None,
) -> MeasuredCampaign:
    """Read one log, each line once.

    Args:
        path: the file.
        partial: take a campaign that has not come to its end.
        seen: called with every trial.
        show: shows how many trials were read.

    Raises:
        LogError: it cannot be read, was cut or was changed.
        MeasureError: what it says cannot be so; names the log too.
    """
    campaign, trials = read_log(path, is_partial_allowed=partial)
    try:
        read = counted(trials, campaign.trials, show)
        return measure(campaign, read if seen is None else seen.watch(read))
    except MeasureError as error:
        raise MeasureError(error.message, where=f"{path}: {error.where}") from error


def failed(code_name: str, message: str, where: str, *, as_json: bool, code: int) -> int:
    """Print an error where it belongs and return the exit code."""
    if as_json:
        error = {"code": code_name, "message": message, "where": where}
        sys.stdout.write(json.dumps({"error": error}) + "\n")
    else:
        sys.stderr.write(f"{code_name}: {message} (at {where})\n")
    return code
