# SPDX-License-Identifier: Apache-2.0
"""The label of every field of an action, worked out and never read from the planner.

Source: section "Provenance Labels". Spec page: docs/spec/provenance.md
"""

from __future__ import annotations

from collections.abc import Callable
from operator import attrgetter
from typing import Any

from authguard_r.core.action import Action
from authguard_r.core.checks.provenance import CHOSEN, open_rows, selectable_rows, signed_by
from authguard_r.core.provenance import LABELED, TRUST, Label
from authguard_r.core.standing import Standing
from authguard_r.core.token import VerifiedMission

_FIELD: dict[str, Callable[[Any], Any]] = {field: attrgetter(field) for field in CHOSEN}


def label_fields(
    action: Action, verified: VerifiedMission | None, standing: Standing | None, *, base: Label
) -> dict[str, Label]:
    """Return the label of every field that the action has.

    Args:
        action: the proposal, its names already resolved.
        verified: the mission that it will be checked against, None without one.
        standing: for signed selections.
        base: the least trusted label of anything the planner could have seen.
    """
    labels: dict[str, Label] = {"type": base, "tool": base}
    for field in LABELED[2:]:
        if not getattr(action, field):
            continue
        labels[field] = base
        if verified is not None and field in CHOSEN:
            labels[field] = _chosen_by(field, action, verified, standing) or base
    return labels


def _chosen_by(
    field: str, action: Action, verified: VerifiedMission, standing: Standing | None
) -> Label | None:
    """Return who made the field this value in the grants that have it; None when no source did.

    A planner may choose among grants, that is how it does its task; it may not choose within one.
    """
    get, found = _FIELD[field], list[Label]()
    value = get(action)
    for place in verified.by_type.get(action.type, ()):
        grant = verified.grants[place].grant
        rows = selectable_rows(grant, standing)
        values = set(map(get, rows))
        if value not in values:
            continue
        if len(values) == 1:
            found.append(signed_by(field, grant, rows, verified.issuer.label))
        elif set(map(get, open_rows(grant, standing, action.source))) == {value}:
            found.append(Label.TRUSTED_SENSOR)
        else:
            return None
    return max(found, key=TRUST.index, default=None)
