# SPDX-License-Identifier: Apache-2.0
"""`missionpair list`: what there is to run, and what a suite asks a planner."""

from __future__ import annotations

import json
import sys
from typing import Annotated

import msgspec
import typer

from missionpair import registry, suites
from missionpair.cli_run import KindOption, RoundsOption
from missionpair.words import TrialKind


def list_command(
    suite: Annotated[
        str,
        typer.Argument(help="Print the questions of this suite, one in each line."),
    ] = "",
    kind: KindOption = None,
    rounds: RoundsOption = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print JSON: one object, or one for each question.")
    ] = False,
) -> int:
    """List suites, planners, attackers and defenses, or the questions of one suite.

    The questions are those of the attacker `fixed`. Ask them to your own model, and read its
    answers with `missionpair import`.
    """
    if suite:
        from missionpair.campaign.questions import questions  # help does not need the gate

        kinds = tuple(dict.fromkeys(kind or TrialKind))
        for one in questions(suite, kinds, rounds=rounds or suites.usual(suite).rounds):
            if as_json:
                sys.stdout.write(msgspec.json.encode(one).decode() + "\n")
                continue
            heard = "; ".join(f"[{channel}] {text}" for channel, text in one.inputs)
            line = (one.pair, one.kind, str(one.round), one.task, heard)
            sys.stdout.write("  ".join(filter(None, line)) + "\n")
        return 0
    from missionpair import attackers, defenses, planners  # help does not need the gate

    rooms = {"suites": suites, "planners": planners, "attackers": attackers, "defenses": defenses}
    found = {
        name: {item: registry.help_of(room, item) for item in registry.names(room)}
        for name, room in rooms.items()
    }
    found["suites"] = {name: text + _usually(name) for name, text in found["suites"].items()}
    if as_json:
        sys.stdout.write(json.dumps(found) + "\n")
        return 0
    for name, items in found.items():
        width = max(map(len, items), default=0)
        lines = [f"  {item.ljust(width)}  {text}" for item, text in items.items()]
        sys.stdout.write("\n".join((f"{name}:", *lines, "")) + "\n")
    return 0


def _usually(suite: str) -> str:
    """Return what is usual for a suite, where that is not one round with one answer."""
    said = [f"{name} {n}" for name, n in suites.usual(suite)._asdict().items() if n != 1]
    return f" ({', '.join(said)})" if said else ""
