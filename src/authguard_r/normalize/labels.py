# SPDX-License-Identifier: Apache-2.0
"""The label of every privileged field, worked out and never read from the planner.

Source: section "Provenance Labels". Spec page: docs/spec/provenance.md
"""

from __future__ import annotations

from authguard_r.core.action import Action
from authguard_r.core.checks.provenance import CHOSEN, open_rows
from authguard_r.core.provenance import PRIVILEGED, Label
from authguard_r.core.standing import Standing
from authguard_r.core.token import VerifiedMission


def label_fields(
    action: Action, verified: VerifiedMission | None, standing: Standing | None, *, base: Label
) -> dict[str, Label]:
    """Return the label of every privileged field that the action has.

    Args:
        action: the proposal, its names already resolved.
        verified: the mission it will be held against, None when there is none.
        standing: for signed selections.
        base: the least trusted label of anything the planner could have seen.
    """
    labels: dict[str, Label] = {}
    for field in PRIVILEGED:
        value = getattr(action, field)
        if value is None or value == ():
            continue
        labels[field] = base
        if verified is not None and field in CHOSEN and _fixed(field, action, verified, standing):
            labels[field] = Label.OPERATOR
    return labels


def _fixed(
    field: str, action: Action, verified: VerifiedMission, standing: Standing | None
) -> bool:
    """True when the mission leaves exactly this value for the field of this action type."""
    places, value = verified.by_type.get(action.type, ()), getattr(action, field)
    for place in places:
        for row in open_rows(verified.grants[place].grant, standing, action.source):
            if getattr(row, field) != value:
                return False
    return bool(places)
