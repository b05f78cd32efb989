# SPDX-License-Identifier: Apache-2.0
"""What goes wrong on the command line: a code, a message with what to do, a place, an exit code.

Spec page: docs/reference/cli.md#exit-codes
"""

from __future__ import annotations

import json
from typing import NamedTuple

import typer
from typer.exceptions import TyperException

from authguard_r.core.errors import AuthGuardError, EnvironmentFault, shown
from authguard_r.operations.usage import message_of, place_of
from missionpair.attackers import AttackerError
from missionpair.briefing import PlannerError
from missionpair.campaign.cluster import ClusterError
from missionpair.campaign.log import LogError
from missionpair.perception import PerceptionError
from missionpair.recorded.archive import SourceError
from missionpair.registry import SpecificationError
from missionpair.stage import StageError
from missionpair.suites import SuiteError

USAGE, UNREADABLE, HERE, INTERRUPTED = 2, 4, 5, 130
#: What a planner reads that is not as it has to be, by the code that it says.
_READ = {"file": "FILE_INVALID", "log": "LOG_INVALID"}


class CommandFault(NamedTuple):
    """One error as it is shown."""

    code: str
    message: str
    where: str
    exit_code: int

    def as_json(self) -> str:
        """Return the object that `--json` prints."""
        error = {"code": self.code, "message": self.message, "where": self.where}
        return json.dumps({"error": error})

    def as_text(self) -> str:
        """Return a line for people."""
        where = f"{shown(self.where)}: " if self.where else ""
        return f"{self.code}: {where}{shown(self.message)}"


def fault_of(error: BaseException) -> CommandFault | None:
    """Return how an error is shown; None: a fault of the program, which is not caught."""
    match error:
        case typer.Abort() | KeyboardInterrupt() | TyperException():
            return _of_person(error)
        case SpecificationError():
            return CommandFault("USAGE", str(error), "", USAGE)
        case SourceError() | SuiteError() | StageError():
            code = "SOURCE_BROKEN" if isinstance(error, SourceError) else "SUITE_BROKEN"
            return CommandFault(code, error.message, error.where, UNREADABLE)
        case LogError(is_here=True):
            return CommandFault("LOG_UNAVAILABLE", error.message, error.where, HERE)
        case LogError():
            return CommandFault("LOG_BROKEN", error.message, error.where, UNREADABLE)
        case PlannerError() | AttackerError():
            return _of_model(error)
        case ClusterError() | PerceptionError():
            return _of_part(error)
        case AuthGuardError():
            at = HERE if isinstance(error, EnvironmentFault) else UNREADABLE
            return CommandFault(str(error.reason), error.message, error.where, at)
        case OSError():
            text, where = error.strerror or str(error), str(error.filename or "")
            return CommandFault("FILE_UNAVAILABLE", text, where, HERE)
    return None


def _of_person(error: typer.Abort | KeyboardInterrupt | TyperException) -> CommandFault:
    """Return how a wrong command line, or a person's stop, is shown."""
    if isinstance(error, TyperException):
        return CommandFault("USAGE", message_of(error), place_of(error), USAGE)
    if isinstance(error, typer.Abort):
        return CommandFault("ABORTED", "stopped by the user", "", USAGE)
    text = "stopped; the log has each trial of a campaign that was finished"
    return CommandFault("ABORTED", text, "", INTERRUPTED)


def _of_part(error: ClusterError | PerceptionError) -> CommandFault:
    """Return how a part of the machine fails that an extra brings."""
    if isinstance(error, ClusterError):
        return CommandFault("CLUSTER_UNAVAILABLE", error.message, error.where, HERE)
    return CommandFault("PERCEPTION_UNAVAILABLE", str(error), "", HERE)


def _of_model(error: PlannerError | AttackerError) -> CommandFault:
    """Return how one that plans or writes fails: by a wrong option, by what it reads, or here."""
    if error.code == "usage":
        return CommandFault("USAGE", error.message, error.where, USAGE)
    if error.code in _READ:
        return CommandFault(_READ[error.code], error.message, error.where, UNREADABLE)
    kind = "PLANNER" if isinstance(error, PlannerError) else "ATTACKER"
    return CommandFault(f"{kind}_{error.code.upper()}", error.message, error.where, HERE)
