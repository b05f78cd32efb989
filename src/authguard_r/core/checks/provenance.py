# SPDX-License-Identifier: Apache-2.0
"""Who set each field: a value inside the signed rows may still be chosen by no authorized source.

The label of a field is never read from the planner and never rests on text matching. A field is
its signer's when the mission leaves one value for it, the chooser's when a signed selection names
the row, the sensor's when attested state leaves one row; else it is only as trusted as the least
trusted thing the planner could have seen. AllowedSrc(f) says which labels may set it.

Source: sections "Provenance Labels" and "Provenance Policy", theorem "Privileged-field
noninterference". Spec page: docs/spec/provenance.md
"""

from __future__ import annotations

from collections.abc import Iterator

from authguard_r.core.checks.case import Case
from authguard_r.core.finding import Finding, Findings
from authguard_r.core.mission import Grant, Row
from authguard_r.core.provenance import (
    SIGNED,
    UNTRUSTED,
    WIDEST,
    AllowedSources,
    Chooser,
    Label,
    SourceField,
)
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Standing
from authguard_r.core.token import IndexedGrant

#: The fields that a choice among rows settles. The source is settled by attested state, the route
#: by the row's regions.
CHOSEN = ("object", "destination")


def check_provenance(case: Case, indexed: IndexedGrant) -> Findings:
    """(6) Each field has a label that AllowedSrc of its field names."""
    grant = indexed.grant
    if case.verified.sources or case.facts.sources:
        return tuple(
            _denied(field, label, case, grant)
            for field, label in _all_labels(case, indexed)
            if label not in allowed_sources(field, case, grant)
        )
    # without a signed set only a choice among several rows can be denied
    if len(grant.alternatives) == 1 or grant.chooser is Chooser.PLANNER:
        return ()
    left = open_rows(grant, case.standing, case.action.source)
    return tuple(
        _denied(SourceField(field), _action_label(case, field), case, grant)
        for field in CHOSEN
        if len({getattr(row, field) for row in left}) > 1
    )


def allowed_sources(field: SourceField, case: Case, grant: Grant) -> frozenset[Label | None]:
    """Return AllowedSrc(f): what the paper, the grant's chooser, the site and the mission allow.

    An unknown label, None, is allowed where every label is: it cannot be one that is not.
    """
    allowed: frozenset[Label | None] = WIDEST[field]
    if field in CHOSEN and grant.chooser is not Chooser.PLANNER:
        several = len(grant.alternatives) > 1
        allowed = SIGNED | {Label.TRUSTED_SENSOR} if several else SIGNED
    for sources in (case.facts.sources, case.verified.sources):
        allowed = allowed & sources.get(field, allowed)
    return allowed | {None} if len(allowed) == len(Label) else allowed


def wider_sources(mission: AllowedSources, site: AllowedSources) -> tuple[SourceField, ...]:
    """Return the fields for which a mission names a label that its site does not allow."""
    return tuple(field for field in mission if mission[field] - site.get(field, WIDEST[field]))


def _all_labels(case: Case, indexed: IndexedGrant) -> Iterator[tuple[SourceField, Label | None]]:
    """Yield the label of each field that this action sets, or that this grant lets it use."""
    kind, issuer = case.kind, case.verified.issuer.label
    yield SourceField.TYPE, _action_label(case, "type")
    yield SourceField.TOOL, _action_label(case, "tool")
    yield from _chosen_labels(case, indexed.grant)
    if case.action.route:
        yield SourceField.ROUTE, _action_label(case, "route")
    if any(limit.low != limit.high for limit in indexed.grant.limits):
        yield SourceField.PARAMETERS, _action_label(case, "params")
    if kind is not None and (kind.records or kind.stores or kind.transmits):
        yield SourceField.RECORDING, issuer
    yield SourceField.APPROVAL_THRESHOLD, issuer


def _chosen_labels(case: Case, grant: Grant) -> Iterator[tuple[SourceField, Label | None]]:
    """Yield whose values object and destination are: a signer's, a sensor's or the planner's."""
    rows = selectable_rows(grant, case.standing)
    left = open_rows(grant, case.standing, case.action.source)
    for field in CHOSEN:
        if len({getattr(row, field) for row in rows}) == 1:
            label: Label | None = signed_by(field, grant, rows, case.verified.issuer.label)
        elif len({getattr(row, field) for row in left}) == 1:
            label = Label.TRUSTED_SENSOR
        else:
            label = _action_label(case, field)
        yield SourceField(field), label


def signed_by(field: str, grant: Grant, rows: tuple[Row, ...], issuer: Label) -> Label:
    """Return whose signature leaves one value: the mission's, or else the selection's."""
    if rows is grant.alternatives or len({getattr(row, field) for row in grant.alternatives}) == 1:
        return issuer
    return Label.SUPERVISOR if grant.chooser is Chooser.SUPERVISOR else Label.OPERATOR


def _action_label(case: Case, field: str) -> Label | None:
    """Return the label of a value that only the planner set; None when its source is unknown."""
    label = case.action.provenance.get(field)
    return label if label in UNTRUSTED else None


def _denied(field: SourceField, label: Label | None, case: Case, grant: Grant) -> Finding:
    """Return the finding: who has to set the field, and who did."""
    allowed = sorted(filter(None, allowed_sources(field, case, grant)))
    expected = f"set by {' or '.join(allowed) or 'nobody'}"
    if field in CHOSEN and len(grant.alternatives) > 1 and grant.chooser is not Chooser.PLANNER:
        expected = f"a choice by {grant.chooser}"
    value = getattr(case.action, field, field)
    return Finding(
        str(field), Reason.PROVENANCE_DENIED, expected, f"{value} ({label or 'unknown'})"
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
