# SPDX-License-Identifier: Apache-2.0
"""Who chose: a value may be inside the signed rows and still be nobody's authorized choice.

The label of a field is never read from the planner and never rests on text matching. A field is
the operator's when the mission leaves one value for it, the chooser's when a signed selection
names the row, the sensor's when attested state leaves one row; else it is only as trusted as the
least trusted thing the planner could have seen.

Source: section "Provenance Policy", theorem "Privileged-field noninterference".
Spec page: docs/spec/provenance.md
"""

from __future__ import annotations

from authguard_r.core.checks.case import Case
from authguard_r.core.finding import Finding, Findings
from authguard_r.core.mission import Grant, Row
from authguard_r.core.provenance import Chooser, Label
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Standing
from authguard_r.core.token import IndexedGrant

#: The fields that a choice among rows settles. The source is settled by attested state, the route
#: by the row's regions.
CHOSEN = ("object", "destination")


def check_provenance(case: Case, indexed: IndexedGrant) -> Findings:
    """(6) Each chosen field has a label that may choose it."""
    grant = indexed.grant
    if len(grant.alternatives) == 1 or grant.chooser is Chooser.PLANNER:
        return ()
    rows = open_rows(grant, case.standing, case.action.source)
    if len(rows) == 1:
        return ()
    return tuple(
        Finding(
            field,
            Reason.PROVENANCE_DENIED,
            f"a choice by {grant.chooser}",
            f"{getattr(case.action, field)} ({case.action.provenance.get(field, Label.MODEL)})",
        )
        for field in CHOSEN
        if len({getattr(row, field) for row in rows}) > 1
    )


def open_rows(grant: Grant, standing: Standing | None, source: str | None) -> tuple[Row, ...]:
    """Return the rows that are left once selection and source are taken into account.

    The source counts because it must equal the attested place: a wrong one is refused anyway.
    """
    rows = selectable_rows(grant, standing)
    same = tuple([row for row in rows if row.source is None or row.source == source])
    return same or rows


def selectable_rows(grant: Grant, standing: Standing | None) -> tuple[Row, ...]:
    """Return the rows that may match: the selected one when there is a selection."""
    if standing is None or not standing.selected:
        return grant.alternatives
    index = standing.selected.get(grant.id)
    if index is None or not 0 <= index < len(grant.alternatives):
        return grant.alternatives
    return (grant.alternatives[index],)
