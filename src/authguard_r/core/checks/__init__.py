# SPDX-License-Identifier: Apache-2.0
"""C_1 to C_m: one function for one condition, listed here in paper order.

Each returns its findings, none when the condition holds; none reads a clock, a store or a
request. Source: section "Authorization Predicate". Spec page: docs/spec/decision.md
"""

from __future__ import annotations

from collections.abc import Callable

from authguard_r.core.checks import grant, mission, place, provenance, row
from authguard_r.core.checks.case import Case
from authguard_r.core.finding import Findings
from authguard_r.core.mission import Row
from authguard_r.core.token import IndexedGrant

#: Steps 3 to 6: of the mission as a whole.
MISSION_CHECKS: tuple[Callable[[Case], Findings], ...] = (
    mission.check_time,
    mission.check_registry,
    mission.check_robot,
    mission.check_meta,
    mission.check_capability,
    mission.check_ceilings,
    mission.check_mission_guards,
)

#: Step 6: of one grant.
GRANT_CHECKS: tuple[Callable[[Case, IndexedGrant], Findings], ...] = (
    grant.check_type,
    grant.check_tool,
    grant.check_parameters,
    grant.check_data_rights,
    grant.check_order,
    grant.check_uses,
    grant.check_budgets,
    grant.check_grant_guards,
    provenance.check_provenance,
)

#: Step 6: of one row.
ROW_CHECKS: tuple[Callable[[Case, Row], Findings], ...] = (
    row.check_object,
    row.check_source,
    place.check_place,
    row.check_destination,
    row.check_route,
)

__all__ = ["GRANT_CHECKS", "MISSION_CHECKS", "ROW_CHECKS", "Case"]
