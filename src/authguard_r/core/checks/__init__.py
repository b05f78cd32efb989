# SPDX-License-Identifier: Apache-2.0
"""C_1 to C_m: one function for one condition, listed here in paper order.

Each returns its findings, none when the condition holds; none reads a clock, a store or a
request. Source: section "Authorization Predicate". Spec page: docs/spec/decision.md
"""

from __future__ import annotations

from collections.abc import Callable

from authguard_r.core.checks.case import Case
from authguard_r.core.checks.grant import (
    check_budgets,
    check_data_rights,
    check_grant_guards,
    check_order,
    check_parameters,
    check_tool,
    check_type,
    check_uses,
)
from authguard_r.core.checks.mission import (
    check_capability,
    check_ceilings,
    check_certificate,
    check_meta,
    check_mission_guards,
    check_registry,
    check_robot,
    check_time,
)
from authguard_r.core.checks.place import check_place
from authguard_r.core.checks.provenance import check_provenance
from authguard_r.core.checks.row import check_destination, check_object, check_route, check_source
from authguard_r.core.finding import Findings
from authguard_r.core.mission import Row
from authguard_r.core.token import IndexedGrant

#: Steps 3 to 6: of the mission as a whole.
MISSION_CHECKS: tuple[Callable[[Case], Findings], ...] = (
    check_time,
    check_registry,
    check_robot,
    check_meta,
    check_capability,
    check_ceilings,
    check_mission_guards,
)

#: Step 6: of one grant.
GRANT_CHECKS: tuple[Callable[[Case, IndexedGrant], Findings], ...] = (
    check_type,
    check_tool,
    check_parameters,
    check_data_rights,
    check_order,
    check_uses,
    check_budgets,
    check_grant_guards,
    check_provenance,
)

#: Step 6: of one row.
ROW_CHECKS: tuple[Callable[[Case, Row], Findings], ...] = (
    check_object,
    check_source,
    check_place,
    check_destination,
    check_route,
)

__all__ = ["GRANT_CHECKS", "MISSION_CHECKS", "ROW_CHECKS", "Case", "check_certificate"]
