# SPDX-License-Identifier: Apache-2.0
"""`missionpair`: attack the gate, and measure."""

from __future__ import annotations

import sys
from typing import Any, Final

import typer

from authguard_r.operations.command_tree import CommandEntry, Program, command_tree

COMMANDS: Final = {
    words: CommandEntry(*told)
    for words, told in {
        "validate": ("cli_validate:validate", "Reproduce the paper's two tables"),
        "run": ("cli_run:run", "Attack a planner with every pair of a suite"),
        "live": ("cli_live:live", "Attack language models, fixed and adaptive; report"),
        "list": ("cli_list:list", "List suites, planners, attackers and defenses"),
        "report": ("cli_report:report", "Make tables and plots from logs"),
        "compare": ("cli_report:compare", "Compare two campaigns"),
        "require": ("cli_require:require", "Check that logs meet the demands"),
        "mutate": ("cli_mutate:mutate", "Remove each check of the gate in turn, and attack"),
        "perceive": ("cli_perceive:perceive", "Draw and read, speak and hear a suite's texts"),
        "import agentdojo": ("cli_import:agentdojo", "Read the runs of AgentDojo's distribution"),
        "import steps": ("cli_import:steps", "Read replies that are lists of tool and arguments"),
        "import openai": ("cli_import:openai", "Read replies that are chat completions"),
        "import mcp": ("cli_import:mcp", "Read replies that are JSON-RPC requests"),
        "import langchain": ("cli_import:langchain", "Read replies that are LangChain messages"),
        "recorded": ("cli_recorded:recorded", "Test each recorded call against each defense"),
        "approvers": ("cli_approvers:approvers", "Answer approval requests by a script"),
    }.items()
}

MISSIONPAIR: Final = Program(
    name="missionpair",
    package="missionpair",
    distribution="missionpair",
    help="Attacks that are safe and unauthorized, and how many of them succeed.",
    commands=COMMANDS,
    groups={"import": "Read recorded runs of language models"},
    sections={
        "Campaigns": ("validate", "run", "live", "list", "perceive", "mutate"),
        "Results": ("report", "compare", "require"),
        "Recorded runs": ("import", "recorded"),
        "Measuring": ("approvers",),
    },
)


def program(first: str = "") -> Any:
    """Return the tree of commands, for a command line that begins with this word."""
    return command_tree(MISSIONPAIR, first)


def main() -> None:
    """Run one command and exit with its code; every error is printed, not thrown."""
    try:
        made = program(sys.argv[1] if sys.argv[1:] else "")
        result = made(prog_name="missionpair", standalone_mode=False)
    except typer.Exit as stop:
        sys.exit(stop.exit_code)
    except (Exception, KeyboardInterrupt) as error:
        from missionpair.faults import fault_of  # it imports every part that can fail

        fault = fault_of(error)
        if fault is None:
            raise
        if "--json" in sys.argv:
            sys.stdout.write(fault.as_json() + "\n")
        else:
            sys.stderr.write(fault.as_text() + "\n")
        sys.exit(fault.exit_code)
    sys.exit(result if isinstance(result, int) else 0)
