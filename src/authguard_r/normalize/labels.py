# SPDX-License-Identifier: Apache-2.0
"""The label of every privileged field, worked out and never read from the planner.

Source: section "Provenance Labels". Spec page: docs/spec/provenance.md
"""

from __future__ import annotations

from authguard_r.core.action import Action
from authguard_r.core.checks.provenance import CHOSEN, open_rows, selectable_rows
from authguard_r.core.mission import Grant, Row
from authguard_r.core.provenance import PRIVILEGED, TRUST, Chooser, Label
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
        if verified is not None and field in CHOSEN:
            labels[field] = _chosen_by(field, action, verified, standing) or base
    return labels


def _chosen_by(
    field: str, action: Action, verified: VerifiedMission, standing: Standing | None
) -> Label | None:
    """Return who made the field this value in the grants that have it; None when nobody did.

    A planner may choose among grants, that is how it does its task; it may not choose within one.
    """
    value, found = getattr(action, field), list[Label]()
    for place in verified.by_type.get(action.type, ()):
        grant = verified.grants[place].grant
        if value not in _values(field, selectable_rows(grant, standing)):
            continue
        label = _settled_by(field, action, grant, standing)
        if label is None:
            return None
        found.append(label)
    return max(found, key=TRUST.index, default=None)


def _settled_by(
    field: str, action: Action, grant: Grant, standing: Standing | None
) -> Label | None:
    """Return whose word leaves exactly this value: the signer's, the chooser's, the sensor's."""
    only = {getattr(action, field)}
    if _values(field, grant.alternatives) == only:
        return Label.OPERATOR
    if _values(field, selectable_rows(grant, standing)) == only:
        return Label.SUPERVISOR if grant.chooser is Chooser.SUPERVISOR else Label.OPERATOR
    settled = _values(field, open_rows(grant, standing, action.source)) == only
    return Label.TRUSTED_SENSOR if settled else None


def _values(field: str, rows: tuple[Row, ...]) -> set[str | None]:
    return {getattr(row, field) for row in rows}
