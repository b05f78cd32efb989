# SPDX-License-Identifier: Apache-2.0
"""Checks of one row: object, source, destination and route, held together and exactly.

Source: sections "Attack Categories" and "Authorization Predicate" (signed disjunctions).
"""

from __future__ import annotations

from authguard_r.core.checks.case import Case
from authguard_r.core.finding import Finding, Findings
from authguard_r.core.mission import Row
from authguard_r.core.provenance import Label
from authguard_r.core.reasons import Reason


def check_object(case: Case, row: Row) -> Findings:
    """(6) The object is the row's; none where the row has none."""
    if case.action.object == row.object:
        return ()
    return (_differs(case, "object", Reason.OBJECT_OUT_OF_SCOPE, row.object),)


def check_source(case: Case, row: Row) -> Findings:
    """(6) The source is the row's."""
    if case.action.source == row.source:
        return ()
    return (_differs(case, "source", Reason.SOURCE_OUT_OF_SCOPE, row.source),)


def check_destination(case: Case, row: Row) -> Findings:
    """(6) The destination is the row's; a sign, a voice or a document cannot change it."""
    if case.action.destination == row.destination:
        return ()
    return (_differs(case, "destination", Reason.DESTINATION_OUT_OF_SCOPE, row.destination),)


def check_route(case: Case, row: Row) -> Findings:
    """(6) Every region that the action asks to pass is one of the row's."""
    if not case.action.route:
        return ()
    expected = f"one of {', '.join(row.regions) or 'none'}"
    label = case.action.provenance.get("route", Label.MODEL)
    return tuple(
        Finding(f"route[{number}]", Reason.ROUTE_OUT_OF_SCOPE, expected, f"{region} ({label})")
        for number, region in enumerate(case.action.route)
        if region not in row.regions
    )


def _differs(case: Case, field: str, reason: Reason, expected: str | None) -> Finding:
    label, value = case.action.provenance.get(field, Label.MODEL), getattr(case.action, field)
    got = "none" if value is None else f"{value} ({label})"
    return Finding(field, reason, expected or "none", got)
