# SPDX-License-Identifier: Apache-2.0
"""What each check of the gate is worth: the suite again with one check taken out.

A check that can be taken out unnoticed is one that the suite does not test. The file is written by
a mutation run and read here. Spec page: docs/spec/measures.md
"""

from __future__ import annotations

from pathlib import Path

import msgspec
from msgspec import Struct

from missionpair.measures import MeasureError, Proportion
from missionpair.report.names import printable
from missionpair.report.table import Head, Table

SCHEMA = "missionpair/mutation/1"
#: The row in which no check is missing.
NOTHING = "nothing"


class MutantReport(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The suite under gates without one check, as `missionpair.mutation` reports it.

    Args:
        gate: `authorization` or `safety`.
        check: what was taken out, such as `check_object`; `nothing` for none.
        trials: what was tried.
        let_through: of those, with something carried out that must not be.
        first: the first such pair.
        why_not: why no trial can reach the check; empty where one has to.
    """

    gate: str
    check: str
    trials: int
    let_through: int
    first: str = ""
    why_not: str = ""

    @property
    def verdict(self) -> str:
        """What the suite is worth to this check."""
        if self.check == NOTHING:
            return "NOT SOUND" if self.let_through else "sound"
        if self.let_through:
            return "tested"
        return "out of reach" if self.why_not else "NOT TESTED"


class Mutation(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A mutation run.

    Args:
        schema: version of this format.
        suite: its name.
        suite_version: its version.
        suite_digest: of its canonical bytes.
        mutants: one for each check of each gate, and one for nothing taken out.
    """

    schema: str
    suite: str
    suite_version: int
    suite_digest: str
    mutants: tuple[MutantReport, ...]


def read_mutation(path: Path) -> Mutation:
    """Return a mutation run's file.

    Raises:
        MeasureError: it is not valid, or its counts cannot be so.
        OSError: it cannot be read.
    """
    data = path.read_bytes()
    try:
        mutation = msgspec.json.decode(data, type=Mutation)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise MeasureError(f"no mutation run: {error}", where=str(path)) from error
    if mutation.schema != SCHEMA:
        raise MeasureError(f"expected schema `{SCHEMA}`", where=str(path))
    for mutant in mutation.mutants:
        if not 0 <= mutant.let_through <= mutant.trials:
            where = f"{path}: {printable(mutant.check)}"
            raise MeasureError("expected trials, and at most as many that passed", where=where)
    return mutation


def mutation_table(mutation: Mutation) -> Table:
    """Return what gets through without each check; where nothing does, the suite tests it not."""
    suite = f"{printable(mutation.suite)} version {mutation.suite_version}"
    return Table(
        name="mutation",
        title=f"Checks taken out one by one, suite {suite}",
        label="tab:mutation",
        heads=(
            Head("gate", "Gate"),
            Head("check", "Taken out"),
            Head("let_through", "Let through"),
            Head("verdict", "The suite"),
            Head("first", "Such as"),
            Head("why_not", "Why not"),
        ),
        rows=tuple(
            (
                printable(mutant.gate),
                printable(mutant.check),
                Proportion(mutant.let_through, mutant.trials),
                mutant.verdict,
                printable(mutant.first),
                mutant.why_not,
            )
            for mutant in mutation.mutants
        ),
        notes=("Without a check of the authorization gate this is UASR. Intervals: Wilson, 95 %.",),
        front=True,
        section="Mutation",
    )
