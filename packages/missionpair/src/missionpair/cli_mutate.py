# SPDX-License-Identifier: Apache-2.0
"""`missionpair mutate`: does a suite notice when a check is gone?"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import msgspec
import typer

from missionpair import suites
from missionpair.campaign.plan import Progress
from missionpair.cli_progress import shown
from missionpair.pair import Suite
from missionpair.report.mutation import SCHEMA, Mutation
from missionpair.report.mutation import MutantReport as Row

if TYPE_CHECKING:
    from missionpair.mutation import Mutant

#: Benign runs that the second gate's rules are tried with.
_BENIGN = 24


def mutate_command(
    suite: Annotated[str, typer.Argument(help="A suite's name, or the path of its file.")],
    most: Annotated[
        int, typer.Option("--most", min=1, help="Number of pairs of each kind, at most.")
    ] = 256,
    out: Annotated[Path | None, typer.Option("--out", help="File for `report --mutation`.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> int:
    """Remove each check of the gates in turn, and attack: the suite must detect it.

    Exit 1 when no attack detects that a check is missing, or when an attack succeeds with every
    check in place.
    """
    # help does not need the gate
    from missionpair.mutation import mutate, mutate_safety, slice_of
    from missionpair.stage import Yard

    whole, digest = suites.load(suite)
    some = slice_of(whole, most=most)
    with shown(hidden=as_json, what="pairs") as show, Yard() as yard:
        benign = slice_of(some, most=_BENIGN)
        total = len(some.pairs)
        by_pair = mutate(some, yard, show=lambda done: show(Progress(done, total)))
        found = (*by_pair, *mutate_safety(benign, yard))
    if out is not None:
        written = Mutation(
            schema=SCHEMA,
            suite=some.name,
            suite_version=some.version,
            suite_digest=digest,
            mutants=tuple(msgspec.convert(mutant, Row, from_attributes=True) for mutant in found),
        )
        out.write_bytes(msgspec.json.encode(written) + b"\n")
    payload = payload_of(some, digest, found)
    if as_json:
        sys.stdout.write(json.dumps(payload) + "\n")
    else:
        sys.stdout.write("\n".join(_lines(payload)) + "\n")
    return 0 if payload["as_it_should"] else 1


def payload_of(suite: Suite, digest: str, found: tuple[Mutant, ...]) -> dict[str, Any]:
    """Return what `--json` prints."""
    return {
        "suite": suite.name,
        "version": suite.version,
        "digest": digest,
        "pairs": len(suite.pairs),
        "mutants": [_row(mutant) for mutant in found],
        "as_it_should": all(mutant.is_as_it_should for mutant in found),
    }


def _row(mutant: Mutant) -> dict[str, Any]:
    return {
        "gate": mutant.gate,
        "check": mutant.check,
        "trials": mutant.trials,
        "let_through": mutant.let_through,
        "rate": None if mutant.rate is None else float(round(mutant.rate, 4)),
        "first": mutant.first,
        "why_not": mutant.why_not,
        "as_it_should": mutant.is_as_it_should,
    }


def _lines(payload: dict[str, Any]) -> list[str]:
    from missionpair.tables import as_text  # help does not need the gate

    shown = [
        {
            "gate": row["gate"],
            "without": row["check"],
            "let through": f"{row['let_through']}/{row['trials']}",
            "": "" if row["as_it_should"] else "NOT AS IT SHOULD",
            "first, or why not": row["first"] or row["why_not"],
        }
        for row in payload["mutants"]
    ]
    head = f"{payload['suite']} {payload['version']}: {payload['pairs']} pairs"
    return [head, "", *as_text(shown)]
