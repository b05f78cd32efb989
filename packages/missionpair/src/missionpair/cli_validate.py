# SPDX-License-Identifier: Apache-2.0
"""`missionpair validate`: the paper's hand-constructed suite under three systems."""

from __future__ import annotations

import json
import sys
from typing import Annotated

import typer

from missionpair.cli_progress import shown


def validate_command(
    remove: Annotated[
        list[str] | None,
        typer.Option("--without", help="Remove this check of the gate; repeatable."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> int:
    """Run the hand-constructed suite under three systems and print the paper's two tables."""
    # help does not need the gate
    from missionpair.ablation import CHECKS
    from missionpair.validation import lines, validated

    removed = remove or []
    unknown = sorted(set(removed) - set(CHECKS))
    if unknown:
        raise typer.BadParameter(f"no check is called `{unknown[0]}`", param_hint="--without")
    with shown(hidden=as_json, what="checks and trials") as show:
        payload = validated(removed, show)
    if as_json:
        sys.stdout.write(json.dumps(payload) + "\n")
    else:
        sys.stdout.write("\n".join(lines(payload)) + "\n")
    return 0 if payload["as_the_paper"] else 1
